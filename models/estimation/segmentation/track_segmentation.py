"""Segmentation of one track by dynamic programming over motions that physics can explain.

The first pass cuts a track into constants and parabolas, cheaply and too often: sliding, rolling and resting are
separate pieces there. The second pass joins them into segments, each of them a slide that turns into a roll, and
charges more for a velocity change where nothing nearby could have caused it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, IntArray

# s: how long a ball may slide before it rolls; the grid of the closed-form fit. 1.7 s is a hard break shot.
SLIDE_TIMES = (0.0, 0.04, 0.08, 0.13, 0.2, 0.3, 0.42, 0.6, 0.85, 1.2, 1.7)
# m/s^2, prior standard deviation per axis while sliding: about mu_s g.
SLIDING_ACCELERATION = 2.0
# m/s^2, uncertainty of the strength of sliding friction; and s, the shortest slide that shows it.
SLIDING_ACCELERATION_SIGMA, MIN_LONG_SLIDE = 0.45, 0.15
# m/s^2, prior standard deviation per axis while rolling: about mu_r g, with slope and nap.
ROLLING_ACCELERATION = 0.12
# Share of the speed, and m/s: slip of a ball that nothing has touched for a while, one standard deviation.
SLIP_SIGMA_SHARE, SLIP_SIGMA_FLOOR = 0.7, 0.2
# Upper limit of the penalty of an implausible initial spin, chi2: a clip may begin within a contact.
MAX_SPIN_PENALTY = 100.0
# 1/variance of free coefficients: keeps short pieces solvable.
_VAGUE = 1e-8


@dataclass(frozen=True, slots=True)
class BallSamples:
    """Samples of one ball: t (n,) s, xy (n, 2) m, sigma (n,) m, root mean square per axis."""

    t: FloatArray
    xy: FloatArray
    sigma: FloatArray
    shape: FloatArray | None = None
    """(n, 2) sigma of x and of y over `sigma`; None: 1."""

    @property
    def weight(self) -> FloatArray:
        """(n, 2) 1/m^2: inverse variances of x and y."""
        shape = np.ones((len(self.t), 2)) if self.shape is None else self.shape
        weight: FloatArray = (self.sigma[:, None] * shape) ** -2
        return weight

    def select_rows(self, rows: slice) -> BallSamples:
        """Select successive samples."""
        return BallSamples(
            self.t[rows], self.xy[rows], self.sigma[rows], None if self.shape is None else self.shape[rows]
        )


@dataclass(frozen=True, slots=True)
class SampleRange:
    """Samples first to last (inclusive) of one segment."""

    first: int
    last: int
    static: bool


@dataclass(frozen=True, slots=True)
class SegmentFit:
    """Closed-form fit of a segment: state at `t0`, duration of the slide, chi2."""

    t0: float
    x: FloatArray
    v: FloatArray
    slide_acceleration: FloatArray
    roll_acceleration: FloatArray
    slide: float
    chi2: float

    def position_at(self, t: float | FloatArray) -> FloatArray:
        """Return positions (..., 2) at times t (...)."""
        basis = _motion_basis(np.asarray(t, dtype=np.float64) - self.t0, self.slide)
        return basis @ np.stack([self.x, self.v, self.slide_acceleration, self.roll_acceleration])

    def velocity_at(self, t: float) -> FloatArray:
        """Return the velocity (2,) at t, m/s."""
        tau = t - self.t0
        return (
            self.v
            + self.slide_acceleration * min(tau, self.slide)
            + self.roll_acceleration * max(tau - self.slide, 0.0)
        )

    @property
    def slip(self) -> FloatArray:
        """Slip velocity (2,) at the start, m/s: friction takes 7/2 of what it takes from the centre."""
        return -3.5 * self.slide_acceleration * self.slide


def segment_track(
    samples: BallSamples, allowed: NDArray[np.bool_], break_price: float, free_price: float
) -> list[SampleRange]:
    """Segment one track.

    Args:
        samples: n samples of one ball.
        allowed: (n - 1,) True between samples where something nearby may change a velocity.
        break_price: chi2 that a velocity change costs there.
        free_price: chi2 that it costs elsewhere.

    Returns:
        Ranges of samples, in order.
    """
    n = len(samples.t)
    if n == 0:
        return []
    bounds = _first_pass(samples, 0.6 * break_price)
    return _second_pass(samples, bounds, allowed, break_price, free_price)


def fit_segment(samples: BallSamples, t0: float) -> SegmentFit:
    """Fit the best slide that turns into a roll, in closed form for every slide time of the grid.

    Args:
        samples: Samples of one ball.
        t0: Time of the fitted state, s.

    Returns:
        The fit of least chi2.
    """
    tau, w = samples.t - t0, samples.weight.T[..., None]  # (2, n, 1)
    length, xy = max(float(tau[-1]), 0.0), samples.xy.T[..., None]  # (2, n, 1)
    best: SegmentFit | None = None
    for slide in [s for s in SLIDE_TIMES if s < length] + [np.inf]:
        prior = np.array([_VAGUE, _VAGUE, SLIDING_ACCELERATION**-2, ROLLING_ACCELERATION**-2])
        basis = _motion_basis(tau, slide)
        weighted_basis = (basis * w).transpose(0, 2, 1)  # (2, 4, n)
        solved = np.linalg.solve(weighted_basis @ basis + np.diag(prior), weighted_basis @ xy)  # (2, 4, 1)
        solution = np.asarray(solved[..., 0].T, dtype=np.float64)
        misfit = (
            _slide_strength_penalty(solution, slide, length)
            + ((samples.xy - basis @ solution) ** 2 * samples.weight).sum()
            + (prior[:, None] * solution**2).sum()
        )
        if best is None or misfit < best.chi2 - 1e-9:
            x, v, slip, roll = solution
            best = SegmentFit(t0, x, v, slip, roll, min(slide, length + 0.05), float(misfit))
    assert best is not None
    return best


def _slide_strength_penalty(solution: FloatArray, slide: float, length: float) -> float:
    """Return the chi2 of a long slide that is not as strong as friction makes it."""
    if slide < MIN_LONG_SLIDE or length < MIN_LONG_SLIDE:
        return 0.0
    return float(((np.hypot(*solution[2]) - SLIDING_ACCELERATION) / SLIDING_ACCELERATION_SIGMA) ** 2)


def _motion_basis(tau: FloatArray, slide: float) -> FloatArray:
    """Return 1, tau, and the double integrals of sliding and of rolling (..., 4)."""
    if not np.isfinite(slide):
        return np.stack([np.ones_like(tau), tau, tau**2 / 2, np.zeros_like(tau)], axis=-1)
    roll = np.maximum(tau - slide, 0.0)
    early = np.minimum(tau, slide)
    return np.stack([np.ones_like(tau), tau, early**2 / 2 + early * roll, roll**2 / 2], axis=-1)


def _first_pass(samples: BallSamples, price: float) -> IntArray:
    """Find the starts of pieces, and n at the end: constants and parabolas by dynamic programming."""
    n = len(samples.t)
    best = np.full(n + 1, np.inf)
    best[0] = 0.0
    previous = np.zeros(n + 1, np.int64)
    for first in range(n):
        total = best[first] + price + _piece_costs(samples, first)
        ends = np.arange(first + 1, n + 1)
        better = total < best[ends]
        best[ends[better]] = total[better]
        previous[ends[better]] = first
    bounds = [n]
    while bounds[-1] > 0:
        bounds.append(int(previous[bounds[-1]]))
    return np.array(bounds[::-1])


def _piece_costs(samples: BallSamples, first: int) -> FloatArray:
    """Evaluate the chi2 of the best constant or parabola through samples first..j, for every j >= first."""
    t, w = samples.t[first:] - samples.t[first], samples.weight[first:]
    xy = samples.xy[first:] - samples.xy[first]
    powers = np.stack([np.ones_like(t), t, t**2 / 2], axis=1)
    normal = np.cumsum(w[..., None, None] * (powers[:, :, None] * powers[:, None, :])[:, None], axis=0)  # (n, 2, 3, 3)
    right = np.cumsum((w * xy)[..., None] * powers[:, None], axis=0)  # (n, 2, 3)
    square = np.cumsum((w * xy**2).sum(axis=1))
    constant = square - (right[..., 0] ** 2 / normal[..., 0, 0]).sum(axis=1)
    normal = normal + np.diag([_VAGUE, _VAGUE, SLIDING_ACCELERATION**-2])
    solution = np.linalg.solve(normal, right[..., None])[..., 0]
    parabola = square - (solution * right).sum(axis=(1, 2))
    cost: FloatArray = np.minimum(constant, parabola + 4.0)
    return cost


def _static_cost(samples: BallSamples, first: int, end: int) -> float:
    xy, w = samples.xy[first:end], samples.weight[first:end]
    middle = (xy * w).sum(axis=0) / w.sum(axis=0)
    return float((((xy - middle) ** 2) * w).sum())


def _second_pass(
    samples: BallSamples, bounds: IntArray, allowed: NDArray[np.bool_], break_price: float, free_price: float
) -> list[SampleRange]:
    """Join pieces into segments; `bounds` (K + 1,) are the starts of pieces and n."""
    count = len(bounds)
    best = np.full((count, 2), np.inf)
    best[0, 1] = 0.0
    previous = np.zeros((count, 2, 2), np.int64)
    for k in range(count - 1):
        price = 0.0 if k == 0 else (break_price if allowed[bounds[k] - 1] else free_price)
        for m in range(k + 1, count):
            first, end = int(bounds[k]), int(bounds[m])
            curve = fit_segment(samples.select_rows(slice(first, end)), samples.t[first])
            moving = curve.chi2 + (_spin_penalty(curve) if k == 0 else 0.0)
            for static, cost in ((0, moving + 6.0), (1, _static_cost(samples, first, end))):
                # coming to rest needs no cause; two rests in a row need a jump, which is impossible
                entry = [
                    best[k, 0] + (break_price * 0.5 if static else price),
                    best[k, 1] + (2 * free_price if static and k else price),
                ]
                before = int(np.argmin(entry))
                if entry[before] + cost < best[m, static]:
                    best[m, static] = entry[before] + cost
                    previous[m, static] = k, before
            if moving > best[k].min() + 400 and m > k + 3 and moving > 40 * (end - first):
                break
    return _walk_back(bounds, best, previous)


def _spin_penalty(curve: SegmentFit) -> float:
    """Return the chi2 of a track that begins nearly at rest and is then driven by spin: no cue does that."""
    usual = SLIP_SIGMA_SHARE * float(np.hypot(*curve.v)) + SLIP_SIGMA_FLOOR
    return float(min((np.hypot(*curve.slip) / usual) ** 2, MAX_SPIN_PENALTY))


def _walk_back(bounds: IntArray, best: FloatArray, previous: IntArray) -> list[SampleRange]:
    parts: list[SampleRange] = []
    m, static = len(bounds) - 1, int(np.argmin(best[-1]))
    while m > 0:
        k, before = (int(value) for value in previous[m, static])
        parts.append(SampleRange(int(bounds[k]), int(bounds[m]) - 1, bool(static)))
        m, static = k, before
    return parts[::-1]
