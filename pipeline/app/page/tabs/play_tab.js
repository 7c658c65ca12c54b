// The same shot played otherwise: sliders, and the paths on the plan.
import { html, useEffect, useRef, useState } from "../html.js";
import { post } from "../api.js";
import { Preparing } from "../parts/preparing.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

// ms after the last move of a slider until the shot is played.
const WAIT_MS = 120;
// ms after a first answer from a few plays until that from all is asked for; the sliders may move on.
const ALL_MS = 400;
// ms until a better answer may be there: contact models of the whole shot are found while the first one is shown.
const BETTER_MS = 10_000;
// Share of the plays from which an event is listed.
const LIKELY = 0.5;
const NONE = { speed_percent: 0, angle_deg: 0, top_percent: 0, side_percent: 0 };
// Range and step of each slider; a tip beside the centre by half a radius is 125 % of rolling spin, and slips beyond.
const SLIDERS = { speed_percent: [50, 1], angle_deg: [10, 0.1], top_percent: [100, 5], side_percent: [100, 5] };

export function PlayTab({ shot }) {
  const { played } = useStore(shot.desk);
  const [change, setChange] = useState(NONE);
  const [isBusy, setIsBusy] = useState(false);
  const [error, setError] = useState("");
  const running = useRef(null);
  const timer = useRef(0);
  /** Forget what was asked, or would be: an answer to it must not follow a later question. */
  const stop = () => { clearTimeout(timer.current); running.current?.abort(); running.current = null; };
  useEffect(() => () => { stop(); shot.desk.set({ played: null }); }, [shot]);

  const request = async (path, body, isBetter = false) => {
    stop();
    const control = new AbortController();
    running.current = control;
    setIsBusy(!isBetter); // a first answer is shown already
    setError("");
    try {
      const played = await post(shot.address(path), body, control.signal);
      shot.desk.set({ played });
      if (played.is_final === false) {
        const { is_quick: isQuick, ...all } = body;
        timer.current = setTimeout(() => request(path, all, true), isQuick ? ALL_MS : BETTER_MS);
      }
    } catch (one) {
      if (one.name !== "AbortError") setError(one.message);
    } finally {
      if (running.current === control) setIsBusy(false);
    }
  };
  const set = (name, value) => {
    const next = { ...change, [name]: value };
    setChange(next);
    stop();
    timer.current = setTimeout(() => request("what-if", { ...next, is_quick: true }), WAIT_MS);
  };
  const reset = () => {
    stop();
    setChange(NONE);
    setIsBusy(false);
    shot.desk.set({ played: null });
  };
  return html`<div class="columns">
    <section><h2>${text.play.title}</h2>
      ${Object.entries(SLIDERS).map(([name, [most, step]]) => html`<div class="field" key=${name}>
        <label for=${name}>${text.play.sliders[name]}</label>
        <input id=${name} type="range" min=${-most} max=${most} step=${step} value=${change[name]}
          aria-valuetext=${text.play.values[name](change[name])}
          onInput=${(event) => set(name, Number(event.target.value))} />
        <output for=${name}>${text.play.values[name](change[name])}</output></div>`)}
      <div class="row"><button onClick=${reset}>${text.play.reset}</button>
        <button onClick=${() => { setChange(NONE); request("predict", { at: shot.player.clock.get().t }); }}>${text.play.predict}</button></div>
    </section>
    <section aria-live="polite" aria-busy=${isBusy}><h2>${text.play.result}</h2>
      ${error && html`<p role="alert">${error}</p>`}
      ${isBusy ? html`<p class="small">${text.play.busy}</p><progress aria-label=${text.play.busy}></progress><${Preparing} />`
      : !played && !error && html`<p class="small">${text.play.hint}</p>`}
      ${played && html`<div class=${isBusy ? "busy" : ""}>${played.chance ? html`<${Plays} played=${played} />`
        : (played.sentences ?? []).map((one) => html`<p key=${one}>${one}</p>`)}</div>`}
    </section>
  </div>`;
}

/** What many plays of the changed stroke have in common. */
function Plays({ played }) {
  const [first, ...others] = played.sentences;
  const chance = ({ probability, sigma }) => text.play.chance(probability, sigma);
  const likely = played.events.filter((one) => one.probability >= LIKELY);
  return html`<p>${first}</p>
    <dl class="measures"><div><dt>${text.play.asStruck}</dt><dd>${chance(played.chance.as_struck)}</dd></div>
      <div><dt>${text.play.otherwise}</dt><dd>${chance(played.chance.otherwise)}</dd></div></dl>
    ${likely.length > 0 && html`<ol class="plays">${likely.map((one) => html`<li key=${one.text}>${one.text}${" "}
      <span class="share">${text.percent(one.probability)}</span></li>`)}</ol>`}
    ${others.length > 0 && html`<details><summary>${text.play.more}
      </summary>${others.map((one) => html`<p key=${one}>${one}</p>`)}</details>`}`;
}
