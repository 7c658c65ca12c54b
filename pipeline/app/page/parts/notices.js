// Short sentences at the bottom of the page.
import { html } from "../html.js";
import { dismiss, notices } from "../library_store.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function Notices() {
  const { list } = useStore(notices);
  return html`<section class="notices" aria-label=${text.app.notices} aria-live="polite">
    ${list.map((one) => html`<div key=${one.id} class="notice ${one.kind}">
      <span>${one.sentence}</span>
      ${one.action && html`<button class="plain" onClick=${() => { dismiss(one.id); one.action.run(); }}>${one.action.label}
        </button>`}
      <button class="plain icon" aria-label=${text.app.close} onClick=${() => dismiss(one.id)}>×</button>
    </div>`)}
  </section>`;
}
