// What a person does to correct a shot: choose a ball or an event, answer "with which?", drag corners, place a ball.
import { text } from "../strings.js";
import { add, findBall, markContact, placeOf, round } from "./marks.js";

// Frames between a place to check and the event that it is about.
const NEAR_FRAMES = 2.5;

const RESET = { question: null, cross: null, dragged: null };

export const showsCorners = (shot) => !shot.run.moves || shot.player.clock.get().row === 0; // a moving camera's are of its first frame
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

export function finishDrag(shot) {
  const { corners } = shot.desk.get();
  shot.desk.set({ dragged: null });
  if (corners) shot.change((c) => { c.corners = corners.map((corner) => corner.map(round)); });
}

export function startPlacing(shot) {
  const [width, height] = shot.run.image;
  shot.desk.set({ ball: null, event: null, cross: [width / 2, height / 2], question: { point: true, words: text.correct.askPlace } });
}

export function placeBall(shot) {
  const [x, y] = shot.desk.get().cross.map(round);
  const { frame } = shot;
  shot.desk.set(RESET);
  shot.change((c) => add(c, "balls", { kind: "placed", ball: { frame, x_px: x, y_px: y } }));
}

/** Go to a place where the explanation of the shot is least sure. */
export function goToCheck(shot, number) {
  const { checks, events, balls } = shot.run;
  if (!checks.length) return;
  const check = (number + checks.length) % checks.length;
  const place = checks[check];
  const event = events.find((one) => Math.abs(one.frame - place.frame) < NEAR_FRAMES && place.balls.includes(one.a)) ?? null;
  shot.player.showRow(shot.player.frames.rowOf(place.frame));
  shot.desk.set({ ...RESET, check, spot: place.px, event, ball: event ? null : place.balls.find((id) => findBall({ balls }, id)) ?? null });
}

const mark = (shot, contact) => shot.change((c) => markContact(shot.run, c, contact));

/** Actions on the chosen ball, by name: their key, and what they do. */
export const BALL_ACTIONS = {
  swap: { key: "x", run: (shot, id) => shot.desk.set({ question: { balls: true, words: text.correct.askSwap(findBall(shot.run, id).name, shot.frame),
    done: ({ ball }) => { const first = shot.frame; const [one, two] = [id, ball].map((name) => placeOf(shot.run, name, first));
      shot.change((c) => add(c, "tracks", { kind: "swap", ball: one, other: two, first })); } } }) },
  merge: { key: "m", run: (shot, id) => shot.desk.set({ question: { balls: true, words: text.correct.askMerge(findBall(shot.run, id).name),
    done: ({ ball }) => { const [one, two] = [id, ball].map((name) => placeOf(shot.run, name, shot.frame));
      shot.change((c) => add(c, "tracks", { kind: "merge", ball: one, other: two })); } } }) },
  split: { key: "s", run: (shot, id) => shot.change((c) => add(c, "tracks", { kind: "split", ball: placeOf(shot.run, id, shot.frame), first: shot.frame })) },
  contact: { key: "c", run: (shot, id) => shot.desk.set({ question: { balls: true, cushions: true,
    words: text.correct.askContact(findBall(shot.run, id).name, shot.frame),
    done: ({ ball, cushion }) => { const { frame, run } = shot; const one = placeOf(run, id, frame);
      mark(shot, ball ? { kind: "mark", cause: "ball", frame, ball: one, other: placeOf(run, ball, frame) }
        : { kind: "mark", cause: "cushion", frame, ball: one, cushion }); } } }) },
  strike: { key: "k", run: (shot, id) => mark(shot, { kind: "mark", cause: "strike", frame: shot.frame, ball: placeOf(shot.run, id, shot.frame) }) },
  none: { key: "Delete", isDanger: true, run: (shot, id) => { const ball = placeOf(shot.run, id, shot.frame);
    shot.desk.set({ ball: null }); shot.change((c) => add(c, "balls", { kind: "false", ball })); } },
};

