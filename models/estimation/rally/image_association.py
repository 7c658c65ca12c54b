"""The path of one object through the candidates of all frames.

The best path maximizes the log-likelihood ratio of a track against clutter (Blackman, Popoli 1999, section 6.2) over
pairs of successive places (Viterbi). Within a flight, the next place lies where the last two point, but for gravity and
drag; a hit may send it anywhere within reach. The density of clutter is that of the place: what lies in the same place
in many frames is a mark of the court, a lamp or a face, not a ball.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.constants import GRAVITY
from models.core.court_camera import CourtScene
from models.core.rally import BallCandidates
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.flight_observations import stabilize_places

# s and frames that the object may be hidden without the path beginning anew: half the time of a fast exchange.
_LONGEST_GAP, _MOST_FRAMES = 0.25, 5
# Natural logarithm by which a partial path may be worse than the best: beginning anew costs less.
_WORST = 16.0
# Probability of a candidate in a frame that shows the object.
_DETECTION = 0.85
# Hits and bounces per second, and path beginnings per second, as prior rates.
_EVENT_RATE, _START_RATE = 2.0, 0.3
# px, side of the squares of which 3 x 3 are counted together: what does not move stays within.
_CLUTTER_CELL = 2.5
# Share of the frames from which a place counts as that of a mark, whose look is no evidence.
_RECURRING = 0.1
# Least and largest weight of a candidate's look, natural logarithm of odds: detectors are surer than they are right.
_ODDS = (-6.0, 3.0)
# Largest natural logarithm of a likelihood ratio by motion alone: limbs, rackets and shadows move smoothly too.
_LARGEST_MOTION = 3.5
# Share of g by which the acceleration in the image departs from a straight path (gravity, lift, approach).
_ACCELERATION_SHARE = 1.0
# Factor on the speed in the image of the fastest object at the middle of the court, as one nearer the camera moves.
_NEARNESS = 2.0
# Angle, rad, and floor, px, within which a streak lies along the motion.
_STREAK_ANGLE, _STREAK_FLOOR = 0.25, 4.0
# Log-likelihood that a streak points elsewhere: the object was hit during the exposure, or its blur was misread.
_WRONG_STREAK = -3.0


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Partial paths that end with candidates `before` and `last` of one frame (`last`)."""

    before: IntArray
    last: IntArray
    score: FloatArray
    parent: IntArray
    """Index of the pair from which each continues, over all pairs so far; -1: the best path that had ended."""
    root: IntArray
    """Index of that ended path's last pair; -1 without any."""


def associate_candidates(scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray) -> IntArray:
    """Find the object among the candidates.

    Args:
        scene: Court and camera.
        candidates: K candidates.
        frame: (T,) indices of the distinct frames.
        t: (T,) s.

    Returns:
        Index (T,) of the candidate that shows the object in each frame; -1 where none does.
    """
    chosen = np.full(len(t), -1, np.int64)
    row = np.searchsorted(frame, candidates.frame)
    usable = np.flatnonzero((row < len(frame)) & (frame[np.minimum(row, len(frame) - 1)] == candidates.frame))
    if len(usable) < 2:
        return chosen
    row = row[usable]
    centre, frames = candidates.centre[usable], candidates.frame[usable]
    px = stabilize_places(scene.camera, frames, centre)
    streak = stabilize_places(scene.camera, frames, centre + candidates.streak[usable]) - px
    look, clutter = _weigh_look(scene, candidates, usable, px, t)
    weigh = _Weights(scene, t[row], px, streak, candidates.sigma[usable], look, clutter)
    path = _find_best_path(weigh, row, t)
    chosen[row[path]] = usable[path]
    return chosen


class _Weights:
    """Log-likelihood ratios of steps between candidates."""

    def __init__(
        self,
        scene: CourtScene,
        t: FloatArray,
        px: FloatArray,
        streak: FloatArray,
        sigma: FloatArray,
        look: FloatArray,
        clutter: FloatArray,
    ) -> None:
        sport, camera = scene.sport, scene.camera
        middle = np.array([sport.length / 2, sport.width / 2, 1.0])
        self.per_metre = float(np.exp(camera.parameters[6])) / float(np.linalg.norm(middle - camera.centre))
        self.log_area = float(np.log(camera.width_px * camera.height_px))
        self.t, self.px, self.streak, self.sigma, self.look, self.clutter = t, px, streak, sigma, look, clutter
        self.gravity = _ACCELERATION_SHARE * GRAVITY * self.per_metre
        self.drag = sport.object.drag.mean / self.per_metre
        self.fastest = sport.object.max_speed * self.per_metre * _NEARNESS

    def start(self, before: IntArray, last: IntArray) -> FloatArray:
        """Weigh the first two places of a path: the second lies anywhere within reach of the first."""
        return np.asarray(self.look[before] - self.clutter[before] - self.log_area + self.jump(before, last))

    def jump(self, before: IntArray, last: IntArray) -> FloatArray:
        """Weigh a step in any direction, all velocities within reach alike."""
        step, dt = self.px[last] - self.px[before], self.t[last] - self.t[before]
        reach = self.fastest * dt
        # slow motions are commoner than fast ones: a Cauchy-like density of the speed about that of a soft shot
        scale = 8.0 * self.per_metre * dt
        distance = np.linalg.norm(step, axis=-1)
        density = -np.log(2 * np.pi * scale**2) - 1.5 * np.log1p((distance / scale) ** 2)
        within = np.where(distance <= reach + 3 * self.sigma[last], density, -np.inf)
        moves = np.minimum(within - self.clutter[last], _LARGEST_MOTION)
        return np.asarray(moves + self.look[last] + self.weigh_streak(step, last))

    def follow(self, first: IntArray, before: IntArray, last: IntArray) -> FloatArray:
        """Weigh a step that continues the motion from `first` to `before`."""
        dt, earlier = self.t[last] - self.t[before], self.t[before] - self.t[first]
        velocity = (self.px[before] - self.px[first]) / earlier[..., None]
        off = self.px[last] - self.px[before] - velocity * dt[..., None]
        speed = np.linalg.norm(velocity, axis=-1)
        reach = 0.5 * dt * (dt + earlier)
        slowing = self.drag * speed**2 * reach
        noise = self.sigma[last] ** 2 + self.sigma[before] ** 2 * (1 + dt / earlier) ** 2
        noise = noise + (self.sigma[first] * dt / earlier) ** 2
        across = noise + (self.gravity * reach) ** 2
        along = across + np.minimum(slowing, speed * dt) ** 2
        ahead = velocity / np.maximum(speed, 1e-9)[..., None]
        off_along = (off * ahead).sum(axis=-1)
        square = off_along**2 / along + ((off**2).sum(axis=-1) - off_along**2) / across
        density = -np.log(2 * np.pi) - 0.5 * np.log(along * across) - 0.5 * square
        step = self.px[last] - self.px[before]
        moves = np.minimum(density - self.clutter[last], _LARGEST_MOTION)
        return np.asarray(moves + self.look[last] + self.weigh_streak(step, last))

    def weigh_streak(self, step: FloatArray, last: IntArray) -> FloatArray:
        """Weigh the angle between a step and the streak at its end, against any angle."""
        streak = self.streak[last]
        length, distance = np.linalg.norm(streak, axis=-1), np.linalg.norm(step, axis=-1)
        usable = (length > _STREAK_FLOOR) & (distance > _STREAK_FLOOR)
        sine = np.abs(step[..., 0] * streak[..., 1] - step[..., 1] * streak[..., 0]) / np.where(
            usable, length * distance, 1.0
        )
        angle = np.arcsin(np.minimum(sine, 1.0)) / _STREAK_ANGLE
        agreement = np.logaddexp(np.log(np.sqrt(np.pi / 2) / _STREAK_ANGLE) - 0.5 * angle**2, _WRONG_STREAK)
        return np.where(usable, agreement, 0.0)


def _weigh_look(
    scene: CourtScene, candidates: BallCandidates, usable: IntArray, px: FloatArray, t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Weigh each candidate by its look, and measure the logarithm of the density of clutter at its place, 1/px^2."""
    score = np.clip(candidates.score[usable], 1e-6, 1 - 1e-6)
    odds = np.clip(np.log(score / (1 - score)), *_ODDS)
    area = float(scene.camera.width_px * scene.camera.height_px)
    uniform = max(len(usable) / len(t), 1.0) / area
    cells = np.floor(px / _CLUTTER_CELL).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    columns = int(cells[:, 1].max()) + 2  # one beyond on each side, so that no cell has a neighbour in another row
    keys = cells[:, 0] * columns + cells[:, 1]
    # a list of the cells in use: a camera that turns, or a lens, may put candidates far apart
    used, counts = np.unique(keys, return_counts=True)
    here = np.zeros(len(keys), np.int64)
    for step in (i * columns + j for i in (-1, 0, 1) for j in (-1, 0, 1)):
        at = np.minimum(np.searchsorted(used, keys + step), len(used) - 1)
        here += np.where(used[at] == keys + step, counts[at], 0)
    # an object that moves is itself seen in a place in a few frames
    local = np.maximum(here - 3, 0) / (len(t) * 9 * _CLUTTER_CELL**2)
    odds = np.where(here > 3 + _RECURRING * len(t), np.minimum(odds, 0.0), odds)
    return np.log(_DETECTION) + odds, np.log(uniform + local)


def _find_best_path(weigh: _Weights, row: IntArray, t: FloatArray) -> IntArray:
    """Find the candidates of the best path, in the order of time, by dynamic programming over pairs of them."""
    miss, hit, start = np.log(1 - _DETECTION), np.log(_EVENT_RATE), np.log(_START_RATE)
    first_of = np.searchsorted(row, np.arange(len(t) + 1))
    interval = float(np.median(np.diff(t)))
    stored: list[_Pairs] = []
    offsets = [0]
    ended_score, ended_pair = np.zeros(len(t) + 1), np.full(len(t) + 1, -1, np.int64)
    for now in range(len(t)):
        ended_score[now + 1], ended_pair[now + 1] = ended_score[now], ended_pair[now]
        begin = max(int(np.searchsorted(t, t[now] - max(_LONGEST_GAP, 1.01 * interval))), now - _MOST_FRAMES)
        last = np.arange(first_of[now], first_of[now + 1])
        before = np.arange(first_of[begin], first_of[now])
        none = np.empty(0, np.int64)
        pairs = _Pairs(none, none, np.empty(0), none, none)
        if len(last) and len(before):
            pair_before, pair_last = np.repeat(before, len(last)), np.tile(last, len(before))
            gaps = miss * (now - row[pair_before] - 1)
            best = ended_score[row[pair_before]] + start + np.log(interval) + weigh.start(pair_before, pair_last) + gaps
            parent = np.full(len(best), -1, np.int64)
            earlier = stored[begin:now]
            if any(len(one.last) for one in earlier):
                ends = np.concatenate([one.last for one in earlier])
                starts = np.concatenate([one.before for one in earlier])
                scores = np.concatenate([one.score for one in earlier])
                shape = len(ends), len(last)
                follow = weigh.follow(*(np.broadcast_to(one, shape) for one in (starts[:, None], ends[:, None], last)))
                jump = weigh.jump(np.broadcast_to(ends[:, None], shape), np.broadcast_to(last, shape))
                dt = weigh.t[last][None, :] - weigh.t[ends][:, None]
                total = scores[:, None] + np.maximum(follow, jump + hit + np.log(dt))
                slots = (ends - before[0])[:, None] * len(last) + np.arange(len(last))
                order = np.argsort(total, axis=None, kind="stable")  # the best of a slot is written last
                top = np.full(len(best), -1, np.int64)
                top[slots.ravel()[order]] = order
                with_parent = np.flatnonzero(top >= 0)
                value = total.ravel()[top[with_parent]] + gaps[with_parent]
                better = value > best[with_parent]
                best[with_parent[better]] = value[better]
                parent[with_parent[better]] = offsets[begin] + top[with_parent[better]] // len(last)
            usable = best > max(ended_score[now], float(best.max())) - _WORST
            root = np.where(parent < 0, ended_pair[row[pair_before]], -1)
            pairs = _Pairs(*(one[usable] for one in (pair_before, pair_last, best, parent, root)))
            if len(pairs.score) and pairs.score.max() > ended_score[now + 1]:
                ended_score[now + 1] = pairs.score.max()
                ended_pair[now + 1] = offsets[-1] + int(np.argmax(pairs.score))
        stored.append(pairs)
        offsets.append(offsets[-1] + len(pairs.last))
    return _trace_back(stored, int(ended_pair[-1]))


def _trace_back(stored: list[_Pairs], pair: int) -> IntArray:
    """Collect the candidates of the path that ends with a pair."""
    before, last, parent, root = (
        np.concatenate([getattr(one, name) for one in stored]) for name in ("before", "last", "parent", "root")
    )
    path: list[int] = []
    while pair >= 0:
        path.append(int(last[pair]))
        if parent[pair] < 0:
            path.append(int(before[pair]))
            pair = int(root[pair])
        else:
            pair = int(parent[pair])
    return np.array(path[::-1], np.int64)
