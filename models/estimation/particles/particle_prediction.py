"""Prediction of particles with unknown physics; its uncertainty comes from predictions of the observed past."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.particles.particle_fit import (
    Motion,
    ParticleFit,
    ParticleMotion,
    fit_spring_motion,
    list_candidate_fits,
)

BACKTEST_SHARES = (0.5, 0.75)
"""Shares of the samples after which the rest is predicted and compared."""
EXTRAPOLATION_SAMPLES = 6
"""Last samples of a particle that a polynomial extrapolates."""
MIN_ERRORS = 3
"""Errors from which their growth is fitted."""
MIN_GROWTH_POWER, MAX_GROWTH_POWER = 0.5, 3.0
"""Least (`MIN_GROWTH_POWER`) and largest power of time with which errors may grow."""


@dataclass(frozen=True, slots=True)
class ParticlePrediction:
    """Predicted positions of N particles."""

    kind: str
    """springs, collisions, free flight, rigid bodies, falling or straight on."""
    t: FloatArray
    """(M,) s"""
    x: FloatArray
    """(M, N, D)"""
    sigma: FloatArray
    """(M,) standard deviation of a coordinate."""
    parameters: dict[str, float]
    """Fitted parameters of the physics by name."""
    parameter_sigma: dict[str, float] = field(default_factory=dict)
    """Standard deviations of the parameters, where they are known."""
    not_identifiable: tuple[str, ...] = ()
    """Sentences: which properties such coordinates cannot identify."""


@dataclass(frozen=True, slots=True)
class ErrorGrowth:
    """A standard deviation that grows as `scale` times a power of the lead time."""

    floor: float
    scale: float
    power: float

    def sigma_at(self, lead: FloatArray) -> FloatArray:
        """Compute the standard deviation (M,) after lead times (M,) s."""
        return np.asarray(np.hypot(self.floor, self.scale * lead**self.power), np.float64)


def forecast_particles(particles: Recording, t: FloatArray) -> ParticlePrediction:
    """Predict the positions of particles after their last sample.

    Args:
        particles: Observed particles.
        t: (M,) s, after the last sample.

    Returns:
        The prediction by springs where they are accepted, else by the candidate of least error in the past.
    """
    springs = fit_spring_motion(particles)
    if springs is not None:
        growth = fit_error_growth(*measure_backtest_errors(particles, _refit_springs), particles)
        sigma = growth.sigma_at(t - particles.t[-1])
        return ParticlePrediction(
            springs.kind,
            t,
            springs.motion(t),
            sigma,
            springs.parameters,
            springs.parameter_sigma,
            springs.not_identifiable,
        )
    candidates: dict[str, ParticleFit] = {"straight on": build_extrapolation(1), "falling": build_extrapolation(2)}
    candidates |= {name: fit for name, fit in list_candidate_fits(particles).items() if name == "rigid bodies"}
    backtests = {name: measure_backtest_errors(particles, fit) for name, fit in candidates.items()}
    kind = min(
        backtests, key=lambda name: float(np.median(np.abs(backtests[name][1]))) if len(backtests[name][1]) else np.inf
    )
    motion, numbers = candidates[kind](particles)
    return ParticlePrediction(
        kind, t, motion(t), fit_error_growth(*backtests[kind], particles).sigma_at(t - particles.t[-1]), numbers
    )


def _refit_springs(particles: Recording) -> tuple[Motion, dict[str, float]]:
    """Fit springs to fewer samples; extrapolate straight on where they are not accepted."""
    springs: ParticleMotion | None = fit_spring_motion(particles)
    return build_extrapolation(1)(particles) if springs is None else (springs.motion, springs.parameters)


def build_extrapolation(degree: int) -> ParticleFit:
    """Build the fit of a polynomial to the last samples of each particle.

    A line is fitted to half as many samples as a parabola.
    """

    def fit(past: Recording) -> tuple[Motion, dict[str, float]]:
        curves: list[Callable[[FloatArray], FloatArray]] = []
        for k, there in enumerate(past.is_observed.T):
            recent = np.flatnonzero(there)[-(EXTRAPOLATION_SAMPLES * degree // 2) :]
            last = past.t[recent[-1]]
            curves.append(_build_polynomial(np.polyfit(past.t[recent] - last, past.positions[recent, k], degree), last))
        return lambda t: np.stack([curve(t) for curve in curves], axis=1), {}

    return fit


def _build_polynomial(coefficients: FloatArray, begin: float) -> Callable[[FloatArray], FloatArray]:
    """Build the function of a polynomial in the time since `begin`."""

    def curve(t: FloatArray) -> FloatArray:
        powers = (t - begin)[:, None] ** np.arange(len(coefficients) - 1, -1, -1)
        return np.asarray(powers @ coefficients, np.float64)

    return curve


def measure_backtest_errors(particles: Recording, fit: ParticleFit) -> tuple[FloatArray, FloatArray]:
    """Measure the errors of predictions from `BACKTEST_SHARES` of the past.

    Args:
        particles: Observed particles.
        fit: Fit whose predictions are compared.

    Returns:
        Lead times (L,) s and RMS errors (L,) over coordinates.
    """
    leads, errors = [], []
    for share in BACKTEST_SHARES:
        last = round(share * (len(particles.t) - 1))
        if int(particles.is_observed[: last + 1].sum(axis=0).min()) < EXTRAPOLATION_SAMPLES:
            continue
        motion, _ = fit(particles.select_rows(0, last + 1))
        later = slice(last + 1, None)
        off = motion(particles.t[later]) - particles.positions[later]
        there = np.isfinite(off).any(axis=(1, 2))
        leads.append((particles.t[later] - particles.t[last])[there])
        errors.append(np.sqrt(np.nanmean(off[there] ** 2, axis=(1, 2))))
    return (np.concatenate(leads), np.concatenate(errors)) if leads else (np.empty(0), np.empty(0))


def fit_error_growth(leads: FloatArray, errors: FloatArray, particles: Recording) -> ErrorGrowth:
    """Fit a power law to errors (L,) at lead times (L,) s.

    With too few errors, the uncertainty is the extent of the motion.
    """
    there = (leads > 0) & (errors > 0)
    leads, errors = leads[there], errors[there]
    if len(leads) < MIN_ERRORS:
        return ErrorGrowth(float(np.nanstd(particles.positions)), 0.0, 1.0)
    power = float(np.clip(np.polyfit(np.log(leads), np.log(errors), 1)[0], MIN_GROWTH_POWER, MAX_GROWTH_POWER))
    scale = float(np.sqrt(np.mean((errors / leads**power) ** 2)))
    return ErrorGrowth(float(errors[np.argmin(leads)]), scale, power)
