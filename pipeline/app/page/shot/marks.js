// Corrections by hand as changes of the corrections of a shot. Ids of balls change when tracks are corrected, so that a
// correction names a ball by a frame and a place in it.
import { pointNear } from "./frames.js";

// Frames within which two contacts of the same bodies are one.
const NEAR_FRAMES = 2.5;
// Radii from a place within which a ball is the one that it names.
const NEAR_RADII = 2;

/** @typedef {{frame: number, x_px: number, y_px: number, id?: string}} Place */

export const findBall = (run, id) => run.balls.find((ball) => ball.id === id);
export const round = (value) => Math.round(100 * value) / 100;
export const add = (corrections, list, entry) => { corrections[list] = [...(corrections[list] ?? []), entry]; };

/** How corrections name a ball. @returns {Place | null} */
export function placeOf(run, id, frame) {
  const point = pointNear(findBall(run, id)?.path ?? [], frame);
  return point && { frame: point[0], x_px: point[1], y_px: point[2], id };
}

/** Id of the ball that is now at a place. @param {Place} place */
export function nameAt(run, place) {
  let best = null;
  for (const ball of run.balls) {
    const point = pointNear(ball.path, place.frame);
    const distance = point && Math.hypot(point[1] - place.x_px, point[2] - place.y_px) / ball.radius;
    if (point && distance < NEAR_RADII && (!best || distance < best[0])) best = [distance, ball.id];
  }
  return best?.[1];
}

export const isSameEvent = (one, two) => one.kind === two.kind && one.a === two.a && one.b === two.b
  && Math.abs(one.frame - two.frame) < NEAR_FRAMES;

/** The correction that stands for an event; undefined for an event that nobody set. */
export const findMark = (run, corrections, event) => (corrections.contacts ?? []).find((mark) => mark.kind !== "delete"
  && mark.cause === event.kind && Math.abs((mark.to_frame ?? mark.frame) - event.frame) < NEAR_FRAMES
  && [event.a, event.b].includes(nameAt(run, mark.ball)) && (mark.cushion ?? event.b) === event.b);

const isEqual = (one, two) => JSON.stringify(one) === JSON.stringify(two);

export function dropContact(corrections, mark) {
  corrections.contacts = corrections.contacts.filter((one) => !isEqual(one, mark));
}

/** Mark a contact; it replaces what was set by hand for the same contact, such as its deletion. */
export function markContact(run, corrections, mark) {
  const bodies = (one) => [nameAt(run, one.ball), one.other ? nameAt(run, one.other) : one.cushion].sort().join(" ");
  const isSame = (one) => one.cause === mark.cause && Math.abs((one.to_frame ?? one.frame) - mark.frame) < NEAR_FRAMES
    && bodies(one) === bodies(mark);
  corrections.contacts = (corrections.contacts ?? []).filter((one) => !isSame(one));
  add(corrections, "contacts", mark);
}

function describeContact(run, kind, event) {
  const at = Math.round(event.frame);
  const contact = { kind, cause: event.kind, frame: Math.max(event.frame, 0), ball: placeOf(run, event.a, at) };
  if (event.kind === "ball") contact.other = placeOf(run, event.b, at);
  if (event.kind === "cushion") contact.cushion = event.b;
  return contact;
}

/** Say that a contact did not happen; one that was set by hand is taken back. */
export function deleteEvent(run, corrections, event) {
  const mark = findMark(run, corrections, event);
  if (mark) dropContact(corrections, mark);
  if (mark?.kind === "mark") return;
  add(corrections, "contacts", mark ? { ...mark, kind: "delete", to_frame: undefined } : describeContact(run, "delete", event));
}

/** Say that a contact happened at another frame. */
export function moveEvent(run, corrections, event, to) {
  const mark = findMark(run, corrections, event);
  if (mark) mark[mark.kind === "move" ? "to_frame" : "frame"] = to;
  else add(corrections, "contacts", { ...describeContact(run, "move", event), to_frame: to });
}

/** Set the id or the class of a ball, instead of what was set for it before. @param {"rename" | "class"} kind */
export function setBall(run, corrections, kind, id, frame, name) {
  corrections.tracks = (corrections.tracks ?? []).filter((edit) => edit.kind !== kind || nameAt(run, edit.ball) !== id);
  add(corrections, "tracks", { kind, ball: placeOf(run, id, frame), name });
}

/** Remove empty lists, which mean the same as none. */
export function tidy(corrections) {
  for (const name of ["balls", "tracks", "contacts"]) if (corrections[name] && !corrections[name].length) delete corrections[name];
  return corrections;
}
