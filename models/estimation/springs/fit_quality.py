"""Whether a fit of springs is one: its residuals must be noise; and what rods say of the springs they stand for."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.estimation.springs.coordinate_series import EXACT, Coordinates
from models.estimation.springs.spring_fit import SpringFit, residuals
from models.physics.springs.spring_system import Springs, acceleration

MOST_CHI2 = 1.5
"""per degree of freedom."""
MOST_CORRELATED = 0.1
"""of neighbouring residuals, beyond what chance leaves."""
CHANCE = 5.0
"""standard deviations that chance is given."""
MOST_UNEVEN = 3.0
"""mean square of the residuals of an eighth of the time, over that of a typical eighth."""


def doubts(fit: SpringFit, noise_known: bool) -> tuple[str, ...]:
    """Why the residuals of a fit are not noise, in sentences; none where they are."""
    off = residuals(fit)
    count = int(np.isfinite(off).sum())
    found = []
    if not np.isfinite(fit.chain.cost):
        return ("No graph of springs could be fitted: the motion of the model diverges.",)
    if np.sqrt(np.nanmean(off**2)) < EXACT * fit.model.units.length:  # what is left is that of the steps
        return ()
    chi2 = fit.chain.cost / max(fit.freedom, 1)
    if noise_known and chi2 > MOST_CHI2 + CHANCE * np.sqrt(2 / max(fit.freedom, 1)):
        found.append(
            f"Residuals are {np.sqrt(np.nanmean(off**2)):.3g}, {np.sqrt(chi2):.1f} times the noise of {fit.noise:.3g}: "
            "these springs do not explain the motion."
        )
    if (alike := correlation(off)) > MOST_CORRELATED + CHANCE / np.sqrt(count):
        found.append(f"Residuals of neighbouring samples are alike (correlation {alike:.2f}): they are not noise.")
    if (ratio := unevenness(off)) > MOST_UNEVEN + CHANCE * np.sqrt(16 / count):
        found.append(f"Residuals are {np.sqrt(ratio):.1f} times larger in one part than elsewhere: they are not noise.")
    return tuple(found)


def correlation(off: FloatArray) -> float:
    """Of residuals (T, M) with the next ones."""
    there = np.nan_to_num(off)
    return float((there[1:] * there[:-1]).sum() / max((there**2).sum(), 1e-300))


def unevenness(off: FloatArray) -> float:
    """Largest mean square of the residuals (T, M) of an eighth of the time, over the median one."""
    parts = [float(np.nanmean(part**2)) for part in np.array_split(off, 8) if np.isfinite(part).any()]
    return max(parts) / max(float(np.median(parts)), 1e-300)


def compliance(seen: Coordinates, fit: SpringFit) -> tuple[FloatArray, FloatArray]:
    """(R,) lengthening of every rod per force on it, and its standard deviation.

    Seen lengths against the tension that the fitted motion asks for: slow against the swing of a stiff spring, so that
    it stretches as if it hung still.
    """
    graph = fit.graph
    i, j = graph.pairs[graph.rods].T
    length = np.linalg.norm(seen.x[:, j] - seen.x[:, i], axis=2) - graph.rest[graph.rods]
    pull = tensions(graph, fit.states)
    ends = (~graph.held[i]).astype(float) + (~graph.held[j])
    values, sigmas = np.full(len(i), np.nan), np.full(len(i), np.nan)
    for r in range(len(i)):
        there = np.isfinite(length[:, r])
        off, force = length[there, r] - length[there, r].mean(), pull[there, r] - pull[there, r].mean()
        strength = float((force**2).sum())
        if strength > 0:
            values[r] = (off * force).sum() / strength
            sigmas[r] = fit.noise * np.sqrt(ends[r] / strength)
    return values, sigmas


def tensions(graph: Springs, states: FloatArray) -> FloatArray:
    """(T, R) with what force every rod pulls its ends together."""
    free = ~graph.held
    loose = Springs(
        graph.mass, graph.held, graph.pairs, np.where(np.isinf(graph.stiffness), 0.0, graph.stiffness), graph.damping,
        graph.rest, graph.gravity, graph.radius, graph.contact,
    )  # fmt: skip
    found = np.zeros((len(states), len(graph.rods)))
    if len(graph.rods) == 0:
        return found
    for k, (x, v) in enumerate(states):
        asked = graph.mass[:, None] * (acceleration(graph, x, v) - acceleration(loose, x, v))
        unit = np.zeros((*x.shape, len(graph.rods)))
        for r, (i, j) in enumerate(graph.pairs[graph.rods]):
            along = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
            unit[i, :, r], unit[j, :, r] = along, -along
        found[k] = np.linalg.lstsq(unit[free].reshape(-1, len(graph.rods)), asked[free].ravel(), rcond=None)[0]
    return found


def least_stiffness(seen: Coordinates, fit: SpringFit) -> FloatArray:
    """(E,) what the stiffness of a rod exceeds at two standard deviations; NaN for springs."""
    found = np.full(len(fit.graph.pairs), np.nan)
    if len(fit.graph.rods) == 0:
        return found
    value, sigma = compliance(seen, fit)
    found[fit.graph.rods] = 1 / (np.maximum(value, 0.0) + 2 * sigma)
    return found
