// What a person does to correct a shot: choose a ball or an event, answer "with which?", drag corners, place a ball.
import { text } from "../strings.js";
import { add, findBall, markEvent, placeOf, round } from "./marks.js";

// Frames between a place to check and the event that it is about.
const NEAR_FRAMES = 2.5;

const RESET = { question: null, cross: null, dragged: null };

/** Whether the corners belong to the shown frame: those of a moving camera are of the first one. */
export const showsCorners = (shot) => !shot.run.moves || shot.player.clock.get().row === 0;
export const shownCorners = (shot) => shot.desk.get().corners
  ?? (shot.isUpToDate ? shot.run.corners : shot.doc.corrections.corners ?? shot.run.corners);

export function pickBall(shot, id) {
  const { question, ball } = shot.desk.get();
  if (question?.balls && id !== ball) {
    shot.desk.set(RESET);
    question.done({ ball: id });
  } else if (!question) shot.desk.set({ ball: id, event: null, spot: null });
}

export function pickCushion(shot, cushion) {
  const { question } = shot.desk.get();
  if (!question?.cushions) return;
  shot.desk.set(RESET);
  question.done({ cushion });
}

/** Give up the open question; without one, the choice of a ball or an event. */
export function cancelCorrection(shot) {
  const { question } = shot.desk.get();
  shot.desk.set(question ? RESET : { ...RESET, ball: null, event: null, spot: null });
}

export function moveCorner(shot, number, dx, dy, movesAll = document.getElementById("all-corners")?.checked) {
  const corners = shownCorners(shot).map(([x, y], k) => (movesAll || k === number ? [x + dx, y + dy] : [x, y]));
  shot.desk.set({ corners, dragged: corners[number] });
}

/** Send the corners that were moved; until that is done, or they are moved again, they stay where they were put. */
export async function finishDrag(shot) {
  const { corners } = shot.desk.get();
  shot.desk.set({ dragged: null });
  if (!corners) return;
  await shot.change((c, { run }) => {
    c.corners = corners.map((corner) => corner.map(round));
    if (shot.isRally) c.sport ??= run.table.name; // else they would be those of a table
  });
  if (shot.desk.get().corners === corners) shot.desk.set({ corners: null });
}

export function startPlacing(shot) {
  const [width, height] = shot.run.image;
  const question = { point: true, words: text.correct.askPlace };
  shot.desk.set({ ball: null, event: null, cross: [width / 2, height / 2], question });
}

export function placeBall(shot) {
  const [x, y] = shot.desk.get().cross.map(round);
  const { frame } = shot;
  shot.desk.set(RESET);
  shot.change((c) => {
    if (shot.isRally) c.balls = c.balls?.filter((one) => one.kind !== "placed" || one.ball.frame !== frame); // there is one
    add(c, "balls", { kind: "placed", ball: { frame, x_px: x, y_px: y } });
  });
}

/** Go to a place where the explanation of the shot is least sure. */
export function goToCheck(shot, number) {
  const { checks, events, balls } = shot.run;
  if (!checks.length) return;
  const check = (number + checks.length) % checks.length;
  const place = checks[check];
  const event = events.find((one) => Math.abs(one.frame - place.frame) < NEAR_FRAMES && place.balls.includes(one.a)) ?? null;
  shot.player.showRow(shot.player.frames.rowOf(place.frame));
  const ball = event ? null : place.balls.find((id) => findBall({ balls }, id)) ?? null;
  shot.desk.set({ ...RESET, check, spot: place.px, event, ball });
}

const nameBall = (shot, id) => findBall(shot.run, id).name;
const mark = (shot, event) => shot.change((c, { run }) => markEvent(run, c, { kind: "mark", ...event }));
const editTrack = (shot, edit) => shot.change((c) => add(c, "tracks", edit));

/** Let a person point at another ball, and with `cushions` also at a cushion. */
const askWhich = (shot, words, done, cushions = false) => shot.desk.set({ question: { balls: true, cushions, words, done } });

function exchange(shot, id) {
  askWhich(shot, text.correct.askSwap(nameBall(shot, id), shot.frame), ({ ball }) => {
    const [one, two] = [id, ball].map((name) => placeOf(shot.run, name, shot.frame));
    editTrack(shot, { kind: "swap", ball: one, other: two, first: shot.frame });
  });
}

function join(shot, id) {
  askWhich(shot, text.correct.askMerge(nameBall(shot, id)), ({ ball }) => {
    const [one, two] = [id, ball].map((name) => placeOf(shot.run, name, shot.frame));
    editTrack(shot, { kind: "merge", ball: one, other: two });
  });
}

function touch(shot, id) {
  askWhich(shot, text.correct.askContact(nameBall(shot, id), shot.frame), ({ ball, cushion }) => {
    const { frame, run } = shot;
    const other = ball ? { cause: "ball", other: placeOf(run, ball, frame) } : { cause: "cushion", cushion };
    mark(shot, { frame, ball: placeOf(run, id, frame), ...other });
  }, true);
}

function reject(shot, id) {
  const ball = placeOf(shot.run, id, shot.frame);
  shot.desk.set({ ball: null });
  shot.change((c) => add(c, "balls", { kind: "false", ball }));
}

const split = (shot, id) => editTrack(shot, { kind: "split", ball: placeOf(shot.run, id, shot.frame), first: shot.frame });
const strike = (shot, id) => mark(shot, { cause: "strike", frame: shot.frame, ball: placeOf(shot.run, id, shot.frame) });

/** Say that an event of a rally happened at the shown frame. */
export const markHere = (shot, event) => mark(shot, { event, frame: shot.frame });

/** Actions on the chosen ball, by name: their key, and what they do. */
const BALL_ACTIONS = {
  swap: { key: "x", run: exchange },
  merge: { key: "m", run: join },
  split: { key: "s", run: split },
  contact: { key: "c", run: touch },
  strike: { key: "k", run: strike },
  none: { key: "Delete", isDanger: true, run: reject },
};

/** The actions that a shot, or a rally with its one ball, allows. */
export const listActions = ({ isRally }) => (isRally ? { none: BALL_ACTIONS.none } : BALL_ACTIONS);
