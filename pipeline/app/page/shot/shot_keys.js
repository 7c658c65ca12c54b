// Keys of the view of a shot.
import {
  cancelCorrection, finishDrag, goToCheck, listActions, moveCorner, pickBall, placeBall, startPlacing,
} from "./hand_tools.js";
import { deleteEvent, moveEvent } from "./marks.js";
import { PACES } from "./player.js";

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
// Frames of a step with Shift.
const LONG_STEP = 10;
// ms after the last key from which a moved corner is sent.
const CORNER_WAIT_MS = 700;
const PACE_KEYS = { 1: PACES[0], 8: PACES[1], 3: PACES[2] };
let cornerTimer = 0;

/** Handle a key; returns whether it meant something. @param {KeyboardEvent} event */
export function handleShotKey(shot, event) {
  const { target } = event;
  if (!shot.player || event.altKey || document.querySelector("dialog[open]")) return false;
  if (target.matches?.("input:not([type=checkbox]):not([type=range]), select, textarea")) return false;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if ((event.ctrlKey || event.metaKey) && !["z", "y"].includes(key)) return false;
  const isCorrecting = shot.desk.get().tab === "correct" && shot.run;
  return Boolean(isCorrecting && handleCorrectionKey(shot, key, event)) || handlePlayerKey(shot, key, event, isCorrecting);
}

function handlePlayerKey(shot, key, { target, shiftKey }, isCorrecting) {
  const isSlider = target.matches?.("input[type=range]") && target.id !== "slider";
  if ((key === "ArrowLeft" || key === "ArrowRight") && !isSlider) {
    shot.player.step(ARROWS[key][0] * (shiftKey ? LONG_STEP : 1));
  } else if (key === " " && !target.matches?.("button, summary, a")) shot.player.toggle();
  else if (key === "n" || key === "p") shot.stepEvent(key === "n" ? 1 : -1);
  else if (!isCorrecting && PACE_KEYS[key]) shot.player.setPace(PACE_KEYS[key]);
  else if (key === "Escape") shot.desk.set({ bodies: [] });
  else return false;
  return true;
}

function handleCorrectionKey(shot, key, event) {
  const desk = shot.desk.get();
  const arrow = ARROWS[key];
  const corner = event.target.dataset?.corner;
  if (arrow && corner !== undefined) {
    const step = event.shiftKey ? 5 : 0.5;
    moveCorner(shot, Number(corner), arrow[0] * step, arrow[1] * step);
    clearTimeout(cornerTimer);
    cornerTimer = setTimeout(() => finishDrag(shot), CORNER_WAIT_MS);
  } else if (desk.question?.point && arrow) {
    const step = event.shiftKey ? 10 : 1;
    shot.desk.set({ cross: [desk.cross[0] + arrow[0] * step, desk.cross[1] + arrow[1] * step] });
  } else if (desk.question?.point && key === "Enter") placeBall(shot);
  else if (key === "Escape") cancelCorrection(shot);
  else if (key === "y" || key === "z") {
    if (event.repeat) return true; // a key that is held is one step
    if (event.shiftKey || key === "y") shot.redo(); else shot.undo();
  }
  else if (key === "d") goToCheck(shot, desk.check + (event.shiftKey ? -1 : 1));
  else if (key === "b") startPlacing(shot);
  else return handleChoiceKey(shot, key === "Backspace" ? "Delete" : key, desk);
  return true;
}

function handleChoiceKey(shot, key, { keys, event, ball, question }) {
  const numbered = keys.find((one) => String(one[0]) === key);
  const action = Object.values(listActions(shot)).find((one) => one.key === key);
  if (numbered) pickBall(shot, numbered[2]);
  else if (event && key === "Delete") {
    shot.desk.set({ event: null });
    shot.change((c, { run }) => deleteEvent(run, c, event));
  } else if (event && key === "v") shot.change((c, { run, frame }) => moveEvent(run, c, event, frame));
  else if (ball && action && !question) action.run(shot, ball);
  else return false;
  return true;
}
