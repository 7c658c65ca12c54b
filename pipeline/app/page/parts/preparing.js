// What the server prepares before it can answer at once; nothing when it can.
import { html } from "../html.js";
import { library } from "../library_store.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function Preparing() {
  const { preparing } = useStore(library);
  return html`<p class="small preparing" role="status">${text.preparing[preparing]}</p>`;
}
