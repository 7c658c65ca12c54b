"""What coordinates cannot tell of the springs behind them, in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from models.core.typing import FloatArray
from models.estimation.springs.parameter_layout import standards
from models.estimation.springs.spring_fit import SpringFit
from models.physics.springs.spring_system import Springs, flow, steps_for

UNSURE = 0.5
"""of a number: a larger standard deviation says no more than its size, if that."""
BRIEF = 2.0
"""samples: a push that lasts no longer may be as hard as one likes."""
WITHIN = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
"""shares of the time from sample to sample at which overlaps are looked for."""


def sentences(
    graph: Springs, names: Sequence[str], values: FloatArray, sigma: FloatArray, least: FloatArray, depth: float
) -> tuple[str, ...]:
    """Of a fit whose rods stand for springs of at least the stiffness `least` (E,), and whose surfaces overlap by
    `depth` where nobody sees it."""
    brief = [
        "A push is over before samples tell how hard it was: harder surfaces of a radius "
        f"smaller by up to {depth / 2:.3g} explain as much."
    ] if depth > 0 else []  # fmt: skip
    return (*_masses(graph), *_rods(graph, least), *brief, *_numbers(names, values, sigma))


def _masses(graph: Springs) -> Iterator[str]:
    for first in standards(graph).tolist():
        yield f"Masses are told only as multiples of that of particle {first}, where forces join them."


def _rods(graph: Springs, least: FloatArray) -> Iterator[str]:
    for edge in graph.rods.tolist():
        i, j = graph.pairs[edge].tolist()
        bound = f", except that it is above {least[edge]:.3g}" if np.isfinite(least[edge]) else ""
        yield f"How stiff the rod {i}-{j} is, and what dampens it, is not told{bound}."


def _numbers(names: Sequence[str], values: FloatArray, sigma: FloatArray) -> Iterator[str]:
    for name, value, error in zip(names, values.tolist(), sigma.tolist(), strict=True):
        unsure = not np.isfinite(error) or error > UNSURE * abs(value)
        if unsure and not name.startswith(("gravity", "place")):  # these may well be nothing
            yield f"{name} is hardly told: {value:.3g} with a standard deviation of {error:.3g}."


def hidden_depth(fit: SpringFit) -> float:
    """How far surfaces overlap at most, where a push is over before samples tell how hard it was; 0 elsewhere.

    Harder surfaces would turn the motion round as well, at a radius that is smaller by half of this.
    """
    graph = fit.graph
    i, j = graph.touching.T
    if not len(i) or graph.contact[0] <= 0:
        return 0.0
    lightness = np.where(graph.held, 0.0, 1 / graph.mass)
    lasts = np.pi / np.sqrt(graph.contact[0] * float((lightness[i] + lightness[j]).max()))
    if lasts > BRIEF * fit.model.units.span:
        return 0.0
    return max(float((graph.radius[i] + graph.radius[j] - _apart(fit)).max()), 0.0)


def _apart(fit: SpringFit) -> FloatArray:
    """(M, C) distances of pairs that may collide, at moments between samples."""
    graph, none = fit.graph, np.empty(0, np.int64)
    i, j = graph.touching.T
    found = []
    for share in WITHIN:
        spans = share * fit.model.spans
        x = flow(graph, fit.states[:-1], spans, none, steps_for(graph, spans)).ends[:, 0]
        found.append(np.linalg.norm(x[:, i] - x[:, j], axis=2))
    return np.concatenate(found)
