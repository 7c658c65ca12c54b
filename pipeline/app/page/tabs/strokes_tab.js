// The strokes and landings of a rally.
import { html } from "../html.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function StrokesTab({ shot }) {
  const { doc } = useStore(shot.state);
  const go = (t) => { shot.player.pause(); shot.player.seek(t); };
  const line = (one, k) => html`<li key=${k}><button class="item" onClick=${() => go(one.t)}>
    <span class="when">${text.seconds(one.t)}</span><span>${one.text}</span>
    <span class="share">${Number.isFinite(one.probability) ? text.percent(one.probability) : ""}</span></button></li>`;
  return html`<div class="columns">
    <section><h2>${text.rally.strokes}</h2><ul class="list">${(doc.strokes ?? []).map(line)}</ul>
      ${!doc.strokes?.length && html`<p class="small">${text.rally.noStrokes}</p>`}</section>
    <section><h2>${text.rally.landings}</h2><ul class="list">${(doc.landings ?? []).map(line)}</ul>
      ${!doc.landings?.length && html`<p class="small">${text.rally.noLandings}</p>`}</section>
  </div>`;
}
