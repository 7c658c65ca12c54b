// The answer to the last question; at first, to the one that everybody asks: which ball was hit first?
import { html, useEffect, useRef, useState } from "../html.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function AnswerCard({ shot }) {
  const { answer, isAsking } = useStore(shot.desk);
  const { doc } = useStore(shot.state);
  const [missing, setMissing] = useState("");
  const box = useRef(null);
  const asked = JSON.stringify(answer?.asked);
  const before = useRef(asked);
  useEffect(() => { // whoever asks on a phone sees the answer, which lies above the question
    if (before.current && before.current !== asked) box.current?.scrollIntoView({ block: "nearest" });
    before.current = asked;
  }, [asked]);
  if (!answer) {
    return html`<section class="answer" aria-label=${text.answer.label} aria-busy=${isAsking}>
      <p class="sentence">${isAsking ? text.answer.asking : doc.summary?.[0] ?? text.answer.none}</p></section>`;
  }
  if (answer.error) return html`<section class="answer" aria-label=${text.answer.label}><p class="sentence"
    role="status">${answer.error}</p></section>`;
  const { question, verdict, probability, sentence, t, t_sigma: sigma, reasons, picture, rows } = answer;
  const { margin_mm: margin, margin_sigma_mm: marginSigma } = answer;
  const isUnsure = !(probability >= 0.9);
  return html`<section ref=${box} class=${`answer ${isAsking ? "busy" : ""}`} aria-label=${text.answer.label} aria-live="polite">
    <p class="question">${question}</p>
    <p class="verdict"><strong>${verdict}</strong>${Number.isFinite(probability)
      && html`<span class=${`sure ${isUnsure ? "unsure" : ""}`}>${text.answer.sure(probability)}</span>`}</p>
    <p class="sentence">${sentence}</p>
    ${picture && picture !== missing && html`<a class="close-up" href=${picture} target="_blank" rel="noopener"><img src=${picture}
      alt=${text.answer.picture(question)}
      onError=${() => setMissing(picture)} /></a>`}
    ${rows?.length > 1 && html`<ul class="parts">${rows.slice(1).map(([part, decided, share, ...why]) => html`<li key=${part}>
      <span>${part}</span><strong>${decided} ${share}</strong><small>${why.join(" ")}</small></li>`)}</ul>`}
    <dl class="measures">
      ${Number.isFinite(t) && html`<div><dt>${text.answer.time}</dt><dd><button class="link"
        onClick=${() => { shot.player.pause(); shot.player.seek(t); }}>${text.time(t, sigma)}</button></dd></div>`}
      ${Number.isFinite(margin) && html`<div><dt>${text.answer.margin(margin)}</dt>
        <dd>${text.millimetres(Math.abs(margin), marginSigma)}</dd></div>`}
    </dl>
    ${reasons?.length > 0 && html`<details><summary>${text.answer.reasons}</summary>
      <ul>${reasons.map((one) => html`<li key=${one}>${one}</li>`)}</ul></details>`}
  </section>`;
}
