// What can be said of the chosen ball or event.
import { html, useState } from "../html.js";
import { cancelCorrection, listActions, pickBall, pickCushion } from "../shot/hand_tools.js";
import { deleteEvent, findBall, moveEvent, RALLY_EVENTS, setBall } from "../shot/marks.js";
import { CUSHIONS } from "../shot/shot_model.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

// Kinds of events that a person can move or delete; the others follow from the motion.
const MARKED = ["strike", "ball", "cushion", ...RALLY_EVENTS];

export function Selection({ shot }) {
  const { doc } = useStore(shot.state);
  const { ball: id, event, question } = useStore(shot.desk);
  const ball = findBall(doc.run, id);
  if (!ball && !event) return null;
  return html`<section id="selection" class="selection" aria-live="polite">
    ${ball && question && html`<${Question} shot=${shot} ball=${ball} question=${question} />`}
    ${ball && !question && html`<${BallPanel} key=${ball.id} shot=${shot} ball=${ball} classes=${doc.run.classes} />`}
    ${!ball && html`<${EventPanel} key=${`${event.kind} ${event.frame}`} shot=${shot} event=${event} />`}
  </section>`;
}

function Question({ shot, ball, question }) {
  const { balls, rails } = shot.run;
  return html`<h2>${question.words}</h2><div class="row">
    ${question.balls && balls.filter((one) => one.id !== ball.id).map((one) => html`<button key=${one.id}
      onClick=${() => pickBall(shot, one.id)}>${one.name}</button>`)}
    ${question.cushions && CUSHIONS.map((side) => html`<button key=${side}
      onClick=${() => pickCushion(shot, side)}>${rails[side]}</button>`)}
  </div><button onClick=${() => cancelCorrection(shot)}>${text.correct.cancel}</button>`;
}

function BallPanel({ shot, ball, classes }) {
  const [name, setName] = useState(ball.id);
  const rename = (event) => {
    event.preventDefault();
    const wanted = name.trim();
    document.activeElement.blur();
    shot.change((c, seen) => setBall(seen.run, c, "rename", ball.id, seen.frame, wanted))
      .then((isDone) => { if (isDone) shot.desk.set({ ball: wanted }); });
  };
  return html`<h2>${ball.name}</h2>
    <div class="row">${Object.entries(listActions(shot)).map(([action, one]) => html`<button key=${action} data-action=${action}
      class=${one.isDanger ? "danger" : ""}
      onClick=${() => one.run(shot, ball.id)}>${text.correct.actions[action]} <kbd>${text.correct.keyName(one.key)}</kbd>
        </button>`)}</div>
    ${shot.isRally ? html`<p class="small">${text.correct.falseBall}</p>` : html`<div class="row" role="group"
      aria-label=${text.correct.classLabel}>${classes.map((kind) => html`<button key=${kind} data-class=${kind}
      aria-pressed=${kind === ball.kind}
      onClick=${() => shot.change((c, seen) => setBall(seen.run, c, "class", ball.id, seen.frame, kind))}>${text.classes[kind] ?? kind}
        </button>`)}</div>
    <form class="row" onSubmit=${rename}><label for="ball-name">${text.correct.id}</label>
      <input id="ball-name" value=${name} maxlength="32" autocomplete="off" spellcheck=${false}
        onInput=${(event) => setName(event.target.value)} />
      <button>${text.correct.rename}</button></form>`}`;
}

function EventPanel({ shot, event }) {
  const { row } = useStore(shot.player.clock);
  const frame = shot.player.frames.distinct[row];
  const [exact, setExact] = useState(event.frame.toFixed(2));
  const move = (to) => shot.change((c, { run }) => moveEvent(run, c, event, to));
  const submit = (submitted) => {
    submitted.preventDefault();
    document.activeElement.blur();
    if (exact !== "") move(Number(exact));
  };
  return html`<h2>${event.text}</h2><p class="small">${text.correct.eventFacts(event)}</p>
    ${!MARKED.includes(event.kind) ? html`<p class="small">${text.correct.follows}</p>` : html`
      <div class="row"><button class="danger" data-action="delete"
        onClick=${() => { shot.desk.set({ event: null }); shot.change((c, { run }) => deleteEvent(run, c, event)); }}>
          ${text.correct.didNotHappen} <kbd>${text.correct.keyName("Delete")}</kbd></button>
        <button data-action="move"
          onClick=${() => move(frame)}>${text.correct.happenedAt(frame)} <kbd>${text.correct.keyName("v")}</kbd></button>
          </div>
      <form class="row" onSubmit=${submit}>
        <label for="exact">${text.correct.atFrame}</label><input id="exact" type="number" step="0.05" min="0" value=${exact}
          onInput=${(input) => setExact(input.target.value)} />
        <button>${text.correct.set}</button></form>`}`;
}
