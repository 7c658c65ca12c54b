// Cards of the shots. Only those near the visible part of the page are in the document, whatever their number.
import { html, useEffect, useLayoutEffect, useRef, useState } from "../html.js";
import { shotAddress } from "../api.js";
import { routeTo } from "../router.js";
import { text } from "../strings.js";

// px: least width and height of a card, and the space between cards; card_grid in library.css has the same height.
const CARD_WIDTH = 250;
const CARD_HEIGHT = 292;
const GAP = 18;
const NONE = new Set();
// Rows above and below the visible ones that are drawn too.
const SPARE_ROWS = 2;

/** Show cards; without `onChoose` they cannot be selected. */
export function CardGrid({ cards, chosen = NONE, onChoose }) {
  const grid = useRef(null);
  const [view, setView] = useState({ columns: 1, first: 0, stop: 0 });
  const measure = () => {
    if (!grid.current) return;
    const box = grid.current.getBoundingClientRect();
    const columns = Math.max(1, Math.floor((box.width + GAP) / (CARD_WIDTH + GAP)));
    const row = CARD_HEIGHT + GAP;
    const first = Math.max(0, Math.floor(-box.top / row) - SPARE_ROWS);
    const stop = Math.max(0, Math.ceil((innerHeight - box.top) / row) + SPARE_ROWS);
    const isSame = (before) => before.columns === columns && before.first === first && before.stop === stop;
    setView((before) => (isSame(before) ? before : { columns, first, stop }));
  };
  useLayoutEffect(measure, [cards]);
  useEffect(() => {
    const observer = new ResizeObserver(measure);
    observer.observe(grid.current);
    observer.observe(document.body); // what lies above the grid moves it
    addEventListener("scroll", measure, { passive: true });
    return () => { observer.disconnect(); removeEventListener("scroll", measure); };
  }, []);
  const rows = Math.ceil(cards.length / view.columns);
  const first = Math.min(view.first, Math.max(0, rows - 1));
  const shown = cards.slice(first * view.columns, view.stop * view.columns);
  const height = Math.max(0, rows * (CARD_HEIGHT + GAP) - GAP);
  return html`<div class="card-grid" ref=${grid} style=${{ height: `${height}px` }}>
    <ul style=${{ top: `${first * (CARD_HEIGHT + GAP)}px`, gridTemplateColumns: `repeat(${view.columns}, minmax(0, 1fr))` }}>
      ${shown.map((card, k) => html`<${Card} key=${card.id} card=${card} isChosen=${chosen.has(card.id)}
        onChoose=${onChoose}
        place=${first * view.columns + k + 1} count=${cards.length} />`)}
    </ul></div>`;
}

// Kinds of cards that are a shot; the others are a page that a command wrote.
export const SHOTS = new Set(["shot", "rally"]);

/** Address of what a card stands for; a result that has no card yet is a shot. */
export const routeToCard = ({ id, kind }) => routeTo(!kind || SHOTS.has(kind) ? "shot" : "session", id);

function Card({ card, isChosen, onChoose, place, count }) {
  const { id, name, kind, trust, state, outcome, error } = card;
  const address = routeToCard(card);
  return html`<li class="card ${isChosen ? "chosen" : ""}" aria-setsize=${count} aria-posinset=${place}>
    <a href=${address} class="thumb" tabindex="-1" aria-hidden="true">
      ${card.thumbnail ? html`<img src=${shotAddress(id, "thumbnail")} alt="" loading="lazy" decoding="async" />`
        : html`<span class="no-thumb">${text.kinds[kind] ?? kind}</span>`}
      ${card.seconds > 0 && html`<span class="length">${text.seconds(card.seconds)}</span>`}
      ${text.library.states[state] && html`<span class="length state">${text.library.states[state]}</span>`}
    </a>
    ${onChoose && html`<label class="pick"><input type="checkbox" checked=${isChosen}
      aria-label=${text.library.pick(name)}
      onChange=${(event) => onChoose(id, event.target.checked)} /></label>`}
    <h2><a href=${address}>${name}</a></h2>
    <p class="outcome ${state === "failed" ? "failed" : ""}"
      title=${error || outcome}>${error || outcome || (SHOTS.has(kind) ? text.library.noOutcome(state) : "")}</p>
    <p class="facts">${trust && outcome && html`<${TrustMark} level=${trust} />`}<span>${listFacts(card)}</span></p>
  </li>`;
}

function listFacts({ table, balls, date }) {
  return [date && text.date(date), table, balls && text.library.balls(balls)].filter(Boolean).join(" · ");
}

/** Trust as a word with a shape, so that colour is not all that carries it. */
export function TrustMark({ level }) {
  return html`<span class="trust ${level}"><i aria-hidden="true"></i>${text.trust[level] ?? level}</span>`;
}

