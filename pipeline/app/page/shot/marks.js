// Corrections by hand as changes of the corrections of a shot. Ids of balls change when tracks are corrected, so that a
// correction names a ball by a frame and a place in it.
import { pointNear } from "./frames.js";

// Frames within which two contacts of the same bodies are one.
const NEAR_FRAMES = 2.5;
// Radii from a place within which a ball is the one that it names.
const NEAR_RADII = 2;
/** Kinds of events of a rally. */
export const RALLY_EVENTS = ["hit", "bounce", "net", "landing"];

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

/** Where corrections keep an event: those of a rally name no ball, since there is one. */
const listOf = (event) => (RALLY_EVENTS.includes(event.kind) ? "events" : "contacts");

export const isSameEvent = (one, two) => one.kind === two.kind && one.a === two.a && one.b === two.b
  && Math.abs(one.frame - two.frame) < NEAR_FRAMES;

const hasBodies = (run, mark, event) => mark.event
  || [event.a, event.b].includes(nameAt(run, mark.ball)) && (mark.cushion ?? event.b) === event.b;

/** The correction that stands for an event; undefined for an event that nobody set. */
export const findMark = (run, corrections, event) => (corrections[listOf(event)] ?? []).find((mark) => mark.kind !== "delete"
  && (mark.cause ?? mark.event) === event.kind && Math.abs((mark.to_frame ?? mark.frame) - event.frame) < NEAR_FRAMES
  && hasBodies(run, mark, event));

export const isEqual = (one, two) => JSON.stringify(one) === JSON.stringify(two);

/** Find an entry of a list of corrections, which another correction may have moved. */
export const findEntry = (corrections, list, entry) => corrections[list]?.find((one) => isEqual(one, entry));

/** Remove an entry of a list of corrections. */
export function drop(corrections, list, entry) {
  const found = findEntry(corrections, list, entry);
  corrections[list] = corrections[list]?.filter((one) => one !== found);
}

export const dropMark = (corrections, mark) => drop(corrections, mark.event ? "events" : "contacts", mark);

/** Mark a contact, or an event of a rally; it replaces what was set by hand for the same one, such as its deletion. */
export function markEvent(run, corrections, mark) {
  const bodies = (one) => one.event
    ?? [one.cause, ...[nameAt(run, one.ball), one.other ? nameAt(run, one.other) : one.cushion].sort()].join(" ");
  const isSame = (one) => Math.abs((one.to_frame ?? one.frame) - mark.frame) < NEAR_FRAMES && bodies(one) === bodies(mark);
  const list = mark.event ? "events" : "contacts";
  corrections[list] = (corrections[list] ?? []).filter((one) => !isSame(one));
  add(corrections, list, mark);
}

function describeMark(run, kind, event) {
  if (listOf(event) === "events") return { kind, event: event.kind, frame: Math.max(event.frame, 0) };
  const at = Math.round(event.frame);
  const contact = { kind, cause: event.kind, frame: Math.max(event.frame, 0), ball: placeOf(run, event.a, at) };
  if (event.kind === "ball") contact.other = placeOf(run, event.b, at);
  if (event.kind === "cushion") contact.cushion = event.b;
  return contact;
}

/** Say that a contact did not happen; one that was set by hand is taken back. */
export function deleteEvent(run, corrections, event) {
  const mark = findMark(run, corrections, event);
  if (mark) dropMark(corrections, mark);
  if (mark?.kind === "mark") return;
  add(corrections, listOf(event), mark ? { ...mark, kind: "delete", to_frame: undefined } : describeMark(run, "delete", event));
}

/** Say that a contact happened at another frame. */
export function moveEvent(run, corrections, event, to) {
  const mark = findMark(run, corrections, event);
  if (mark) mark[mark.kind === "move" ? "to_frame" : "frame"] = to;
  else add(corrections, listOf(event), { ...describeMark(run, "move", event), to_frame: to });
}

/** Set the id or the class of a ball, instead of what was set for it before. @param {"rename" | "class"} kind */
export function setBall(run, corrections, kind, id, frame, name) {
  corrections.tracks = (corrections.tracks ?? []).filter((edit) => edit.kind !== kind || nameAt(run, edit.ball) !== id);
  add(corrections, "tracks", { kind, ball: placeOf(run, id, frame), name });
}

/** Set the sport of a court, or with "" let the program recognise it; corners belong to the sport for which they were set. */
export function setSport(corrections, sport) {
  delete corrections.corners;
  if (sport) corrections.sport = sport;
  else delete corrections.sport;
}

/** Remove empty lists, which mean the same as none. */
export function tidy(corrections) {
  for (const name of ["balls", "tracks", "contacts", "events"]) if (corrections[name] && !corrections[name].length) delete corrections[name];
  return corrections;
}
