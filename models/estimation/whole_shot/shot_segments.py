"""Segments of a recording between strikes: their rows and initial states, and their multiple-shooting windows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import Window
from models.physics.billiards.simulation.parametrised_shot import pack_start

# m/s: prior standard deviation of a velocity.
VELOCITY_SIGMA = 5.0
# Prior standard deviation of a slip: this share of the speed, plus `SPIN_SIGMA_AT_REST`.
SLIP_SIGMA = 0.7
# Prior standard deviation of R wz: this share of the speed, plus `SPIN_SIGMA_AT_REST`; a cue hit at R/2 from the centre
# gives 5/4.
SIDE_SPIN_SIGMA = 0.6
# m/s
SPIN_SIGMA_AT_REST = 0.1
# m/s by which slip and side spin at the start of a segment may differ from the end of the previous one.
HANDOVER_SIGMA = 0.02
# Expected slip as a share of the velocity.
EXPECTED_SLIP = 0.3
# Initial guesses of slip and R wz over the speed. Without slip or spin, the derivative by them vanishes and a search
# makes no progress.
SPIN_GUESSES = ((0.3, 0.4), (0.3, -0.4), (0.9, 0.4), (-0.3, -0.4))


@dataclass(frozen=True)
class ShotSegment:
    """Observations of all N balls from `begin` on, at T times."""

    shot: int
    """Index of the shot."""
    begin: float
    """s, at most t[0]."""
    t: FloatArray
    """(T,) s."""
    xy: FloatArray
    """(T, N, 2) m; NaN where a ball was not observed."""
    whitening: FloatArray
    """(T, N, 2, 2): converts residuals in m into standard deviations."""
    start: FloatArray
    """(N, 7) initial guess of the state of every ball, as in `parametrised_shot`."""
    moving: BoolArray
    """(N,) whether a ball moves at `begin`."""
    continues_previous: bool = False
    """Whether slip and side spin continue from the previous segment."""
    image_row: FloatArray | None = None
    """(T, N) image row of a ball relative to the image centre, in image heights; None without an image."""
    dropped_frame_delay: FloatArray | None = None
    """(T,) s by which one dropped frame would shift each time; None where none is suspected."""
    windows: dict[bool, Window] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Windows that were built of it, by `guess_spins`: every hypothesis is fitted to the same."""

    @cached_property
    def observation_indices(self) -> tuple[IntArray, IntArray]:
        """(K,) row and (K,) ball of each observation."""
        rows, balls = np.nonzero(np.isfinite(self.xy[..., 0]))
        return rows.astype(np.int64), balls.astype(np.int64)

    @cached_property
    def observations(self) -> FloatArray:
        """(K, 2) m, observed positions."""
        return self.xy[self.observation_indices]

    @cached_property
    def observation_whitening(self) -> FloatArray:
        """(K, 2, 2) `whitening` of each observation."""
        return self.whitening[self.observation_indices]

    def truncate(self, t: float) -> ShotSegment:
        """Keep the observations up to a time."""
        before = self.t <= t
        row, late = (None if shift is None else shift[before] for shift in (self.image_row, self.dropped_frame_delay))
        part = {name: getattr(self, name)[before] for name in ("t", "xy", "whitening")}
        return replace(self, **part, image_row=row, dropped_frame_delay=late)


def build_window(segment: ShotSegment, guess_spins: bool) -> Window:
    """Build the multiple-shooting window of a segment: observations, initial guess and prior.

    Args:
        segment: Segment with its initial states.
        guess_spins: Whether slips and spins are unknown, so that several initial guesses are tried.

    Returns:
        The window.
    """
    if guess_spins in segment.windows:
        return segment.windows[guess_spins]
    rows, balls = segment.observation_indices
    start = pack_start(segment.start, segment.moving)
    speed = np.hypot(segment.start[:, 2], segment.start[:, 3])
    sigma = np.full(segment.start.shape, np.inf)
    sigma[~np.isfinite(segment.xy[..., 0]).any(axis=0), :2] = 1.0  # never observed: it stays away
    sigma[:, 2:4] = VELOCITY_SIGMA
    sigma[:, 4:6] = (SLIP_SIGMA * speed + SPIN_SIGMA_AT_REST)[:, None]
    sigma[:, 6] = SIDE_SPIN_SIGMA * speed + SPIN_SIGMA_AT_REST
    link = np.full(segment.start.shape, np.inf)
    link[:, 4:] = HANDOVER_SIGMA
    tied = pack_start(link, segment.moving) if segment.continues_previous else None
    first = pack_start(_replace_spins(segment.start, EXPECTED_SLIP, 0.0), segment.moving) if guess_spins else start
    others = tuple(
        pack_start(_replace_spins(segment.start, *guess), segment.moving) for guess in SPIN_GUESSES if guess_spins
    )
    state_sigma = pack_start(sigma, segment.moving)
    window = Window(
        segment.shot, segment.t[rows], balls, first, state_sigma, tied, () if segment.continues_previous else others
    )
    segment.windows[guess_spins] = window
    return window


def _replace_spins(start: FloatArray, slip: float, side: float) -> FloatArray:
    """Set slips to a share of the velocities and side spins to a share of the speeds, in states (N, 7)."""
    states = start.copy()
    states[:, 4:6] = slip * start[:, 2:4]
    states[:, 6] = side * np.hypot(start[:, 2], start[:, 3])
    return states


# Frames that an initial velocity is estimated from, at most.
_MAX_ROWS = 12
# Frames from which a parabola is fitted instead of a line.
_MIN_PARABOLA_ROWS = 6
# chi2 per degree of freedom up to which one smooth path explains a ball's positions.
_MAX_CHI2 = 3.0
# Decrease of chi2 by which a velocity must improve on a constant position.
_MIN_MOTION_CHI2 = 20.0
# Frames on either side that decide whether a ball moves.
_ROWS_PER_SIDE = 3
# Standard deviations by which a ball must have moved.
_SIGNIFICANT_SIGMAS = 6.0
# m: position of a ball that was never observed; there it touches nothing.
UNSEEN_POSITION = 1000.0


def estimate_initial_states(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Estimate the positions and velocities of all balls at the first time.

    Args:
        t: (T,) s, increasing.
        xy: (T, N, 2) m, NaN where a ball was not observed.
        sigma: (T, N) m, standard deviation per axis.

    Returns:
        States (N, 7) at t[0] without slip and spin, and (N,) which balls move.
    """
    start, moving = np.zeros((xy.shape[1], 7)), np.zeros(xy.shape[1], bool)
    for ball in range(len(start)):
        rows = np.flatnonzero(np.isfinite(xy[:, ball, 0]))[:_MAX_ROWS]
        if len(rows) == 0:
            start[ball, 0] = UNSEEN_POSITION * (1 + ball)
            continue
        start[ball, :4], moving[ball] = _estimate_ball_state(t[rows] - t[0], xy[rows, ball], sigma[rows, ball])
    return start, moving


def _estimate_ball_state(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, bool]:
    """Estimate position and velocity (4,) at t = 0, from as many frames as one smooth path explains."""
    for count in range(len(t), 1, -1):
        degree = 2 if count >= _MIN_PARABOLA_ROWS else 1
        curve, chi2 = _fit_polynomial(t[:count], xy[:count], sigma[:count], degree)
        if chi2 <= _MAX_CHI2 * max(2 * (count - degree - 1), 1) or count == 2:
            break
    else:
        return np.concatenate([xy[0], np.zeros(2)]), False
    place, still = _fit_polynomial(t[:count], xy[:count], sigma[:count], 0)
    _, straight = _fit_polynomial(t[:count], xy[:count], sigma[:count], 1)
    if still - straight < _MIN_MOTION_CHI2:
        return np.concatenate([place[0], np.zeros(2)]), False
    return np.concatenate([curve[0], curve[1]]), True


def _fit_polynomial(t: FloatArray, xy: FloatArray, sigma: FloatArray, degree: int) -> tuple[FloatArray, float]:
    """Fit coefficients (degree + 1, 2) of powers of t; return them and chi2."""
    design = np.vander(t, degree + 1, increasing=True) / sigma[:, None]
    curve = np.linalg.lstsq(design, xy / sigma[:, None], rcond=None)[0]
    return np.asarray(curve, np.float64), float(np.square(design @ curve - xy / sigma[:, None]).sum())


def detect_motion(xy: FloatArray, sigma: FloatArray) -> BoolArray:
    """Detect the frames in which any ball moves.

    Args:
        xy: (T, N, 2) m, NaN where a ball was not observed.
        sigma: (T, N) m, standard deviation per axis.

    Returns:
        (T,) True where a ball moves significantly.
    """
    moving = np.zeros(len(xy), bool)
    for ball in range(xy.shape[1]):
        rows = np.flatnonzero(np.isfinite(xy[:, ball, 0]))
        if len(rows) < 2 * _ROWS_PER_SIDE:
            continue
        near = np.lib.stride_tricks.sliding_window_view(xy[rows, ball], 2 * _ROWS_PER_SIDE, axis=0)  # (M, 2, 6)
        way = np.linalg.norm(near[..., _ROWS_PER_SIDE:].mean(axis=2) - near[..., :_ROWS_PER_SIDE].mean(axis=2), axis=1)
        error = np.median(sigma[rows, ball]) * np.sqrt(2 / _ROWS_PER_SIDE)
        for k in np.flatnonzero(way > _SIGNIFICANT_SIGMAS * error):
            moving[rows[k] : rows[k + 2 * _ROWS_PER_SIDE - 1] + 1] = True
    return moving


def find_shot_rows(xy: FloatArray, sigma: FloatArray) -> list[tuple[int, int]]:
    """Find the rows of every shot: from a strike to the next one.

    Args:
        xy: (T, N, 2) m, NaN where a ball was not observed.
        sigma: (T, N) m, standard deviation per axis.

    Returns:
        First row and the row after the last one of each shot.
    """
    moving = detect_motion(xy, sigma)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving]).astype(int)) == 1)
    ranges = []
    for k, first in enumerate(edges):
        last = int(edges[k + 1]) if k + 1 < len(edges) else len(xy)
        ranges.append((_find_departure(xy, sigma, int(first)) if first else 0, last))
    return [(first, last) for first, last in ranges if last > first]


def _find_departure(xy: FloatArray, sigma: FloatArray, first: int) -> int:
    """Find the first row, from `first` on, in which a ball has clearly left its position."""
    before = xy[max(first - _ROWS_PER_SIDE, 0) : first + 1]
    place = np.array([_median_position(before[:, ball]) for ball in range(xy.shape[1])])
    for row in range(first + 1, min(first + 2 * _ROWS_PER_SIDE + 1, len(xy))):
        way = np.linalg.norm(xy[row] - place, axis=1)
        if np.any(way > _SIGNIFICANT_SIGMAS * sigma[row]):
            return row
    return first


def _median_position(places: FloatArray) -> FloatArray:
    """Compute the median (2,) of the observed positions (M, 2); NaN where there is none."""
    observed = places[np.isfinite(places[:, 0])]
    return np.asarray(np.median(observed, axis=0)) if len(observed) else np.full(2, np.nan)
