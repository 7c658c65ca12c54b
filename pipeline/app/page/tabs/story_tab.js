// What happened: the summary in sentences, and all events; each is played by choosing it.
import { html } from "../html.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

const SURE = 0.9;

export function StoryTab({ shot }) {
  const { doc } = useStore(shot.state);
  const { event: chosen } = useStore(shot.desk);
  const events = doc.run?.events ?? doc.events ?? [];
  return html`<div class="columns">
    <section><h2>${text.story.summary}</h2>
      ${(doc.summary ?? []).map((sentence) => html`<p key=${sentence}>${sentence}</p>`)}
      ${!doc.summary?.length && html`<p class="small">${text.story.noSummary}</p>`}
    </section>
    <section><h2>${text.story.events}</h2><${EventList} shot=${shot} events=${events} chosen=${chosen} /></section>
  </div>`;
}

export function EventList({ shot, events, chosen, id, mark = () => null }) {
  if (!events.length) return html`<p class="small">${text.story.noEvents}</p>`;
  return html`<ul class="list" id=${id}>${events.map((one, k) => html`<li key=${k}>
    <button class="item event" aria-pressed=${chosen === one} onClick=${() => shot.showEvent(one)}>
      <span class="when">${one.when}</span><span class="words">${one.text}</span>
      ${mark(one) ?? html`<span class=${`share ${one.probability < SURE ? "unsure" : ""}`}>${one.share}</span>`}
    </button></li>`)}</ul>`;
}
