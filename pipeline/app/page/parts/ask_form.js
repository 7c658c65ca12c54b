// Ask a question without tapping: two lists, kept in step with what is tapped on the plan or the picture.
import { html, useState } from "../html.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

const KINDS = ["ball", "rail", "pocket"];
// Questions without a body, by the games that they are of; null for all.
const RULES = { first: null, score: ["carom"], foul: ["pool", "snooker"] };
const key = (body) => (body ? `${body.kind} ${body.id}` : "");

export function AskForm({ shot }) {
  const { doc } = useStore(shot.state);
  const { bodies, isAsking } = useStore(shot.desk);
  const [on, setOn] = useState("");
  if (doc.kind === "rally") {
    return html`<div class="ask">${["landing", "net"].map((question) => html`<button key=${question} disabled=${isAsking}
      onClick=${() => shot.ask({ question })}>${text.ask.rally[question]}</button>`)}</div>`;
  }
  if (!doc.run) return null;
  const all = shot.listBodies();
  const balls = all.filter((body) => body.kind === "ball");
  const find = (name) => all.find((body) => key(body) === name);
  const [one, two] = bodies;
  const rules = Object.keys(RULES).filter((question) => RULES[question]?.includes(doc.game) ?? true);
  const askRule = (question) => { shot.desk.set({ bodies: [] }); shot.ask(question); };
  const choose = (first, second) => {
    shot.desk.set({ bodies: [] });
    if (first) shot.tap(first);
    if (first && second && key(first) !== key(second)) shot.tap(second);
  };
  const list = (name, value, empty, options, onChange) => html`<select id=${name} aria-label=${text.ask[name]}
    value=${value} onChange=${onChange}>
    <option value="">${empty}</option>
    ${KINDS.map((kind) => options.some((body) => body.kind === kind) && html`<optgroup key=${kind}
      label=${text.ask.kinds[kind]}>
      ${options.filter((body) => body.kind === kind).map((body) => html`<option key=${key(body)} value=${key(body)}
        selected=${key(body) === value}>${body.name}</option>`)}
    </optgroup>`)}</select>`;
  return html`<div class="ask" role="group" aria-label=${text.ask.label}>
    <span class="ask-words">${text.ask.did}</span>
    ${list("ask-one", key(one), text.ask.chooseBall, one && one.kind !== "ball" ? all : balls,
      (event) => choose(find(event.target.value), two))}
    <span class="ask-words">${text.ask.touch}</span>
    ${list("ask-two", key(two), text.ask.chooseOther, all.filter((body) => key(body) !== key(one)),
      (event) => choose(one, find(event.target.value)))}
    <div class="ask-more">${rules.map((question) => html`<button key=${question} id=${`ask-${question}`} disabled=${isAsking}
      onClick=${() => askRule(question === "foul" ? { question, on } : { question })}>${text.ask.rules[question]}</button>`)}</div>
    ${rules.includes("foul") && html`<label class="ask-words" for="ask-on">${text.ask.on}</label>
      <select id="ask-on" value=${on} onChange=${(event) => { setOn(event.target.value); askRule({ question: "foul", on: event.target.value }); }}>
        <option value="">${text.ask.onUnknown}</option>
        ${doc.balls_on.map((one) => html`<option key=${one} value=${one}>${text.ask.groups[one] ?? one}</option>`)}
        ${balls.map((body) => html`<option key=${key(body)} value=${body.id}>${body.name}</option>`)}
      </select>`}
  </div>`;
}
