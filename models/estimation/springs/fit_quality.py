"""Quality of a spring fit: tests of its residuals for noise, and the stiffness of springs that rods stand for."""

from __future__ import annotations

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.springs.coordinate_series import MIN_RELATIVE_NOISE
from models.estimation.springs.spring_fit import SpringFit, position_residuals
from models.physics.springs.spring_system import SpringSystem, evaluate_acceleration

MAX_CHI2 = 1.5
"""chi2 per degree of freedom."""
MAX_CORRELATION = 0.1
"""Correlation of neighbouring residuals, beyond chance."""
CHANCE_SIGMAS = 5.0
"""Standard deviations that chance may explain."""
MAX_UNEVENNESS = 3.0
"""Mean square of the residuals in an eighth of the time, over that of the median eighth."""


def find_rejections(fit: SpringFit, noise_known: bool) -> tuple[str, ...]:
    """Return the reasons, in sentences, why the residuals of a fit are not noise; none where they are."""
    off = position_residuals(fit)
    count = int(np.isfinite(off).sum())
    rejections = []
    if not np.isfinite(fit.chain.cost):
        return ("No graph of springs could be fitted: the motion of the model diverges.",)
    if np.sqrt(np.nanmean(off**2)) < MIN_RELATIVE_NOISE * fit.model.units.length:  # the rest is integration error
        return ()
    chi2 = fit.chain.cost / max(fit.freedom, 1)
    if noise_known and chi2 > MAX_CHI2 + CHANCE_SIGMAS * np.sqrt(2 / max(fit.freedom, 1)):
        rejections.append(
            f"Residuals are {np.sqrt(np.nanmean(off**2)):.3g}, {np.sqrt(chi2):.1f} times the noise of {fit.noise:.3g}: "
            "these springs do not explain the motion."
        )
    if (alike := lag_one_correlation(off)) > MAX_CORRELATION + CHANCE_SIGMAS / np.sqrt(count):
        rejections.append(f"Residuals of neighbouring samples are correlated ({alike:.2f}): they are not noise.")
    if (ratio := residual_unevenness(off)) > MAX_UNEVENNESS + CHANCE_SIGMAS * np.sqrt(16 / count):
        rejections.append(
            f"Residuals are {np.sqrt(ratio):.1f} times larger in one part than elsewhere: they are not noise."
        )
    return tuple(rejections)


def lag_one_correlation(off: FloatArray) -> float:
    """Compute the correlation of residuals (T, M) with the next ones."""
    there = np.nan_to_num(off)
    return float((there[1:] * there[:-1]).sum() / max((there**2).sum(), 1e-300))


def residual_unevenness(off: FloatArray) -> float:
    """Compute the largest mean square of the residuals (T, M) in an eighth of the time, over the median one."""
    parts = [float(np.nanmean(part**2)) for part in np.array_split(off, 8) if np.isfinite(part).any()]
    return max(parts) / max(float(np.median(parts)), 1e-300)


def estimate_compliance(series: Recording, fit: SpringFit) -> tuple[FloatArray, FloatArray]:
    """Estimate the lengthening (R,) of every rod per force on it, and its standard deviation.

    Observed lengths are compared with the tension that the fitted motion requires: it is slow with respect to the
    oscillation of a stiff spring, whose length is therefore that at rest.
    """
    graph = fit.graph
    i, j = graph.pairs[graph.rods].T
    length = np.linalg.norm(series.positions[:, j] - series.positions[:, i], axis=2) - graph.rest[graph.rods]
    pull = rod_tensions(graph, fit.states)
    ends = (~graph.fixed[i]).astype(float) + (~graph.fixed[j])
    values, sigmas = np.full(len(i), np.nan), np.full(len(i), np.nan)
    for r in range(len(i)):
        there = np.isfinite(length[:, r])
        off, force = length[there, r] - length[there, r].mean(), pull[there, r] - pull[there, r].mean()
        strength = float((force**2).sum())
        if strength > 0:
            values[r] = (off * force).sum() / strength
            sigmas[r] = fit.noise * np.sqrt(ends[r] / strength)
    return values, sigmas


def rod_tensions(graph: SpringSystem, states: FloatArray) -> FloatArray:
    """Compute the tension (T, R) of every rod."""
    free = ~graph.fixed
    loose = SpringSystem(
        graph.mass, graph.fixed, graph.pairs, np.where(np.isinf(graph.stiffness), 0.0, graph.stiffness), graph.damping,
        graph.rest, graph.gravity, graph.radius, graph.contact,
    )  # fmt: skip
    tensions = np.zeros((len(states), len(graph.rods)))
    if len(graph.rods) == 0:
        return tensions
    for k, (x, v) in enumerate(states):
        required = graph.mass[:, None] * (evaluate_acceleration(graph, x, v) - evaluate_acceleration(loose, x, v))
        unit = np.zeros((*x.shape, len(graph.rods)))
        for r, (i, j) in enumerate(graph.pairs[graph.rods]):
            along = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
            unit[i, :, r], unit[j, :, r] = along, -along
        tensions[k] = np.linalg.lstsq(unit[free].reshape(-1, len(graph.rods)), required[free].ravel(), rcond=None)[0]
    return tensions


def compute_stiffness_bound(series: Recording, fit: SpringFit) -> FloatArray:
    """Compute the lower bound (E,) of the stiffness of rods, at two standard deviations; NaN for springs."""
    bounds = np.full(len(fit.graph.pairs), np.nan)
    if len(fit.graph.rods) == 0:
        return bounds
    value, sigma = estimate_compliance(series, fit)
    bounds[fit.graph.rods] = 1 / (np.maximum(value, 0.0) + 2 * sigma)
    return bounds
