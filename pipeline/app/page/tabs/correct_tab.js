// Corrections in place: what was measured wrong is said here, and the shot is explained again.
import { html } from "../html.js";
import { cancelCorrection, goToCheck, markHere, pickBall, startPlacing } from "../shot/hand_tools.js";
import { drop, dropMark, findEntry, findMark, RALLY_EVENTS, setSport } from "../shot/marks.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";
import { Selection } from "./selection_panel.js";
import { SettingsFields } from "./settings_fields.js";
import { EventList } from "./story_tab.js";

/** What stands beside the picture: what to do next, the chosen ball or event, and what a correction changed. */
export function CorrectSide({ shot }) {
  const { doc } = useStore(shot.state);
  if (!doc.run) return null;
  return html`<${Hint} shot=${shot} /><${Selection} shot=${shot} /><${Changes} shot=${shot} />${!shot.isRally && html`<${Balls} shot=${shot} />`}`;
}

export function CorrectTab({ shot }) {
  const { doc } = useStore(shot.state);
  if (!doc.run) return html`<p role="status">${text.correct.preparing}</p>`;
  return html`<div class="correct">
    <${Tools} shot=${shot} />
    <div class="columns">
      <div><${Events} shot=${shot} /><${Checks} shot=${shot} /></div>
      <div><${SettingsFields} shot=${shot} /><${ByHand} shot=${shot} /></div>
    </div>
    <${Keys} shot=${shot} />
  </div>`;
}

function Hint({ shot }) {
  const { doc } = useStore(shot.state);
  const { question, check } = useStore(shot.desk);
  const { checks } = doc.run;
  return html`<div class=${`hint ${question ? "asks" : ""}`}><span id="hint-text"
    aria-live="polite">${question ? question.words : checks[check]
    ? text.correct.check(check + 1, checks.length, checks[check].reason) : text.correct[shot.isRally ? "rallyHint" : "hint"]}</span>
    ${question && html`<button id="cancel" onClick=${() => cancelCorrection(shot)}>${text.correct.cancel}</button>`}</div>`;
}

function Tools({ shot }) {
  const { status } = useStore(shot.state);
  const { check } = useStore(shot.desk);
  const state = status ?? {};
  const runs = state.stage || state.result !== state.revision && !state.error;
  const words = state.stage ? text.correct.stages[state.stage] ?? state.stage : runs ? text.correct.starting
    : text.correct.outputs[state.outputs] ?? "";
  return html`<div class="correct-tools">
    <div class="row" role="group" aria-label=${text.correct.tools}>
      <button id="undo" disabled=${!state.can_undo} onClick=${() => shot.undo()}>${text.correct.undo}</button>
      <button id="redo" disabled=${!state.can_redo} onClick=${() => shot.redo()}>${text.correct.redo}</button>
      <button id="place" onClick=${() => startPlacing(shot)}>${text.correct[shot.isRally ? "placeHere" : "place"]}</button>
      <button id="next-check" onClick=${() => goToCheck(shot, check + 1)}>${text.correct.nextCheck}</button>
      <label class="tick-box"><input type="checkbox" id="all-corners" />${text.correct.allCorners}</label>
      ${shot.isRally && html`<${EventButtons} shot=${shot} />`}
      <button id="finish" class="main" disabled=${Boolean(runs)} onClick=${() => shot.finish()}>${text.correct.finish}
        </button>
    </div>
    ${state.error && !runs ? html`<p role="alert" class="refusal">${text.correct.failed(state.error)}</p>`
    : html`<div class="work"><label for="progress" id="progress-text" aria-live="polite">${words}</label>
      <progress id="progress" max="1" value=${runs && !state.share ? undefined : runs ? state.share : 1}></progress></div>`}
  </div>`;
}

/** Events of a rally that can be marked at the shown frame. */
function EventButtons({ shot }) {
  const { row } = useStore(shot.player.clock);
  const frame = shot.player.frames.distinct[row];
  const contact = shot.run.balls[0]?.id === "shuttle" ? "bounce" : "landing"; // a shuttle lands, a ball bounces
  return RALLY_EVENTS.filter((kind) => kind !== contact).map((kind) => html`<button key=${kind} data-mark=${kind}
    onClick=${() => markHere(shot, kind)}>${text.correct.markHere[kind](frame)}</button>`);
}

function Changes({ shot }) {
  const { doc } = useStore(shot.state);
  const { contradictions, changes } = doc.run;
  const nothing = doc.revision ? text.correct.sameAsBefore : text.correct.nothingYet;
  return html`<section><h2>${text.correct.changes}</h2><ul id="changes" class="changes">
    ${contradictions.map(({ text: sentence, contact }) => {
      const mark = shot.isUpToDate && doc.corrections[shot.isRally ? "events" : "contacts"]?.[contact];
      return html`<li key=${sentence} class="against">
        <span>${sentence} </span>${mark && html`<button aria-label=${text.correct.removeLabel(sentence)}
        onClick=${() => shot.change((c) => dropMark(c, mark))}>${text.correct.remove}</button>`}</li>`;
    })}
    ${changes.map((one) => html`<li key=${one.text} class=${one.kind}>${one.text}</li>`)}
    ${!contradictions.length && !changes.length && html`<li class="small">${nothing}</li>`}
  </ul></section>`;
}

function Checks({ shot }) {
  const { doc } = useStore(shot.state);
  const { check } = useStore(shot.desk);
  const { checks } = doc.run;
  return html`<section><h2>${text.correct.checks}
    </h2>${checks.length ? html`<ol id="checks" class="list">${checks.map((one, k) => html`<li key=${k}>
    <button class="item" aria-pressed=${check === k} onClick=${() => goToCheck(shot, k)}><span
      class="when">${text.seconds(one.t)}</span><span>${one.reason}</span></button></li>`)}</ol>`
    : html`<p class="small">${text.correct.noChecks}</p>`}</section>`;
}

function Events({ shot }) {
  const { doc } = useStore(shot.state);
  const { event } = useStore(shot.desk);
  const mark = (one) => (findMark(doc.run, doc.corrections, one) ? html`<span class="hand">${text.correct.byHandMark}
    </span>` : null);
  return html`<section><h2>${text.story.events}</h2><${EventList} shot=${shot} events=${doc.run.events} chosen=${event}
    id="events" mark=${mark} /></section>`;
}

function Balls({ shot }) {
  const { doc } = useStore(shot.state);
  const { ball, keys } = useStore(shot.desk);
  const keyOf = (id) => keys.find((one) => one[2] === id)?.[0] ?? "";
  return html`<section><h2>${text.correct.balls}</h2><ul id="balls"
    class="list">${doc.run.balls.map((one) => html`<li key=${one.id}>
    <button class="item" aria-pressed=${ball === one.id} onClick=${() => pickBall(shot, one.id)}>
      <span class="swatch" style=${{ background: one.colour }}></span><span>${one.name}</span><span
        class="when">${one.id} · ${keyOf(one.id)}</span></button></li>`)}</ul>
    ${!doc.run.balls.length && html`<p class="small">${text.correct.noBalls}</p>`}</section>`;
}

function ByHand({ shot }) {
  const { doc } = useStore(shot.state);
  const set = doc.corrections;
  const keys = ["corners", "sport", "table", "ball_radius", "fps"].filter((key) => set[key] !== undefined).map((key) => [key, null]);
  for (const list of ["balls", "tracks", "contacts", "events"]) (set[list] ?? []).forEach((_, k) => keys.push([list, k]));
  return html`<section><h2>${text.correct.byHand}</h2><ul id="by-hand" class="by-hand">${keys.map(([key, k], number) => {
    const name = doc.set_by_hand[number] ?? key;
    return html`<li key=${`${key} ${k}`}><span>${name}</span><span class="row">
      ${key === "tracks" && set.tracks[k].kind === "swap" && html`<button aria-label=${text.correct.untilLabel(shot.frame)}
        onClick=${() => shot.change((c, { frame }) => Object.assign(findEntry(c, "tracks", set.tracks[k]) ?? {}, { last: frame }))}>${text.correct.until}</button>`}
      <button aria-label=${text.correct.removeLabel(name)}
        onClick=${() => shot.change((c) => { if (key === "sport") setSport(c, ""); else if (k === null) delete c[key]; else drop(c, key, set[key][k]); })}>${text.correct.remove}</button>
    </span></li>`;
  })}</ul>${!keys.length && html`<p class="small">${text.correct.noneByHand}</p>`}</section>`;
}

function Keys({ shot }) {
  return html`<section class="keys"><h2>${text.correct.keys}</h2>
    <dl>${(shot.isRally ? text.correct.rallyKeys : text.correct.keyList).map(([key, words]) => html`<div key=${key}><dt><kbd>${key}</kbd></dt><dd>${words}</dd>
    </div>`)}</dl></section>`;
}
