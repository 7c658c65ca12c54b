// The page of a command on several shots, in the frame of this page; of a recording, its shots.
import { html, useEffect } from "../html.js";
import { fileAddress } from "../api.js";
import { library } from "../library_store.js";
import { routeTo } from "../router.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";
import { CardGrid } from "./card_grid.js";

export function SessionView({ id }) {
  const { shots } = useStore(library);
  const card = shots?.find((one) => one.id === id);
  useEffect(() => { if (card) document.title = text.shot.title(card.name); }, [card?.name]);
  if (!shots) return html`<p class="loading" role="status">${text.app.loading}</p>`;
  const back = (words, className) => html`<a class=${className} href=${routeTo("library")} aria-label=${text.shot.back}>${words}</a>`;
  if (!card) return html`<p class="nothing" role="alert">${text.session.missing} ${back(text.shot.back, "")}</p>`;
  const address = fileAddress(id, card.page);
  const parts = shots.filter((one) => one.name.startsWith(`${card.name}, `));
  return html`<div class="session">
    <div class="shot-head">${back("‹", "back")}<h1>${card.name}</h1>
      ${card.page && html`<a class="button" href=${address} target="_blank" rel="noopener">${text.session.open}</a>`}</div>
    ${card.page ? html`<iframe src=${address} title=${text.session.frame(card.name)} sandbox="allow-scripts allow-popups"></iframe>`
      : html`<${CardGrid} cards=${parts} />`}
    ${!card.page && !parts.length && html`<p class="nothing">${text.session.empty}</p>`}
  </div>`;
}
