// The page of a command on several shots, in the frame of this page.
import { html, useEffect } from "../html.js";
import { fileAddress } from "../api.js";
import { library } from "../library_store.js";
import { routeTo } from "../router.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function SessionView({ id }) {
  const { shots } = useStore(library);
  const card = shots?.find((one) => one.id === id);
  useEffect(() => { if (card) document.title = text.shot.title(card.name); }, [card?.name]);
  if (!shots) return html`<p class="loading" role="status">${text.app.loading}</p>`;
  if (!card) return html`<p class="nothing" role="alert">${text.session.missing} <a
    href=${routeTo("library")}>${text.shot.back}</a></p>`;
  const address = fileAddress(id, card.page);
  return html`<div class="session">
    <div class="shot-head"><a class="back" href=${routeTo("library")} aria-label=${text.shot.back}>‹</a><h1>${card.name}
      </h1>
      <a class="button" href=${address} target="_blank" rel="noopener">${text.session.open}</a></div>
    <iframe src=${address} title=${text.session.frame(card.name)} sandbox="allow-scripts allow-popups"></iframe>
  </div>`;
}
