// One shot of the page: its document, what is chosen on it, and what the server is asked about it.
import { post, read, send, shotAddress } from "../api.js";
import { library, notify, notifyError, shotChanges } from "../library_store.js";
import { createStore } from "../store.js";
import { Frames } from "./frames.js";
import { findBall, isEqual, isSameEvent, nameAt, tidy } from "./marks.js";
import { Player } from "./player.js";

// ms between two questions for the progress of a run that follows a correction.
const POLL_MS = 400;
export const CUSHIONS = ["left", "right", "top", "bottom"];

/** @typedef {{kind: "ball" | "rail" | "pocket", id: string, name: string}} Body */

export class ShotModel {
  constructor(id) {
    this.id = id;
    this.state = createStore({ doc: null, status: null, error: "" });
    // What is chosen and shown: `bodies` of the next question, the `answer`, `paths` played otherwise, `rings` of balls to
    // put back; of corrections the chosen ball or event, a `question` that waits for a click, the `cross` that places a ball.
    this.desk = createStore({
      tab: "story", bodies: [], answer: null, isAsking: false, played: null, rings: null,
      ball: null, event: null, question: null, cross: null, corners: null, check: -1, spot: null, keys: [], dragged: null,
      picture: "slow", zoom: 1,
    });
    this.player = null;
    this.asking = /** @type {AbortController | null} */ (null);
    this.timer = 0;
    this.epoch = 0; // rises when a correction is sent and when it is answered: what was read in between is of neither
    this.sending = /** @type {Promise<boolean> | null} */ (null);
    this.isClosed = false;
    this.revision = library.get().revision;
    this.stops = [shotChanges.subscribe(() => this.noteChange()), library.subscribe(() => this.noteVideo())];
    this.changes = shotChanges.get()[id] ?? 0;
  }

  get doc() { return this.state.get().doc; }
  get run() { return this.doc?.run ?? null; }
  get isRally() { return this.doc?.kind === "rally"; }
  get frame() { return this.player.frames.frameAt(this.player.clock.get().t); }
  /** Whether frames are shown instead of the slow motion: corrections and rings belong to pictures with nothing drawn on them. */
  get showsFrames() {
    const { picture, tab, rings } = this.desk.get();
    if (this.doc.clip === false) return false;
    return !this.doc.video || picture === "frames" || tab === "correct" || tab === "placement" && Boolean(rings);
  }

  get isUpToDate() { return this.doc.result === undefined || this.doc.result === this.doc.revision; }

  close() {
    this.isClosed = true;
    clearTimeout(this.timer);
    this.player?.pause();
    for (const stop of this.stops) stop();
  }

  address(rest) { return shotAddress(this.id, rest); }
  /** Address of a frame, which the browser keeps as long as the run folder is as it was. */
  frameAddress(frame) { return this.address(`frame/${frame}?version=${this.doc.version}`); }

  noteChange() {
    const count = shotChanges.get()[this.id] ?? 0;
    if (count === this.changes) return;
    this.changes = count;
    this.load();
  }

  /** Look for a shot that was not there yet, or for its slow motion, which is made last, whenever the library has changed. */
  noteVideo() {
    const { revision } = library.get();
    if (revision === this.revision) return;
    this.revision = revision;
    if (!this.doc?.video) this.load();
  }

  async load() {
    try {
      const { epoch } = this;
      const doc = await read(shotAddress(this.id));
      if (epoch === this.epoch) { this.setDoc(doc); return; }
      await this.sending;
      await this.load();
    } catch (error) {
      if (this.doc) notifyError(error);
      else this.state.set({ error: error.message });
    }
  }

  setDoc(doc) {
    if (this.isClosed) return;
    const before = this.doc;
    const frames = doc.run?.frames;
    if (frames && !this.player) this.player = new Player(new Frames(frames), doc.video);
    else if (frames) this.player.update(new Frames(frames), doc.video);
    const { ball, event } = this.desk.get();
    const changed = {};
    if (doc.run && ball && !findBall(doc.run, ball)) { // a corrected ball may have another id, at the same place
      const point = before?.run && findBall(before.run, ball)?.path[0];
      changed.ball = (point && nameAt(doc.run, { frame: point[0], x_px: point[1], y_px: point[2] })) ?? null;
    }
    if (doc.run && event) changed.event = doc.run.events.find((one) => isSameEvent(one, event)) ?? null;
    if (doc.run) changed.keys = assignKeys(doc.run, this.desk.get().keys);
    if (before?.result !== doc.result) Object.assign(changed, { played: null, rings: null });
    this.desk.set(changed);
    this.state.set({ doc, error: "", status: doc.outputs === undefined ? this.state.get().status : doc });
    if (doc.notice && doc.notice !== before?.notice) notify(doc.notice);
    const isNew = before?.result !== doc.result || before?.version !== doc.version;
    if (isNew && (doc.run || this.desk.get().answer)) this.askAgain();
    if (!this.isUpToDate || doc.stage) this.follow();
  }

  /** Follow the run of the present corrections until its result is shown. */
  follow() {
    clearTimeout(this.timer);
    this.timer = setTimeout(async () => {
      try {
        const status = await read(this.address("status"));
        const before = this.state.get().status;
        if (status.error && status.error !== before?.error) notify(status.error, { kind: "error" });
        this.state.set({ status });
        if (status.revision !== this.doc.revision || status.result !== this.doc.result) await this.load();
        if (status.stage || status.result !== status.revision && !status.error) this.follow();
      } catch (error) {
        if (!this.isClosed) this.follow(); // the connection is lost for a while; the page says so
      }
    }, POLL_MS);
  }

  /**
   * Change the corrections.
   * @param {(corrections: object, seen: {run: object, frame: number}) => void} edit is called when earlier corrections
   *   are sent, with what the person sees now
   * @param {(error: Error) => void} onRefusal says why a change cannot be made
   */
  change(edit, onRefusal = notifyError) {
    const seen = { run: this.run, frame: this.player ? this.frame : 0 };
    return this.correct("PUT", "corrections", () => {
      const next = structuredClone(this.doc.corrections);
      edit(next, seen);
      return tidy(next);
    }, onRefusal);
  }

  undo() { return this.correct("POST", "undo"); }
  redo() { return this.correct("POST", "redo"); }
  finish() { return this.correct("POST", "finish"); }

  /** Send a correction after those that are being sent: each is a change of the one before, and none is lost. */
  async correct(method, path, makeBody, onRefusal = notifyError) {
    while (this.sending) await this.sending;
    if (!this.doc) return false;
    this.sending = this.send(method, path, makeBody, onRefusal);
    try {
      return await this.sending;
    } finally {
      this.sending = null;
    }
  }

  async send(method, path, makeBody, onRefusal) {
    try {
      const body = makeBody?.();
      if (body && isEqual(body, this.doc.corrections)) return true; // of a second click
      this.epoch += 1;
      const status = await send(method, this.address(path), { body, headers: { "If-Match": `"${this.doc.revision}"` } });
      this.epoch += 1;
      this.state.set({ status });
      if (body) this.state.set({ doc: { ...this.doc, corrections: body, revision: status.revision } });
      else await this.load();
      this.follow();
      return true;
    } catch (error) {
      this.epoch += 1;
      onRefusal(error);
      if (error.status === 412) await this.load();
      return false;
    }
  }

  /** Ask an umpire's question; an answer to an earlier one must not follow. @param {{question: string, a?: string, b?: string}} question */
  async ask(question) {
    this.asking?.abort();
    const request = new AbortController();
    this.asking = request;
    this.desk.set({ isAsking: true });
    try {
      this.desk.set({ answer: { asked: question, ...await post(this.address("ask"), question, request.signal) } });
    } catch (error) {
      if (error.name !== "AbortError") this.desk.set({ answer: { asked: question, error: error.message } });
    } finally {
      if (this.asking === request) this.desk.set({ isAsking: false });
    }
  }

  /** Ask the last question again, or the first one where there is none, or where it is about a ball that has gone. */
  askAgain() {
    const { answer, bodies } = this.desk.get();
    const ids = this.run && !this.isRally ? ["", ...this.listBodies().map((body) => body.id)] : null;
    const isKnown = ({ a = "", b = "" }) => !ids || ids.includes(a) && ids.includes(b);
    if (ids && !bodies.every((body) => ids.includes(body.id))) this.desk.set({ bodies: [] });
    return this.ask(answer && isKnown(answer.asked) ? answer.asked : { question: this.isRally ? "landing" : "first" });
  }

  /** Choose a body of the next question; two bodies, one of them a ball, are a question. @param {Body} body */
  tap(body) {
    const { bodies } = this.desk.get();
    const [first] = bodies.length === 1 ? bodies : [];
    if (first?.id === body.id && first.kind === body.kind) return this.desk.set({ bodies: [] });
    if (!first || first.kind !== "ball" && body.kind !== "ball") return this.desk.set({ bodies: [body] });
    const [ball, other] = first.kind === "ball" ? [first, body] : [body, first];
    this.desk.set({ bodies: [ball, other] });
    return this.ask({ question: { ball: "touch", rail: "rail", pocket: "pocket" }[other.kind], a: ball.id, b: other.id });
  }

  /** Bodies of the shot that questions can be about. @returns {Body[]} */
  listBodies() {
    const { run, plan } = this.doc;
    return [
      ...run.balls.map(({ id, name }) => ({ kind: "ball", id, name })),
      ...CUSHIONS.map((id) => ({ kind: "rail", id, name: run.rails[id] ?? id })),
      ...(plan?.pockets ?? []).map(({ name, label }) => ({ kind: "pocket", id: name, name: label })),
    ];
  }

  showEvent(event) {
    this.player.pause();
    this.player.seek(event.t);
    this.desk.set({ event, ball: null, spot: null });
  }

  /** Go to the next contact, or with -1 to the one before. */
  stepEvent(step) {
    const { t } = this.player.clock.get();
    const events = (this.run?.events ?? []).filter((one) => one.kind !== "rest");
    const next = step > 0 ? events.find((one) => one.t > t + 1e-3) : events.findLast((one) => one.t < t - 1e-3);
    if (next) this.showEvent(next);
  }
}

/** Give every ball a number key that it keeps, whatever the ball is called. */
function assignKeys(run, before) {
  const kept = new Map();
  for (const [key, place] of before) {
    const id = nameAt(run, place);
    if (id && !kept.has(id)) kept.set(id, key);
  }
  const used = new Set(kept.values());
  for (const { id } of run.balls) {
    for (let key = 1; !kept.has(id); key += 1) if (!used.has(key)) { kept.set(id, key); used.add(key); }
  }
  return run.balls.filter((ball) => ball.path.length)
    .map(({ id, path: [[frame, x, y]] }) => [kept.get(id), { frame, x_px: x, y_px: y }, id]);
}

