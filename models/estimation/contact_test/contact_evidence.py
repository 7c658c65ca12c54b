"""Did it happen? Two hypotheses about one moment, fitted to the same samples and weighed by their evidence.

The evidence of a hypothesis is its likelihood, integrated over everything that is not known (Laplace's approximation;
MacKay 2003, Information Theory, Inference, and Learning Algorithms, ch. 28). Nothing is weighed by hand: a contact has
more unknowns and pays for them, and its impulse follows from where the paths lead, so that a graze, which hardly
changes them, stays undecided. Errors of successive samples are correlated by an unknown amount, and their size is only
roughly known: both are integrated over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from models.core.typing import FloatArray
from models.estimation.contact_test.contact_moment import (
    MEETING,
    SHARED,
    Encounter,
    Paths,
    free_paths,
    met_paths,
    nearest,
)
from models.physics.effects.catalogue import prior_of

KNOWN_NOISE = 50.0
"""Degrees of freedom with which the size of the noise is known before: to a tenth."""
SLIP_SHARE, SLIP_FLOOR = 0.7, 0.2
"""of the speed, and m/s: slip where the window begins, one standard deviation."""
SPEEDS = 3.0
"""m/s per axis: of balls on a table, one standard deviation."""
SLOPE_SIGMA = 0.01
"""m/s^2 per axis: 1.4 mm/m of slope, or nap."""
SHARPNESS = 1e-5
"""m: surfaces that touch are so near."""
LOOSER = (1e-3, 1e-4)
"""m: steps on the way there."""
BALL_FRICTION, CUSHION_FRICTION = 0.06, 0.2
"""Impulse of friction over the normal one, one standard deviation: Alciatore, technical proof A.14; Han 2005."""
MOST_STEPS, SETTLED = 20, 3e-3
"""Of a descent, and the chi2 that another step must gain."""
CLOSE = 1e-3
"""m: half of what is asked about comes within little more, a Cauchy distribution."""
STILL_SPREAD = 1e-9
"""m/s: least standard deviation of a closing speed."""
OUTLIER = 4.5
"""standard deviations under both hypotheses."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Whitens K samples whose errors are correlated."""

    sigma: FloatArray
    """(K,) m."""
    carry: FloatArray
    """(K,) correlation with the sample before; 0 for the first of a ball."""

    def white(self, rows: FloatArray) -> FloatArray:
        """Rows (K, 2, ...) in m as independent standard errors, flat (2 K, ...)."""
        shape = (-1,) + (1,) * (rows.ndim - 1)
        unit: FloatArray = rows / self.sigma.reshape(shape)
        carry = self.carry.reshape(shape)
        before = np.concatenate([np.zeros_like(unit[:1]), unit[:-1]])
        white: FloatArray = (unit - carry * before) / np.sqrt(1 - carry**2)
        return white.reshape(2 * len(rows), *rows.shape[2:])

    @property
    def log_volume(self) -> float:
        """Sum of ln of the conditional standard deviations, both axes, but for what `sigma` adds."""
        return float(np.log1p(-(self.carry**2)).sum())


@dataclass(frozen=True, slots=True)
class Fitted:
    """A hypothesis at its best."""

    p: FloatArray
    paths: Paths
    chi2: float
    log_evidence: float
    covariance: FloatArray


Model = Callable[[Encounter, FloatArray], Paths]


def noise_of(encounter: Encounter, kept: NDArray[np.bool_], correlation: float) -> Noise:
    """Errors of all samples; those not `kept` (K,) count for nothing."""
    sigma = np.concatenate([ball.sigma for ball in encounter.balls])
    carry, at = np.zeros(len(sigma)), 0
    for ball in encounter.balls:
        step = np.diff(ball.t)
        usual = float(np.median(step)) if len(step) else 1.0
        carry[at + 1 : at + len(ball.t)] = correlation ** (step / usual) if correlation else 0.0
        at += len(ball.t)
    return Noise(np.where(kept, sigma, 1e3 * sigma), np.where(kept & np.roll(kept, 1), carry, 0.0))


def _prior(encounter: Encounter, size: int) -> tuple[FloatArray, FloatArray]:
    """Usual values and standard deviations (P,); infinite where nothing is known before."""
    mean, sigma = np.zeros(size), np.full(size, np.inf)
    for ball, columns in zip(encounter.balls, encounter.columns, strict=True):
        if not ball.rests:
            sigma[columns.start + 2 : columns.start + 4] = SPEEDS
            sigma[columns.start + 4 : columns.stop] = SLIP_SHARE * float(np.hypot(*ball.start[2:4])) + SLIP_FLOOR
    shared = encounter.shared
    sliding, rolling = prior_of("sliding_friction", "mu"), prior_of("rolling_resistance", "mu")
    sigma[shared : shared + 2] = SLOPE_SIGMA
    mean[shared + 2 : shared + SHARED] = np.log([sliding.value, rolling.value])
    sigma[shared + 2 : shared + SHARED] = sliding.sigma, rolling.sigma
    if size > shared + SHARED:
        wall = encounter.cushion is not None
        e = prior_of("cushion_restitution" if wall else "ball_restitution", "e")
        friction = CUSHION_FRICTION if wall else BALL_FRICTION
        mean[shared + SHARED + 1] = e.value
        sigma[shared + SHARED + 1 :] = e.sigma, friction, (1.0 if wall else friction)
    return mean, sigma


def starts(encounter: Encounter, t: float) -> tuple[FloatArray, FloatArray]:
    """First guesses of both hypotheses' parameters."""
    size = encounter.shared + SHARED
    mean, _ = _prior(encounter, size + MEETING)
    found = []
    for through in (True, False):
        states = [(b.through if through else b.start)[: b.size] for b in encounter.balls]
        found.append(np.concatenate([*states, mean[encounter.shared :]]))
    found[1][size] = t
    return found[0][:size], found[1]


def believed(encounter: Encounter, free: FloatArray, met: FloatArray) -> NDArray[np.bool_]:
    """(K,) samples that at least one hypothesis comes near to."""
    sigma = np.concatenate([ball.sigma for ball in encounter.balls])
    everything = np.ones(len(sigma), bool)
    noise = noise_of(encounter, everything, 0.0)
    miss = []
    for model, start in ((free_paths, free), (met_paths, met)):
        paths = fit(encounter, model, start, noise).paths
        miss.append(np.hypot(*(_seen(encounter) - paths.xy).T) / sigma)
    least: FloatArray = np.min(miss, axis=0)
    usual = max(float(np.median(least)) / 1.1774, 1.0)
    return np.asarray(least < OUTLIER * usual, dtype=np.bool_)


def _seen(encounter: Encounter) -> FloatArray:
    return np.concatenate([ball.xy for ball in encounter.balls])


def _linear(
    encounter: Encounter, model: Model, p: FloatArray, noise: Noise, touch: float
) -> tuple[FloatArray, FloatArray, Paths]:
    """Standard residuals of samples, priors and, last, of the touch, with their derivatives."""
    paths = model(encounter, p)
    mean, sigma = _prior(encounter, len(p))
    known = np.isfinite(sigma)
    residual = [noise.white(paths.xy - _seen(encounter)), ((p - mean) / sigma)[known]]
    slope = [noise.white(paths.slope), (np.eye(len(p)) / sigma[:, None])[known]]
    if len(p) > encounter.shared + SHARED:
        residual.append(np.array([paths.gap / touch]))
        slope.append(paths.gap_slope[None] / touch)
    return np.concatenate(residual), np.concatenate(slope), paths


def fit(encounter: Encounter, model: Model, start: FloatArray, noise: Noise) -> Fitted:
    """Levenberg-Marquardt; the demand that surfaces touch is tightened on the way, from where they still do not."""
    final = float(np.hypot(SHARPNESS, encounter.reach_sigma))
    p, far = start, 0.0
    if len(start) > encounter.shared + SHARED:
        far = abs(model(encounter, start).gap)
    for touch in sorted({final, *(loose for loose in LOOSER if final < loose < far)}, reverse=True):
        p = _descend(encounter, model, p, noise, touch)
    residual, slope, paths = _linear(encounter, model, p, noise, final)
    if model is free_paths:
        paths = nearest(encounter, p)
    data = 2 * len(_seen(encounter))
    chi2 = float(residual[:data] @ residual[:data])
    rest = float(residual[data:] @ residual[data:])
    heavy = (data + KNOWN_NOISE) / (KNOWN_NOISE + chi2)  # precision at the likeliest size of the noise
    weight = np.concatenate([np.full(data, heavy), np.ones(len(residual) - data)])
    information = (slope.T * weight) @ slope
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    scaled = information * scale * scale[:, None] + 1e-12 * np.eye(len(p))
    covariance = np.linalg.inv(scaled) * scale * scale[:, None]
    log_volume = 0.5 * np.linalg.slogdet(scaled)[1] - float(np.log(scale).sum())
    likelihood = -(data + KNOWN_NOISE) / 2 * float(np.log1p(chi2 / KNOWN_NOISE)) - noise.log_volume - rest / 2
    _, sigma = _prior(encounter, len(p))
    known = sigma[np.isfinite(sigma)]
    density = -float(np.log(known).sum()) - 0.5 * len(known) * np.log(2 * np.pi)
    evidence = likelihood + density + 0.5 * len(p) * np.log(2 * np.pi) - log_volume
    found = Fitted(p, paths, chi2, 0.0, covariance)
    return Fitted(p, paths, chi2, float(evidence + _possible(encounter, found, final)), covariance)


def _possible(encounter: Encounter, fit: Fitted, touch: float) -> float:
    """ln of how far geometry, and what is asked about, allow a hypothesis.

    Paths that do not meet keep apart; those that meet close in on each other, and a moment of contact stands for the
    paths that lead to it in proportion to their closing speed.
    """
    paths = fit.paths
    if len(fit.p) == encounter.shared + SHARED:
        spread = float(np.hypot(encounter.reach_sigma, np.sqrt(paths.gap_slope @ fit.covariance @ paths.gap_slope)))
        gap = np.linspace(0, max(paths.gap, 0.0) + 6 * spread, 400)
        share = _density((gap - paths.gap) / spread) / spread * _asked(encounter, gap)
        return float(np.log(max(np.trapezoid(share, gap), 1e-300)))
    # two balls that lie still close in on each other not at all, and that for certain
    spread = max(float(np.sqrt(paths.closing_slope @ fit.covariance @ paths.closing_slope)), STILL_SPREAD)
    z = paths.closing / spread
    mean = spread * (z * ndtr(z) + _density(z))  # of max(closing, 0)
    overlap = min(nearest(encounter, fit.p[: encounter.shared + SHARED]).gap, 0.0)
    weight = max(mean * float(_asked(encounter, np.array(overlap))), 1e-300)
    return float(np.log(weight) - np.log(touch) - 0.5 * np.log(2 * np.pi))


def _density(z: FloatArray | float) -> FloatArray:
    """Of the standard normal distribution."""
    found: FloatArray = np.exp(-0.5 * np.square(z)) / np.sqrt(2 * np.pi)
    return found


def _asked(encounter: Encounter, gap: FloatArray) -> FloatArray:
    """Density (1/m) of gaps that calls are about: every other one is close, the rest are anything."""
    near: FloatArray = 0.5 / (np.pi * CLOSE * (1 + (gap / CLOSE) ** 2))
    return near + 0.25 / encounter.reach


def _descend(encounter: Encounter, model: Model, p: FloatArray, noise: Noise, touch: float) -> FloatArray:
    residual, slope, _ = _linear(encounter, model, p, noise, touch)
    cost, damping = float(residual @ residual), 1e-3
    for _ in range(MOST_STEPS):
        normal, gradient = slope.T @ slope, slope.T @ residual
        scale = np.diag(normal) + 1e-9
        for _ in range(6):
            step = np.linalg.solve(normal + np.diag(damping * scale + 1e-9 * scale), -gradient)
            trial = _within(encounter, p, p + step)
            new_residual, new_slope, _ = _linear(encounter, model, trial, noise, touch)
            new_cost = float(new_residual @ new_residual)
            if new_cost < cost:
                break
            damping = damping * 8 + 1e-6
        else:
            return p
        gain = cost - new_cost
        p, residual, slope, cost = trial, new_residual, new_slope, new_cost
        damping *= 0.1
        if gain < SETTLED * (1 + 1e-3 * cost):
            break
    return p


def _within(encounter: Encounter, old: FloatArray, new: FloatArray) -> FloatArray:
    """No contact leaves the window, or moves by more than a tenth of it at once."""
    column = encounter.shared + SHARED
    if len(new) <= column:
        return new
    last = max(float(ball.t[-1]) for ball in encounter.balls)
    tenth = 0.1 * (last - encounter.begin)
    limited = new.copy()
    limited[column] = np.clip(new[column], old[column] - tenth, old[column] + tenth)
    limited[column] = np.clip(limited[column], encounter.begin, last)
    return limited
