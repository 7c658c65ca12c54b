// Which shots of the library are shown, and in which order. Pure functions of the cards.

export const NO_FILTER = { search: "", trust: "", kind: "", table: "", sort: "newest" };

const ORDERS = {
  newest: (a, b) => b.time - a.time || a.place - b.place,
  oldest: (a, b) => a.time - b.time || a.place - b.place,
  name: (a, b) => a.card.name.localeCompare(b.card.name, undefined, { numeric: true }),
  longest: (a, b) => (b.card.seconds ?? 0) - (a.card.seconds ?? 0),
  leastSure: (a, b) => trustRank(a.card) - trustRank(b.card) || b.time - a.time,
};
const TRUST_ORDER = ["low", "medium", "high"];
const trustRank = (card) => (TRUST_ORDER.indexOf(card.trust) + TRUST_ORDER.length + 1) % (TRUST_ORDER.length + 1); // unknown last

/** Prepare cards for filtering: done once per change of the library, not per key press. */
export function indexShots(cards) {
  return cards.map((card, place) => ({
    card, place,
    time: card.added,
    words: [card.name, card.table, card.outcome, card.kind, card.date].join(" ").toLowerCase(),
  }));
}

/** Return the cards that fit a filter, in its order; every word of the search must be in a card. */
export function filterShots(index, { search, trust, kind, table, sort }) {
  const words = search.toLowerCase().split(/\s+/).filter(Boolean);
  return index.filter(({ card, words: own }) => (!trust || card.trust === trust) && (!kind || card.kind === kind)
    && (!table || card.table === table) && words.every((word) => own.includes(word)))
    .sort(ORDERS[sort]).map(({ card }) => card);
}

/** List the values that a property of the cards has, in the order of their names. */
export const listValues = (cards, name) => [...new Set(cards.map((card) => card[name]).filter(Boolean))].sort();
