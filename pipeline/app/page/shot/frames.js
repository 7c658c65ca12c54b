// Times, frames and places of a shot. Pure functions.

/** Return the index of the last value of an ascending list that is at most `value`; 0 if none is. */
export function findBefore(list, value) {
  let low = 0;
  let high = list.length - 1;
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (list[middle] <= value) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Interpolate linearly in two lists, the first ascending; constant beyond their ends. */
export function interpolate(x, y, at) {
  const k = findBefore(x, at);
  if (k + 1 >= x.length || at <= x[0]) return y[at <= x[0] ? 0 : k];
  return y[k] + (y[k + 1] - y[k]) * (at - x[k]) / (x[k + 1] - x[k]);
}

/** Frames of a clip: `distinct` are the numbers without duplicates, `t` the time of every frame from `first` on. */
export class Frames {
  constructor({ first, distinct, t }) {
    Object.assign(this, { first, distinct, t });
    this.start = t[distinct[0] - first] ?? 0;
    this.end = t[distinct.at(-1) - first] ?? 0;
  }

  timeOf(frame) {
    const k = Math.floor(frame) - this.first;
    const [before, after] = [this.t[k] ?? this.end, this.t[k + 1] ?? this.t[k] ?? this.end];
    return before + (after - before) * (frame - Math.floor(frame));
  }

  /** Index of the distinct frame nearest to a time. */
  rowAt(t) {
    const k = findBefore(this.distinct, this.first + findBefore(this.t, t + 1e-6));
    const next = this.distinct[k + 1];
    return next !== undefined && this.timeOf(next) - t < t - this.timeOf(this.distinct[k]) ? k + 1 : k;
  }

  frameAt(t) { return this.distinct[this.rowAt(t)]; }

  /** Index of the distinct frame nearest to a frame number. */
  rowOf(number) {
    const k = findBefore(this.distinct, number);
    const next = this.distinct[k + 1];
    return next !== undefined && next - number < number - this.distinct[k] ? k + 1 : k;
  }
}

/** Point [frame, x, y, observed] of a path in a frame, or in the nearest frame that has one. */
export function pointNear(path, frame) {
  if (!path.length) return null;
  const k = findBefore(path.map((point) => point[0]), frame);
  const next = path[k + 1];
  return next && Math.abs(next[0] - frame) < Math.abs(path[k][0] - frame) ? next : path[k];
}

/** Place [x, y] in the image at a fractional frame; null where the path has no point within two frames. */
export function pixelAt(path, frame) {
  const k = findBefore(path.map((point) => point[0]), frame);
  const [one, two] = [path[k], path[k + 1]];
  if (!one || Math.abs(one[0] - frame) > 2 && (!two || Math.abs(two[0] - frame) > 2)) return null;
  if (!two || frame <= one[0]) return [one[1], one[2]];
  const share = (frame - one[0]) / (two[0] - one[0]);
  return [one[1] + share * (two[1] - one[1]), one[2] + share * (two[2] - one[2])];
}

// s before and after its path at which a ball is still drawn.
const BEYOND_PATH_S = 0.02;

/** Place [x, y] in m at a time; null where the ball is not on the table, or this flight of it has not begun or has ended. */
export function placeAt(path, t) {
  if (!path.t.length || t < path.t[0] - BEYOND_PATH_S || t > path.t.at(-1) + BEYOND_PATH_S) return null;
  const place = [interpolate(path.t, path.x, t), interpolate(path.t, path.y, t)];
  return place.every(Number.isFinite) ? place : null;
}

/**
 * Project a place of the table (u, v from 0 to 1 along its sides) to the image with the four corners of the table, in the
 * order top left, top right, bottom right, bottom left (Heckbert 1989, square to quadrilateral).
 */
export function projectTable([[x0, y0], [x1, y1], [x2, y2], [x3, y3]], u, v) {
  const [sx, sy] = [x0 - x1 + x2 - x3, y0 - y1 + y2 - y3];
  const [dx1, dx2, dy1, dy2] = [x1 - x2, x3 - x2, y1 - y2, y3 - y2];
  const area = dx1 * dy2 - dx2 * dy1;
  const [g, h] = [(sx * dy2 - dx2 * sy) / area, (dx1 * sy - sx * dy1) / area];
  const w = g * u + h * v + 1;
  return [((x1 - x0 + g * x1) * u + (x3 - x0 + h * x3) * v + x0) / w, ((y1 - y0 + g * y1) * u + (y3 - y0 + h * y3) * v + y0) / w];
}

/** Distance of a point from a segment. */
export function distanceToSegment([x, y], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const share = Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(x - ax - share * dx, y - ay - share * dy);
}
