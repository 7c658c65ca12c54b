// The timeline of a shot: its events, the present moment, and the controls of the player.
import { html } from "../html.js";
import { PACES } from "../shot/player.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";
import { PictureSwitch } from "./stage.js";

// Probability from which an event is sure enough to be drawn full.
const SURE = 0.9;
const ICONS = {
  play: "M8 5v14l11-7z", pause: "M7 5h4v14H7zM13 5h4v14h-4z", back: "M15 5v14L6 12zM4 5h2v14H4z",
  forward: "M9 5v14l9-7zM18 5h2v14h-2z", before: "M11 6 4 12l7 6zM20 6l-7 6 7 6z", after: "m13 6 7 6-7 6zM4 6l7 6-7 6z",
};

export function Timeline({ shot }) {
  const { doc } = useStore(shot.state);
  const { t, row, isPlaying, pace } = useStore(shot.player.clock);
  const { player } = shot;
  const { frames } = player;
  const span = Math.max(frames.end - frames.start, 1e-6);
  const events = (doc.run?.events ?? []).filter((one) => one.kind !== "rest");
  const when = text.timeline.when(frames.distinct[row], t);
  return html`<section class="timeline" aria-label=${text.timeline.label}>
    <div class="time-track">
      <input id="slider" type="range" min="0" max=${frames.distinct.length - 1} value=${row}
        aria-label=${text.timeline.frame} aria-valuetext=${when}
        onInput=${(event) => player.showRow(Number(event.target.value))} />
      <div class="ticks">${events.map((one, k) => html`<button key=${k}
        class=${`tick ${one.kind} ${one.probability < SURE ? "unsure" : ""}`}
        style=${{ left: `${100 * Math.max(0, Math.min(1, (one.t - frames.start) / span))}%` }} tabindex="-1" aria-hidden="true" title=${`${one.when}: ${one.text}`}
        onClick=${() => shot.showEvent(one)}></button>`)}</div>
    </div>
    <div class="transport">
      <${IconButton} id="event-before" icon="before" label=${text.timeline.eventBefore} run=${() => shot.stepEvent(-1)} />
      <${IconButton} id="back" icon="back" label=${text.timeline.back} run=${() => player.step(-1)} />
      <${IconButton} id="play" icon=${isPlaying ? "pause" : "play"}
        label=${isPlaying ? text.timeline.stop : text.timeline.play}
        run=${() => player.toggle()} isMain=${true} />
      <${IconButton} id="forward" icon="forward" label=${text.timeline.forward} run=${() => player.step(1)} />
      <${IconButton} id="event-after" icon="after" label=${text.timeline.eventAfter} run=${() => shot.stepEvent(1)} />
      <output id="when">${when}</output>
      <${PictureSwitch} shot=${shot} />
      <div class="switch" role="group" aria-label=${text.timeline.pace}>
        ${PACES.map((one) => html`<button key=${one} aria-pressed=${one === pace}
          onClick=${() => player.setPace(one)}>${text.timeline.paces(one)}</button>`)}
      </div>
    </div>
  </section>`;
}

export function IconButton({ id, icon, label, run, isMain }) {
  return html`<button id=${id} class=${`icon ${isMain ? "main" : ""}`} aria-label=${label} title=${label} onClick=${run}>
    <svg viewBox="0 0 24 24" width="22" height="22" aria-hidden="true"><path d=${ICONS[icon]} fill="currentColor" /></svg>
      </button>`;
}
