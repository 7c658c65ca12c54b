// Ask a question without tapping: two lists, kept in step with what is tapped on the plan or the picture.
import { html } from "../html.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

const KINDS = ["ball", "rail", "pocket"];
// Questions without a body.
const RULES = ["first", "score", "foul"];
const key = (body) => (body ? `${body.kind} ${body.id}` : "");

export function AskForm({ shot }) {
  const { doc } = useStore(shot.state);
  const { bodies, isAsking } = useStore(shot.desk);
  if (doc.kind === "rally") {
    return html`<div class="ask">${["landing", "net"].map((question) => html`<button key=${question} disabled=${isAsking}
      onClick=${() => shot.ask({ question })}>${text.ask.rally[question]}</button>`)}</div>`;
  }
  if (!doc.run) return null;
  const all = shot.listBodies();
  const balls = all.filter((body) => body.kind === "ball");
  const find = (name) => all.find((body) => key(body) === name);
  const [one, two] = bodies;
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
    <div class="ask-more">${RULES.map((question) => html`<button key=${question} id=${`ask-${question}`} disabled=${isAsking}
      onClick=${() => { shot.desk.set({ bodies: [] }); shot.ask({ question }); }}>${text.ask.rules[question]}</button>`)}</div>
  </div>`;
}
