// Table, ball and frame rate of a clip, where the program recognised them wrongly.
import { html, useState } from "../html.js";
import { notify } from "../library_store.js";
import { setSport } from "../shot/marks.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

const RATES = ["23.976", "24", "25", "29.97", "30", "50", "59.94", "60", "100", "120", "240"];

/** A field that sends what was typed when it is left; a refusal stands below it, and the old value in it again. */
function TypedField({ id, label, value, apply, ...rest }) {
  const [typed, setTyped] = useState(null); // null while the field shows what is set
  const [refusal, setRefusal] = useState("");
  const send = async () => {
    if (typed === null) return;
    setRefusal("");
    await apply(typed.trim(), (error) => setRefusal(error.message));
    setTyped(null);
  };
  return html`<label for=${id}>${label}</label>
    <input id=${id} ...${rest} autocomplete="off" value=${typed ?? value} aria-describedby=${`${id}-refusal`}
      onInput=${(event) => setTyped(event.target.value)} onChange=${send} />
      <p id=${`${id}-refusal`} role="alert" class="refusal">${refusal}</p>`;
}

export function SettingsFields({ shot }) {
  const { doc } = useStore(shot.state);
  const set = doc.corrections;
  const { table, fps, ball_radius: radius } = doc.run;
  const apply = (key, value, onRefusal) => shot.change((c) => {
    if (value === "" || value === null) delete c[key];
    else c[key] = value;
  }, onRefusal);
  const chooseSport = (value) => {
    shot.desk.set({ corners: null });
    if (set.corners) notify(text.settings.cornersDropped);
    shot.change((c) => setSport(c, value));
  };
  const tables = doc.tables ?? [];
  const names = set.table && !tables.includes(set.table) ? [set.table, ...tables] : tables;
  const rates = set.fps && !RATES.includes(set.fps) ? [set.fps, ...RATES] : RATES;
  const select = (id, value, empty, options) => html`<select id=${id} value=${value}
    onChange=${(event) => (id === "sport" ? chooseSport(event.target.value) : apply(id, event.target.value))}>
    ${[["", empty], ...options.map((one) => [one, one])].map(([key, name]) => html`<option key=${key} value=${key}
      selected=${key === value}>${name}</option>`)}</select>`;
  const sports = doc.sports ?? [];
  return html`<section><h2>${text.settings[shot.isRally ? "court" : "title"]}</h2><div class="fields">
    ${shot.isRally ? html`<label for="sport">${text.settings.sport}</label>
      ${select("sport", set.sport ?? "", set.sport ? text.settings.recognised : text.settings.tableIs(table), sports)}` : html`
    <label for="table">${text.settings.table}</label>
    ${select("table", set.table ?? "", set.table ? text.settings.recognised : text.settings.tableIs(table), names)}
    <${TypedField} id="table-size" label=${text.settings.size} placeholder=${text.settings.sizeExample}
      value=${set.table && !tables.includes(set.table) ? set.table : ""}
      apply=${(value, onRefusal) => apply("table", value, onRefusal)} />
    <${TypedField} id="radius" label=${text.settings.diameter} type="number" step="0.01"
      value=${(2000 * (set.ball_radius ?? radius)).toFixed(2)}
      apply=${(value, onRefusal) => apply("ball_radius", value === "" ? null : Number(value) / 2000, onRefusal)} />`}
    <label for="fps">${text.settings.rate}</label>
    ${select("fps", set.fps ?? "", set.fps ? text.settings.asFile : text.settings.rateIs(fps), rates)}
    <${TypedField} id="fps-other" label=${text.settings.otherRate} placeholder=${text.settings.rateExample}
      value=${set.fps && !RATES.includes(set.fps) ? set.fps : ""} apply=${(value, onRefusal) => apply("fps", value, onRefusal)} />
  </div><p><button id="find-table" disabled=${!set.corners}
    onClick=${() => { shot.desk.set({ corners: null }); apply("corners", null); }}>${text.settings.findAgain}</button></p>
    </section>`;
}
