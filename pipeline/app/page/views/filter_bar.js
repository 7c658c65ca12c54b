// Search, filters and order of the library.
import { html } from "../html.js";
import { text } from "../strings.js";
import { listValues } from "./library_filter.js";

const SORTS = ["newest", "oldest", "name", "longest", "leastSure"];
const TRUSTS = ["high", "medium", "low"];

export function FilterBar({ shots, filter, onChange, count }) {
  const set = (name) => (event) => onChange({ ...filter, [name]: event.target.value });
  const kinds = listValues(shots, "kind");
  const tables = listValues(shots, "table");
  return html`<search class="filters">
    <label class="search"><span class="hidden">${text.library.search}</span>
      <input type="search" id="search" placeholder=${text.library.search} value=${filter.search} onInput=${set("search")} />
        </label>
    <${Choice} label=${text.library.trust} value=${filter.trust} onChange=${set("trust")}
      options=${[["", text.library.anyTrust], ...TRUSTS.map((one) => [one, text.trust[one]])]} />
    ${kinds.length > 1 && html`<${Choice} label=${text.library.kind} value=${filter.kind} onChange=${set("kind")}
      options=${[["", text.library.anyKind], ...kinds.map((one) => [one, text.kinds[one] ?? one])]} />`}
    ${tables.length > 1 && html`<${Choice} label=${text.library.table} value=${filter.table} onChange=${set("table")}
      options=${[["", text.library.anyTable], ...tables.map((one) => [one, one])]} />`}
    <${Choice} label=${text.library.sort} value=${filter.sort} onChange=${set("sort")}
      options=${SORTS.map((one) => [one, text.library.sorts[one]])} />
    <output class="count" aria-live="polite">${text.library.count(count, shots.length)}</output>
  </search>`;
}

/** A select with a label for screen readers; its options say what it is about. */
export function Choice({ label, value, options, onChange, id }) {
  return html`<label class="choice"><span class="hidden">${label}</span>
    <select id=${id} value=${value} onChange=${onChange}>
      ${options.map(([key, name]) => html`<option key=${key} value=${key} selected=${key === value}>${name}</option>`)}
    </select></label>`;
}
