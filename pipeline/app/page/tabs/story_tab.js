// What happened: the summary in sentences, and all events; each is played by choosing it.
import { html } from "../html.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

// Probability from which an event is sure enough.
const SURE = 0.9;
// Sentences of the summary that everybody wants to know.
const SHOWN = 3;

export function StoryTab({ shot }) {
  const { doc } = useStore(shot.state);
  const { event: chosen } = useStore(shot.desk);
  const events = doc.run?.events ?? [];
  const summary = doc.summary ?? [];
  const [first, more] = [summary.slice(0, SHOWN), summary.slice(SHOWN)];
  const list = (sentences) => sentences.map((sentence) => html`<p key=${sentence}>${sentence}</p>`);
  return html`<section class="story"><h2>${text.story.summary}</h2>
      ${list(first)}
      ${more.length > 0 && html`<details><summary>${text.story.more}</summary>${list(more)}</details>`}
      ${!summary.length && html`<p class="small">${text.story.noSummary}</p>`}
    </section>
    <section><h2>${text.story.events}</h2><${EventList} shot=${shot} events=${events} chosen=${chosen} /></section>`;
}

export function EventList({ shot, events, chosen, id, mark = () => null }) {
  if (!events.length) return html`<p class="small">${text.story.noEvents}</p>`;
  return html`<ul class="list" id=${id}>${events.map((one, k) => html`<li key=${k}>
    <button class="item event" aria-pressed=${chosen === one} onClick=${() => shot.showEvent(one)}>
      <span class="when">${one.when}</span><span class="words">${one.text}</span>
      ${mark(one) ?? html`<span class=${`share ${one.probability < SURE ? "unsure" : ""}`}>${one.share}</span>`}
    </button></li>`)}</ul>`;
}
