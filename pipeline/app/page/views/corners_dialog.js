// Mark the corners of a table or court that the program did not find, and run the clip again.
import { html, useEffect, useRef, useState } from "../html.js";
import { post } from "../api.js";
import { loadLibrary } from "../library_store.js";
import { Lens } from "../parts/lens.js";
import { text } from "../strings.js";

// Shares of the frame at which the handles begin, and beyond its edges that a corner may lie.
const START = [[0.2, 0.25], [0.8, 0.25], [0.8, 0.75], [0.2, 0.75]];
const BEYOND = 0.04;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
// px of the screen that an arrow key moves a corner, and with Shift.
const STEP_PX = 1;
const LONG_STEP_PX = 10;
const limit = (value) => Math.max(-BEYOND, Math.min(1 + BEYOND, value));

export function CornersDialog({ job, onClose }) {
  const [corners, setCorners] = useState(START);
  const [held, setHeld] = useState(null);
  const [sport, setSport] = useState("");
  const [error, setError] = useState("");
  const dialog = useRef(null);
  const picture = useRef(null);
  useEffect(() => { dialog.current.showModal(); }, []);
  const move = (number, [x, y]) => setCorners((before) => before.map((one, k) => (k === number ? [limit(x), limit(y)] : one)));
  const drag = (event, number) => {
    if (!event.currentTarget.hasPointerCapture(event.pointerId)) return;
    const box = picture.current.getBoundingClientRect();
    move(number, [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]);
  };
  const press = (event, number) => {
    const arrow = ARROWS[event.key];
    if (!arrow) return;
    event.preventDefault();
    const step = event.shiftKey ? LONG_STEP_PX : STEP_PX;
    const { clientWidth, clientHeight } = picture.current;
    const [x, y] = corners[number];
    move(number, [x + arrow[0] * step / clientWidth, y + arrow[1] * step / clientHeight]);
  };
  const take = (event, number) => {
    event.currentTarget.setPointerCapture(event.pointerId);
    setHeld(number);
  };
  const run = () => post(`api/jobs/${job.id}/corners`, { corners, sport }).then(() => {
    dialog.current?.close();
    return loadLibrary();
  }, (one) => setError(one.message));
  const { naturalWidth = 0, naturalHeight = 0 } = picture.current ?? {};
  const at = held === null ? null : [corners[held][0] * naturalWidth - 0.5, corners[held][1] * naturalHeight - 0.5];
  return html`<dialog ref=${dialog} class="corners" aria-labelledby="corners-title" onClose=${onClose}><div class="dialog-body">
    <h2 id="corners-title">${text.corners.title(job.name)}</h2>
    <p>${text.corners.hint}</p>
    <div class="corner-picture">
      <img id="corner-frame" ref=${picture} src=${`api/jobs/${job.id}/preview?r=${job.preview_revision}`} alt=${text.corners.picture} draggable=${false} />
      <svg viewBox="0 0 1 1" preserveAspectRatio="none" aria-hidden="true"><polygon class="table-line"
        points=${corners.map((one) => one.join(",")).join(" ")} /></svg>
      ${corners.map(([x, y], k) => html`<button key=${k} class="corner-handle" style=${{ left: `${100 * x}%`, top: `${100 * y}%` }}
        aria-label=${text.corners.handle(k + 1, x, y)} onPointerDown=${(event) => take(event, k)} onPointerMove=${(event) => drag(event, k)}
        onPointerUp=${() => setHeld(null)} onPointerCancel=${() => setHeld(null)} onFocus=${(event) => { if (event.target.matches(":focus-visible")) setHeld(k); }}
        onBlur=${() => setHeld(null)} onKeyDown=${(event) => press(event, k)}></button>`)}
      <${Lens} at=${at} image="corner-frame" />
    </div>
    <div class="row"><label for="corner-sport">${text.corners.what}</label>
      <select id="corner-sport" value=${sport} onChange=${(event) => setSport(event.target.value)}>
        ${Object.entries(text.corners.sports).map(([name, words]) => html`<option key=${name} value=${name}>${words}</option>`)}</select></div>
    ${error && html`<p role="alert" class="refusal">${error}</p>`}
    <div class="row"><button class="main" onClick=${run}>${text.corners.run}</button>
      <button onClick=${() => dialog.current.close()}>${text.app.cancel}</button></div>
  </div></dialog>`;
}
