"""Paths of one ball between two contacts, as windows of the multiple-shooting fit of a cloth.

Cushions and balls follow contact models that are never exactly known; between contacts, only the cloth acts on a ball.
A path has a start state of its own, including spin. It is cut into short windows, in each of which the cloth may push a
little in a direction of its own: cloths are uneven, and this effect on a path is not friction. The errors of the
friction therefore express the true information in single paths on a real cloth.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from models.core.constants import GRAVITY
from models.core.contact_graph import SEGMENT_STATE_SIZE, ClothFriction
from models.core.events import Events
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.solution_state import ROLLING_SLOPE_FACTOR, SLOPE_SIGMA, UNEVENNESS, WINDOW_LENGTH
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, Window
from models.estimation.whole_shot.shot_segments import VELOCITY_SIGMA
from models.physics.billiards.cloth.closed_form_motion import (
    differentiate_kinematics,
    duration_until_rest,
    evaluate_kinematics,
)
from models.physics.effect import Prior
from models.physics.effects.billiards_catalogue import find_prior

# m/s: slower balls stop within the window; a window that begins at rest would push a resting ball.
MIN_WINDOW_SPEED = 0.05
# Prior standard deviation of the slip after a contact, over the speed.
SLIP_SIGMA = 0.7
# Initial guesses of the slip over the velocity: without slip, the derivative by it vanishes.
_SLIP_GUESSES = (-0.7, -0.2, 0.2, 0.7)
# Surface speed, over its velocity, that a resting ball takes from a ball that hits it: throw.
SPIN_TRANSFER = 0.1
# m, m/s, m/s: the state continues from window to window; the push of the cloth is new in each.
_LINK_SIGMA = np.repeat([2e-5, 2e-4, 1e-3, np.inf], 2)
# Samples from which a path constrains more than its start.
_MIN_SAMPLES = 5


@dataclass(frozen=True, slots=True)
class FreePath:
    """Observations of one ball between two contacts."""

    clip: int
    """Index of the recording."""
    ball: str
    begin: float
    """s, time of the start state: just after a contact."""
    t: FloatArray
    """(K,) s."""
    xy: FloatArray
    """(K, 2) m."""
    whitening: FloatArray
    """(K, 2, 2): converts a residual in m into standard deviations."""
    spinless: bool = False
    """Whether it begins where a resting ball was hit by another one, so that its slip is about its velocity."""


@dataclass(frozen=True, slots=True)
class FreePaths:
    """Paths that share a cloth: sliding and rolling friction and the slope of the table."""

    paths: tuple[FreePath, ...]
    unevenness: float = UNEVENNESS
    """m/s^2 per axis and window."""
    slope: float = SLOPE_SIGMA
    """mm/m, prior standard deviation per axis."""
    noise: float = 1.0
    """Factor on the standard deviations of the observations."""
    priors: tuple[Prior, ...] = ()
    """Priors of sliding friction, rolling friction, slope_x, slope_y from other paths; default priors where empty."""
    window_paths: tuple[FreePath, ...] = field(init=False)
    """Part of a path in each window."""
    windows: tuple[Window, ...] = field(init=False)
    """All windows, path by path."""

    def __post_init__(self) -> None:
        cut = [(k, _split_path(path)) for k, path in enumerate(self.paths)]
        object.__setattr__(self, "window_paths", tuple(piece for _, pieces in cut for piece in pieces))
        windows = tuple(w for k, pieces in cut for w in _build_windows(pieces, k, self.unevenness))
        object.__setattr__(self, "windows", windows)

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of sliding friction, rolling friction, slope_x, slope_y."""
        return self.priors or cloth_priors(self.slope)

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Predict the positions in one window, and the start of the next one, with Jacobians."""
        piece = self.window_paths[window]
        follows = window + 1 < len(self.windows) and self.windows[window + 1].link_sigma is not None
        end = self.window_paths[window + 1].begin if follows else piece.begin
        tilt = ROLLING_SLOPE_FACTOR * GRAVITY * 1e-3
        mix = _state_transform(piece.spinless)
        state = mix @ start
        state[6:8] += tilt * shared[2:4]
        t = np.append(piece.t, end) - piece.begin
        friction = ClothFriction(float(shared[0]), float(shared[1]))
        value, slope = differentiate_kinematics(np.broadcast_to(state, (len(t), SEGMENT_STATE_SIZE)), t, friction)
        slope[:, :, :SEGMENT_STATE_SIZE] = slope[:, :, :SEGMENT_STATE_SIZE] @ mix
        slope = np.concatenate(
            [slope, np.eye(SEGMENT_STATE_SIZE, SEGMENT_STATE_SIZE + 3)[None, 6:].repeat(len(t), axis=0)], axis=1
        )
        by_shared = np.concatenate([slope[:, :, [9, 10]] / shared[:2], tilt * slope[:, :, 6:8]], axis=2)
        whiten = piece.whitening / self.noise
        return LinearizedWindow(
            np.einsum("kij,kj->ki", whiten, value[:-1, :2] - piece.xy),
            np.einsum("kij,kjp->kip", whiten, slope[:-1, :2, :SEGMENT_STATE_SIZE]),
            np.einsum("kij,kjp->kip", whiten, by_shared[:-1, :2]),
            np.append(value[-1], start[6:8]), slope[-1, :, :SEGMENT_STATE_SIZE], by_shared[-1],
        )  # fmt: skip


def cloth_priors(slope: float = SLOPE_SIGMA) -> tuple[Prior, ...]:
    """Build the default priors of a cloth; `slope` is the standard deviation of the slope in mm/m."""
    sliding, rolling = find_prior("sliding_friction", "mu"), find_prior("rolling_resistance", "mu")
    return (
        Prior("sliding_friction.mu", sliding.unit, sliding.value, sliding.sigma, sliding.relative, sliding.bounds),
        Prior("rolling_resistance.mu", rolling.unit, rolling.value, rolling.sigma, rolling.relative, rolling.bounds),
        Prior("slope.slope_x", "mm/m", 0.0, slope, False, (-20.0, 20.0)),
        Prior("slope.slope_y", "mm/m", 0.0, slope, False, (-20.0, 20.0)),
    )


def predict_rest_position(start: FloatArray, shared: FloatArray, spinless: bool) -> FloatArray:
    """Predict where a ball on an even cloth stops.

    Args:
        start: (8,) fitted start state of a path.
        shared: (4,) sliding friction, rolling friction, slope_x, slope_y.
        spinless: As in `FreePath`.

    Returns:
        (2,) m.
    """
    state = _state_transform(spinless) @ start
    state[6:8] = ROLLING_SLOPE_FACTOR * GRAVITY * 1e-3 * shared[2:4]
    friction = ClothFriction(float(shared[0]), float(shared[1]))
    place: FloatArray = evaluate_kinematics(state[None], duration_until_rest(state[None], friction) + 1.0, friction)[
        0, :2
    ]
    return place


def extract_free_paths(tracks: Tracks, events: Events, clip: int, rest_extent: float) -> tuple[FreePath, ...]:
    """Extract the paths of all balls of a clip that begin with a contact, cut off before the next one.

    Args:
        tracks: Tracks of the clip.
        events: Contacts of the clip.
        clip: Index of the recording.
        rest_extent: m; a path in which the ball moves less is left out.

    Returns:
        Paths, ball by ball, in the order of time.
    """
    paths = []
    for ball, name in enumerate(tracks.ids):
        rows = [k for k in range(len(events)) if name in (events.a[k], events.b[k]) and events.kind[k] != "rest"]
        times = [(float(events.t[k]), float(events.t_sigma[k]), events.kind[k]) for k in rows] + [(np.inf, 0.0, "")]
        for (begin, early, kind), (end, late, _) in pairwise(times):
            path = _extract_path(
                tracks, ball, clip, begin + _contact_margin(early, tracks), end - _contact_margin(late, tracks)
            )
            path = replace(path, spinless=kind == "ball" and _was_at_rest(tracks, ball, begin, rest_extent))
            if len(path.t) >= _MIN_SAMPLES and np.linalg.norm(np.ptp(path.xy, axis=0)) > rest_extent:
                paths.append(path)
    return tuple(paths)


def _contact_margin(sigma: float, tracks: Tracks) -> float:
    """Compute the s between a path and a contact whose time has the standard deviation `sigma`."""
    exposure = float(np.median(np.diff(tracks.t))) / 2
    return max(3 * sigma, exposure)


def _was_at_rest(tracks: Tracks, ball: int, t: float, rest_extent: float) -> bool:
    """Return whether a ball was observed at rest in the 0.2 s before t."""
    recent = tracks.is_observed[:, ball] & (tracks.t < t) & (tracks.t > t - 0.2)
    return bool(recent.sum() >= 2 and np.linalg.norm(np.ptp(tracks.xy[recent, ball], axis=0)) < rest_extent / 4)


def _extract_path(tracks: Tracks, ball: int, clip: int, begin: float, end: float) -> FreePath:
    rows = np.flatnonzero(tracks.is_observed[:, ball] & (tracks.t >= begin) & (tracks.t <= end))
    return FreePath(clip, tracks.ids[ball], begin, tracks.t[rows], tracks.xy[rows, ball], tracks.whitening[rows, ball])


def _split_path(path: FreePath) -> list[FreePath]:
    """Split a path into parts of `WINDOW_LENGTH` above `MIN_WINDOW_SPEED`, and one from there until rest."""
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.xy, axis=0), axis=1))])
    begins = [path.begin]
    while True:
        begin = begins[-1] + WINDOW_LENGTH
        ahead = float(np.interp(begin + WINDOW_LENGTH, path.t, travelled) - np.interp(begin, path.t, travelled))
        if begin + WINDOW_LENGTH > path.t[-1] or ahead < MIN_WINDOW_SPEED * WINDOW_LENGTH:
            break
        begins.append(begin)
    counts = np.histogram(path.t, [*begins, np.inf])[0]
    begins = [begin for begin, count in zip(begins, counts, strict=True) if count >= 2 or begin == path.begin]
    place = np.searchsorted(begins, path.t, side="right") - 1
    return [
        replace(
            path,
            spinless=path.spinless and k == 0,
            begin=begin,
            t=path.t[place == k],
            xy=path.xy[place == k],
            whitening=path.whitening[place == k],
        )
        for k, begin in enumerate(begins)
    ]


def _build_windows(pieces: list[FreePath], number: int, unevenness: float) -> list[Window]:
    """Build the windows of one path; the initial guesses of its start differ in the slip."""
    windows: list[Window] = []
    for k, piece in enumerate(pieces):
        few = max(min(len(piece.t), 6), 2)
        design = np.vander(piece.t[:few] - piece.begin, 2)
        line = np.linalg.lstsq(design, piece.xy[:few], rcond=None)[0]
        start = np.concatenate([line[1], line[0], np.zeros(4)])
        body, sigma = np.zeros(len(piece.t), np.int64), np.repeat([np.inf, np.inf, np.inf, unevenness], 2)
        if k == 0:
            speed = float(np.hypot(*line[0]))
            slip = SPIN_TRANSFER * speed + 0.02 if piece.spinless else SLIP_SIGMA * speed + 0.2
            sigma[2:6] = np.repeat([VELOCITY_SIGMA, slip], 2)
            others = () if piece.spinless else tuple(_replace_slip(start, share) for share in _SLIP_GUESSES)
            windows.append(Window(number, piece.t, body, start, sigma, None, others))
        else:
            windows.append(Window(number, piece.t, body, start, sigma, _LINK_SIGMA))
    return windows


def _state_transform(spinless: bool) -> FloatArray:
    """Return the matrix (8, 8) from the fitted variables to the state of a ball.

    The fitted slip is relative to that of a ball without spin, if the path is `spinless`, else to zero.
    """
    mix = np.eye(SEGMENT_STATE_SIZE)
    if spinless:
        mix[[4, 5], [2, 3]] = 1.0
    return mix


def _replace_slip(start: FloatArray, share: float) -> FloatArray:
    """Set the slip of a state (8,) to a share of its velocity."""
    return np.concatenate([start[:4], share * start[2:4], start[6:]])
