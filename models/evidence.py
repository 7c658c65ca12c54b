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
from scipy.special import logsumexp
from scipy.stats import norm

from models.effects.catalogue import prior_of
from models.touch import MEETING, PATH, SHARED, Encounter, Paths, free_paths, met_paths, nearest

Floats = NDArray[np.float64]

CORRELATIONS = (0.0, 0.35, 0.6, 0.8)
"""Of errors of successive samples, equally probable before: an AR(1) process each."""
KNOWN_NOISE = 50.0
"""Degrees of freedom with which the size of the noise is known before: to a tenth."""
SLIP_SHARE, SLIP_FLOOR = 0.7, 0.2
"""of the speed, and m/s: slip where the window begins, one standard deviation."""
SPEEDS = 3.0
"""m/s per axis: of balls on a table, one standard deviation."""
SLOPE_SIGMA = 0.02
"""m/s^2 per axis: slope and nap."""
SHARPNESS = 1e-5
"""m: surfaces that touch are so near."""
LOOSER = (1e-3, 1e-4)
"""m: steps on the way there."""
BALL_FRICTION, CUSHION_FRICTION = 0.06, 0.2
"""Impulse of friction over the normal one, one standard deviation: Alciatore, technical proof A.14; Han 2005."""
MOST_STEPS, SETTLED = 20, 3e-3
"""Of a descent, and the chi2 that another step must gain."""
OUTLIER = 4.5
"""standard deviations under both hypotheses."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the samples say of one moment."""

    probability: float
    """That the bodies touched."""
    t: float
    """s: of the contact; of the nearest moment where none is likelier."""
    t_sigma: float
    gap: float
    """m: least distance of the surfaces on free paths, negative where they would overlap, as the samples before and
    after tell, whichever hypothesis is likelier."""
    gap_sigma: float
    chi2: float
    """per degree of freedom, of the likelier hypothesis, against the errors that the samples promise."""
    correlation: float
    """of errors of successive samples."""
    closing: float
    """m/s along the normal at contact; 0 where they did not touch."""


@dataclass(frozen=True, slots=True)
class _Noise:
    """Whitens K samples whose errors are correlated."""

    sigma: Floats
    """(K,) m."""
    carry: Floats
    """(K,) correlation with the sample before; 0 for the first of a ball."""

    def white(self, rows: Floats) -> Floats:
        """Rows (K, 2, ...) in m as independent standard errors, flat (2 K, ...)."""
        shape = (-1,) + (1,) * (rows.ndim - 1)
        unit = rows / self.sigma.reshape(shape)
        carry = self.carry.reshape(shape)
        unit = (unit - carry * np.concatenate([unit[:1] * 0, unit[:-1]])) / np.sqrt(1 - carry**2)
        return unit.reshape(2 * len(rows), *rows.shape[2:])

    @property
    def log_volume(self) -> float:
        """Sum of ln of the conditional standard deviations, both axes, but for what `sigma` adds."""
        return float(np.log1p(-(self.carry**2)).sum())


@dataclass(frozen=True, slots=True)
class _Fitted:
    """A hypothesis at its best."""

    p: Floats
    paths: Paths
    chi2: float
    log_evidence: float
    covariance: Floats


Model = Callable[[Encounter, Floats], Paths]


def weigh(encounter: Encounter, t: float, correlations: tuple[float, ...] = CORRELATIONS) -> Verdict:
    """How probable a contact near t (s) is, and when; ValueError where there are too few samples to say.

    The encounter's window holds no other contact. `correlations` are those of errors that are thought possible.
    """
    count = sum(len(ball.t) for ball in encounter.balls)
    if 2 * count < encounter.shared + SHARED + MEETING:
        raise ValueError(f"a contact is weighed by at least {encounter.shared} samples; got {count}")
    free, met = _starts(encounter, t)
    kept = _believed(encounter, free, met)
    found: list[tuple[float, _Fitted, _Fitted]] = []
    for correlation in correlations:
        noise = _noise(encounter, kept, correlation)
        free_fit = _fit(encounter, free_paths, free, noise)
        met_fit = _fit(encounter, met_paths, met, noise)
        found.append((correlation, free_fit, met_fit))
        free, met = free_fit.p, met_fit.p
    return _verdict(encounter, found)


def geometry_alone(encounter: Encounter, t: float) -> tuple[float, float]:
    """Gap, and its sigma, m, to which the paths that are seen before t (s) lead; errors taken as independent."""
    late = np.concatenate([ball.t >= t for ball in encounter.balls])
    _, met = _starts(encounter, t)
    fit = _fit(encounter, free_paths, met[: encounter.shared + SHARED], _noise(encounter, ~late, 0.0))
    return _margin(encounter, fit)


def _verdict(encounter: Encounter, found: list[tuple[float, _Fitted, _Fitted]]) -> Verdict:
    free = np.array([fit.log_evidence for _, fit, _ in found])
    met = np.array([fit.log_evidence for _, _, fit in found])
    probability = float(np.exp(logsumexp(met) - logsumexp([*met, *free])))
    touched = probability > 0.5
    best = int(np.argmax(met if touched else free))
    correlation, apart, together = found[best]
    chosen = together if touched else apart
    gap, gap_sigma = _margin(encounter, chosen)
    column = encounter.shared + SHARED
    variance = together.covariance[column, column] if touched else _nearest_variance(encounter, apart)
    data = 2 * sum(len(ball.t) for ball in encounter.balls)
    return Verdict(
        probability, chosen.paths.t, float(np.sqrt(variance)), gap, gap_sigma,
        chosen.chi2 / max(data - len(chosen.p), 1), correlation, max(chosen.paths.closing, 0.0) if touched else 0.0,
    )  # fmt: skip


def _margin(encounter: Encounter, fit: _Fitted) -> tuple[float, float]:
    """Gap of the free paths that begin as this fit does, and its sigma, m."""
    size = encounter.shared + SHARED
    paths = nearest(encounter, fit.p[:size])
    variance = float(paths.gap_slope @ fit.covariance[:size, :size] @ paths.gap_slope)
    if len(fit.p) == size:
        variance += encounter.reach_sigma**2
    return paths.gap, float(np.sqrt(variance))


def _nearest_variance(encounter: Encounter, fit: _Fitted) -> float:
    """Of the moment at which free paths are nearest, s^2: where the closing speed passes zero."""
    later = _at(encounter, fit.p, fit.paths.t + 1e-3)
    rate = (later.closing - fit.paths.closing) / 1e-3
    slope = fit.paths.closing_slope / min(rate, -1e-6)
    return float(min(slope @ fit.covariance @ slope, 0.25))


def _at(encounter: Encounter, p: Floats, t: float) -> Paths:
    """Geometry at a moment of free paths."""
    return met_paths(encounter, np.concatenate([p, [t, 1.0, 0.0, 0.0]]))


def _noise(encounter: Encounter, kept: NDArray[np.bool_], correlation: float) -> _Noise:
    """Errors of all samples; those not `kept` (K,) count for nothing."""
    sigma = np.concatenate([ball.sigma for ball in encounter.balls])
    carry, at = np.zeros(len(sigma)), 0
    for ball in encounter.balls:
        step = np.diff(ball.t)
        usual = float(np.median(step)) if len(step) else 1.0
        carry[at + 1 : at + len(ball.t)] = correlation ** (step / usual) if correlation else 0.0
        at += len(ball.t)
    return _Noise(np.where(kept, sigma, 1e3 * sigma), np.where(kept & np.roll(kept, 1), carry, 0.0))


def _prior(encounter: Encounter, size: int) -> tuple[Floats, Floats]:
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


def _starts(encounter: Encounter, t: float) -> tuple[Floats, Floats]:
    """First guesses of both hypotheses' parameters."""
    size = encounter.shared + SHARED
    mean, _ = _prior(encounter, size + MEETING)
    found = []
    for through in (True, False):
        states = [(b.through if through else b.start)[: 2 if b.rests else PATH] for b in encounter.balls]
        found.append(np.concatenate([*states, mean[encounter.shared :]]))
    found[1][size] = t
    return found[0][:size], found[1]


def _believed(encounter: Encounter, free: Floats, met: Floats) -> NDArray[np.bool_]:
    """(K,) samples that at least one hypothesis comes near to."""
    sigma = np.concatenate([ball.sigma for ball in encounter.balls])
    everything = np.ones(len(sigma), bool)
    noise = _noise(encounter, everything, 0.0)
    miss = []
    for model, start in ((free_paths, free), (met_paths, met)):
        paths = _fit(encounter, model, start, noise).paths
        miss.append(np.hypot(*(_seen(encounter) - paths.xy).T) / sigma)
    least: Floats = np.min(miss, axis=0)
    usual = max(float(np.median(least)) / 1.1774, 1.0)
    return np.asarray(least < OUTLIER * usual, dtype=np.bool_)


def _seen(encounter: Encounter) -> Floats:
    return np.concatenate([ball.xy for ball in encounter.balls])


def _linear(encounter: Encounter, model: Model, p: Floats, noise: _Noise, touch: float) -> tuple[Floats, Floats, Paths]:
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


def _fit(encounter: Encounter, model: Model, start: Floats, noise: _Noise) -> _Fitted:
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
    found = _Fitted(p, paths, chi2, 0.0, covariance)
    return _Fitted(p, paths, chi2, float(evidence + _possible(encounter, found, final)), covariance)


def _possible(encounter: Encounter, fit: _Fitted, touch: float) -> float:
    """ln of the share of a hypothesis that geometry allows.

    Paths that do not meet keep apart; those that meet close in on each other, and a moment of contact stands for the
    paths that lead to it in proportion to their closing speed.
    """
    paths = fit.paths
    if len(fit.p) == encounter.shared + SHARED:
        spread = np.hypot(encounter.reach_sigma, np.sqrt(paths.gap_slope @ fit.covariance @ paths.gap_slope))
        return float(norm.logcdf(paths.gap / spread))
    spread = float(np.sqrt(paths.closing_slope @ fit.covariance @ paths.closing_slope))
    z = paths.closing / spread
    mean = spread * (z * norm.cdf(z) + norm.pdf(z))  # of max(closing, 0)
    return float(np.log(max(mean, 1e-300)) - np.log(touch) - 0.5 * np.log(2 * np.pi))


def _descend(encounter: Encounter, model: Model, p: Floats, noise: _Noise, touch: float) -> Floats:
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


def _within(encounter: Encounter, old: Floats, new: Floats) -> Floats:
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
