"""Stretches of one ball between two contacts, as windows of the fit by shooting: what a cloth does, whatever the
contacts obey.

Cushions and balls follow laws that are never quite known; while a ball is alone, only the cloth acts on it. So the
cloth is learned from free paths first. A path has a start of its own, spin included. It is cut into short windows, in
each of which the cloth may push a little in a direction of its own: cloths are uneven, and what a path feels of that
is no friction. So the errors of the friction hold what single paths on a real cloth are worth.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from models.core.events import Events
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import Flow, Window
from models.physics.billiards.cloth.closed_form_motion import (
    GRAVITY,
    STATE,
    Friction,
    kinematics,
    kinematics_jacobian,
    rest_time,
)
from models.physics.effect import Prior
from models.physics.effects.catalogue import prior_of

ROLLING_SHARE = 5 / 7
"""of the weight's component along a slope accelerates a ball that rolls: the rest turns it."""
UNEVENNESS = 0.01
"""m/s^2 per axis: what a window feels of an uneven cloth, a slope of a millimetre and a half per metre."""
SLOPE = 2.0
"""mm/m: prior standard deviation of the slope of a table that somebody levelled."""
PIECE = 0.3
"""s: windows are cut so short that the cloth pushes about one way in them."""
SLOWEST = 0.05
"""m/s: slower balls stop within the window, and a window that begins at rest would push a ball that lies."""
FASTEST = 5.0
"""m/s: prior standard deviation of a velocity."""
SLIP = 0.7
"""prior standard deviation of the slip after a contact, over the speed."""
_SLIPS = (-0.7, -0.2, 0.2, 0.7)
"""first guesses of the slip over the velocity: from no slip, a search does not see where to go."""
SPIN_TAKEN = 0.1
"""spin that a ball at rest takes from another one that strikes it, as a surface speed over its velocity: throw."""
_KEPT = np.repeat([2e-5, 2e-4, 1e-3, np.inf], 2)
"""m, m/s, m/s: paths go on from window to window; what the cloth does is new in each."""
_LEAST = 5
"""samples of a path that can tell more than its start."""


@dataclass(frozen=True, slots=True)
class FreePath:
    """What was seen of one ball between two contacts."""

    clip: int
    """which recording."""
    ball: str
    begin: float
    """s, where its state is sought: just after a contact."""
    t: FloatArray
    """(K,) s."""
    xy: FloatArray
    """(K, 2) m."""
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""
    spinless: bool = False
    """it begins where a ball at rest was struck by another one, so that its slip is about its velocity."""


@dataclass(frozen=True, slots=True)
class FreePaths:
    """Paths that share a cloth: sliding and rolling friction and the slope of the table."""

    paths: tuple[FreePath, ...]
    unevenness: float = UNEVENNESS
    """m/s^2 per axis and window."""
    slope: float = SLOPE
    """mm/m, prior standard deviation per axis."""
    noise: float = 1.0
    """factor on the standard deviations of what was seen."""
    known: tuple[Prior, ...] = ()
    """of sliding mu, rolling mu, slope_x, slope_y, where other paths have told them; else what cloths usually have."""
    pieces: tuple[FreePath, ...] = field(init=False)
    """one per window."""
    windows: tuple[Window, ...] = field(init=False)

    def __post_init__(self) -> None:
        cut = [(k, _cut(path)) for k, path in enumerate(self.paths)]
        object.__setattr__(self, "pieces", tuple(piece for _, pieces in cut for piece in pieces))
        windows = tuple(w for k, pieces in cut for w in _windows(pieces, k, self.unevenness))
        object.__setattr__(self, "windows", windows)

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Sliding mu, rolling mu, slope_x, slope_y."""
        return self.known or cloth_priors(self.slope)

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        """Positions on one window, and the state where the next one begins."""
        piece = self.pieces[window]
        follows = window + 1 < len(self.windows) and self.windows[window + 1].link is not None
        end = self.pieces[window + 1].begin if follows else piece.begin
        tilt = ROLLING_SHARE * GRAVITY * 1e-3
        mix = _slip_of(piece.spinless)
        state = mix @ start
        state[6:8] += tilt * shared[2:4]
        t = np.append(piece.t, end) - piece.begin
        friction = Friction(float(shared[0]), float(shared[1]))
        value, slope = kinematics_jacobian(np.broadcast_to(state, (len(t), STATE)), t, friction)
        slope[:, :, :STATE] = slope[:, :, :STATE] @ mix
        slope = np.concatenate([slope, np.eye(STATE, STATE + 3)[None, 6:].repeat(len(t), axis=0)], axis=1)
        by_shared = np.concatenate([slope[:, :, [9, 10]] / shared[:2], tilt * slope[:, :, 6:8]], axis=2)
        whiten = piece.whiten / self.noise
        return Flow(
            np.einsum("kij,kj->ki", whiten, value[:-1, :2] - piece.xy),
            np.einsum("kij,kjp->kip", whiten, slope[:-1, :2, :STATE]),
            np.einsum("kij,kjp->kip", whiten, by_shared[:-1, :2]),
            np.append(value[-1], start[6:8]), slope[-1, :, :STATE], by_shared[-1],
        )  # fmt: skip


def cloth_priors(slope: float = SLOPE) -> tuple[Prior, ...]:
    """What is known of a cloth before anything is seen; `slope` in mm/m."""
    sliding, rolling = prior_of("sliding_friction", "mu"), prior_of("rolling_resistance", "mu")
    return (
        Prior("sliding_friction.mu", sliding.unit, sliding.value, sliding.sigma, sliding.relative, sliding.bounds),
        Prior("rolling_resistance.mu", rolling.unit, rolling.value, rolling.sigma, rolling.relative, rolling.bounds),
        Prior("slope.slope_x", "mm/m", 0.0, slope, False, (-20.0, 20.0)),
        Prior("slope.slope_y", "mm/m", 0.0, slope, False, (-20.0, 20.0)),
    )


def rest_place(start: FloatArray, shared: FloatArray, spinless: bool) -> FloatArray:
    """Where a path of an even cloth ends (2,) m, from its start (8,) as sought and the shared numbers (4,)."""
    state = _slip_of(spinless) @ start
    state[6:8] = ROLLING_SHARE * GRAVITY * 1e-3 * shared[2:4]
    friction = Friction(float(shared[0]), float(shared[1]))
    place: FloatArray = kinematics(state[None], rest_time(state[None], friction) + 1.0, friction)[0, :2]
    return place


def free_paths(tracks: Tracks, events: Events, clip: int, still: float) -> tuple[FreePath, ...]:
    """The stretches of all balls of a clip that begin with a contact, cut off before the next one; a ball that moves
    less than `still` (m) in one is left out."""
    found = []
    for ball, name in enumerate(tracks.ids):
        rows = [k for k in range(len(events)) if name in (events.a[k], events.b[k]) and events.kind[k] != "rest"]
        times = [(float(events.t[k]), float(events.t_sigma[k]), events.kind[k]) for k in rows] + [(np.inf, 0.0, "")]
        for (begin, early, kind), (end, late, _) in pairwise(times):
            path = _path(tracks, ball, clip, begin + _clear(early, tracks), end - _clear(late, tracks))
            path = replace(path, spinless=kind == "ball" and _lay(tracks, ball, begin, still))
            if len(path.t) >= _LEAST and np.linalg.norm(np.ptp(path.xy, axis=0)) > still:
                found.append(path)
    return tuple(found)


def _clear(sigma: float, tracks: Tracks) -> float:
    """s that a path keeps away from a contact whose time is known to `sigma`."""
    exposure = float(np.median(np.diff(tracks.t))) / 2
    return max(3 * sigma, exposure)


def _lay(tracks: Tracks, ball: int, t: float, still: float) -> bool:
    """Whether a ball was seen lying in the fifth of a second before t."""
    seen = tracks.observed[:, ball] & (tracks.t < t) & (tracks.t > t - 0.2)
    return bool(seen.sum() >= 2 and np.linalg.norm(np.ptp(tracks.xy[seen, ball], axis=0)) < still / 4)


def _path(tracks: Tracks, ball: int, clip: int, begin: float, end: float) -> FreePath:
    seen = np.flatnonzero(tracks.observed[:, ball] & (tracks.t >= begin) & (tracks.t <= end))
    return FreePath(clip, tracks.ids[ball], begin, tracks.t[seen], tracks.xy[seen, ball], tracks.whitening[seen, ball])


def _cut(path: FreePath) -> list[FreePath]:
    """Pieces of a path: `PIECE` long while the ball is faster than `SLOWEST`, then one until it lies."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.xy, axis=0), axis=1))])
    begins = [path.begin]
    while True:
        begin = begins[-1] + PIECE
        ahead = float(np.interp(begin + PIECE, path.t, way) - np.interp(begin, path.t, way))
        if begin + PIECE > path.t[-1] or ahead < SLOWEST * PIECE:
            break
        begins.append(begin)
    held = np.histogram(path.t, [*begins, np.inf])[0]
    begins = [begin for begin, count in zip(begins, held, strict=True) if count >= 2 or begin == path.begin]
    place = np.searchsorted(begins, path.t, side="right") - 1
    return [
        replace(
            path,
            spinless=path.spinless and k == 0,
            begin=begin,
            t=path.t[place == k],
            xy=path.xy[place == k],
            whiten=path.whiten[place == k],
        )
        for k, begin in enumerate(begins)
    ]


def _windows(pieces: list[FreePath], number: int, unevenness: float) -> list[Window]:
    """Of one path; the first guesses of its start differ in the slip."""
    windows: list[Window] = []
    for k, piece in enumerate(pieces):
        few = max(min(len(piece.t), 6), 2)
        design = np.vander(piece.t[:few] - piece.begin, 2)
        line = np.linalg.lstsq(design, piece.xy[:few], rcond=None)[0]
        start = np.concatenate([line[1], line[0], np.zeros(4)])
        body, sigma = np.zeros(len(piece.t), np.int64), np.repeat([np.inf, np.inf, np.inf, unevenness], 2)
        if k == 0:
            speed = float(np.hypot(*line[0]))
            slip = SPIN_TAKEN * speed + 0.02 if piece.spinless else SLIP * speed + 0.2
            sigma[2:6] = np.repeat([FASTEST, slip], 2)
            others = () if piece.spinless else tuple(_with_slip(start, share) for share in _SLIPS)
            windows.append(Window(number, piece.t, body, start, sigma, None, others))
        else:
            windows.append(Window(number, piece.t, body, start, sigma, _KEPT))
    return windows


def _slip_of(spinless: bool) -> FloatArray:
    """(8, 8): takes the numbers that are sought to the state of a span; slip counts from the velocity of a ball that
    had no spin, else from none."""
    mix = np.eye(STATE)
    if spinless:
        mix[[4, 5], [2, 3]] = 1.0
    return mix


def _with_slip(start: FloatArray, share: float) -> FloatArray:
    """A state (8,) whose slip is `share` of its velocity."""
    return np.concatenate([start[:4], share * start[2:4], start[6:]])
