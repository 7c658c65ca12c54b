// Table, ball and frame rate of a clip, where the program recognised them wrongly.
import { html } from "../html.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

const RATES = ["23.976", "24", "25", "29.97", "30", "50", "59.94", "60", "100", "120", "240"];

export function SettingsFields({ shot }) {
  const { doc } = useStore(shot.state);
  const set = doc.corrections;
  const { table, fps, ball_radius: radius } = doc.run;
  const apply = (key, value) => shot.change((c) => { if (value === "" || value === null) delete c[key]; else c[key] = value; });
  const tables = doc.tables ?? [];
  const names = set.table && !tables.includes(set.table) ? [set.table, ...tables] : tables;
  const rates = set.fps && !RATES.includes(set.fps) ? [set.fps, ...RATES] : RATES;
  const select = (id, value, empty, options) => html`<select id=${id} value=${value}
    onChange=${(event) => apply(id, event.target.value)}>
    ${[["", empty], ...options.map((one) => [one, one])].map(([key, name]) => html`<option key=${key} value=${key}
      selected=${key === value}>${name}</option>`)}</select>`;
  return html`<section><h2>${text.settings.title}</h2><div class="fields">
    <label for="table">${text.settings.table}</label>
    ${select("table", set.table ?? "", set.table ? text.settings.recognised : text.settings.tableIs(table), names)}
    <label for="table-size">${text.settings.size}</label>
    <input id="table-size" placeholder=${text.settings.sizeExample} autocomplete="off"
      onChange=${(event) => apply("table", event.target.value.trim())} />
    <label for="radius">${text.settings.diameter}</label>
    <input id="radius" type="number" step="0.01" min="10" max="120" value=${(2000 * radius).toFixed(2)}
      onChange=${(event) => apply("ball_radius", event.target.value === "" ? null : Number(event.target.value) / 2000)} />
    <label for="fps">${text.settings.rate}</label>
    ${select("fps", set.fps ?? "", set.fps ? text.settings.asFile : text.settings.rateIs(fps), rates)}
    <label for="fps-other">${text.settings.otherRate}</label>
    <input id="fps-other" placeholder=${text.settings.rateExample} autocomplete="off"
      onChange=${(event) => apply("fps", event.target.value.trim())} />
  </div><p><button id="find-table" disabled=${!set.corners}
    onClick=${() => { shot.desk.set({ corners: null }); apply("corners", null); }}>${text.settings.findAgain}</button></p>
    </section>`;
}
