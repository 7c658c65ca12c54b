// Numbers for players.
import { html } from "../html.js";
import { fileAddress } from "../api.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function NumbersTab({ shot }) {
  const { doc } = useStore(shot.state);
  const { numbers = [] } = doc;
  return html`<div>
    ${numbers.map(({ title, rows }) => html`<section key=${title}><h2>${title}</h2><table class="numbers"><tbody>
      ${rows.map(([name, value]) => html`<tr key=${name}><th scope="row">${name}</th><td>${value}</td></tr>`)}</tbody>
        </table></section>`)}
    ${!numbers.length && html`<p class="small">${text.numbers.none}</p>`}
    <p class="small">${text.numbers.signs}</p>
    <p><a class="button" href=${fileAddress(doc.id ?? shot.id, "report.html")} target="_blank"
      rel="noopener">${text.numbers.report}</a></p>
  </div>`;
}
