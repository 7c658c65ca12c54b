// The clock of a shot: it plays the slow motion where there is one, else the frames, and everything shown follows it.
import { createStore } from "../store.js";
import { interpolate } from "./frames.js";

/** How many times slower than reality a shot can be played. */
export const PACES = [1, 8, 32];

export class Player {
  /** @param {import("./frames.js").Frames} frames @param {{map: number[][]} | null} video times of the video and of the clip */
  constructor(frames, video) {
    this.frames = frames;
    this.map = video?.map ?? null;
    this.clock = createStore({ t: frames.start, isPlaying: false, pace: 8, row: 0 });
    this.video = null;
    this.request = 0;
  }

  /** Follow frames and slow motion that were made anew. */
  update(frames, video) {
    this.frames = frames;
    this.map = video?.map ?? null;
  }

  /** Times that a video plays slower than reality. */
  get factor() {
    const [first, last] = [this.map[0], this.map.at(-1)];
    return (last[0] - first[0]) / (last[1] - first[1]);
  }

  toVideo(t) { return interpolate(this.map.map((one) => one[1]), this.map.map((one) => one[0]), t); }
  toClip(seconds) { return interpolate(this.map.map((one) => one[0]), this.map.map((one) => one[1]), seconds); }

  /** Play with a video element; null: with frames. */
  attach(video) {
    const { isPlaying } = this.clock.get();
    if (isPlaying) this.pause();
    this.video = video;
    if (!video) return;
    this.seek(this.clock.get().t);
    video.addEventListener("ended", () => this.pause());
    video.addEventListener("loadedmetadata", () => this.seek(this.clock.get().t), { once: true });
  }

  setTime(t) { this.clock.set({ t, row: this.frames.rowAt(t) }); }

  seek(t) {
    const inside = Math.max(this.frames.start, Math.min(this.frames.end, t));
    if (this.video) this.video.currentTime = this.toVideo(inside);
    this.setTime(inside);
  }

  showRow(row) {
    this.pause();
    const { distinct } = this.frames;
    this.seek(this.frames.timeOf(distinct[Math.max(0, Math.min(distinct.length - 1, row))]));
  }

  step(count) { this.showRow(this.clock.get().row + count); }

  setPace(pace) {
    this.clock.set({ pace });
    if (this.video) this.video.playbackRate = this.factor / pace;
  }

  toggle() { if (this.clock.get().isPlaying) this.pause(); else this.play(); }

  play() {
    if (this.clock.get().t >= this.frames.end - 1e-3) this.seek(this.frames.start);
    this.clock.set({ isPlaying: true });
    if (this.video) {
      this.setPace(this.clock.get().pace);
      this.video.play().catch(() => this.pause()); // a browser may refuse to play
    }
    let before = performance.now();
    const tick = (now) => {
      if (!this.clock.get().isPlaying) return;
      if (this.video) this.setTime(this.toClip(this.video.currentTime));
      else this.setTime(Math.min(this.frames.end, this.clock.get().t + (now - before) / 1000 / this.clock.get().pace));
      before = now;
      if (this.clock.get().t >= this.frames.end - 1e-4) this.pause();
      else this.request = requestAnimationFrame(tick);
    };
    this.request = requestAnimationFrame(tick);
  }

  pause() {
    cancelAnimationFrame(this.request);
    this.video?.pause();
    this.clock.set({ isPlaying: false });
  }
}
