"""Sentences about the properties of springs that the given coordinates cannot identify."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from models.core.typing import FloatArray
from models.estimation.springs.parameter_layout import find_reference_particles
from models.estimation.springs.spring_fit import SpringFit
from models.physics.springs.spring_system import SpringSystem, count_steps, integrate_springs

MAX_RELATIVE_SIGMA = 0.5
"""Relative standard deviation above which a value expresses at most an order of magnitude."""
BRIEF_CONTACT = 2.0
"""Duration of a contact in samples: a shorter one may have any stiffness."""
OVERLAP_SHARES = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
"""Shares of the sample interval at which overlaps are evaluated."""


def format_not_identifiable(
    graph: SpringSystem, names: Sequence[str], values: FloatArray, sigma: FloatArray, least: FloatArray, depth: float
) -> tuple[str, ...]:
    """List the properties that the coordinates do not identify, as sentences.

    Args:
        graph: Fitted graph.
        names: P names of the fitted parameters.
        values: (P,) fitted values.
        sigma: (P,) standard deviations.
        least: (E,) lower bounds of the stiffness of rods.
        depth: Unobserved overlap of surfaces.

    Returns:
        Sentences.
    """
    brief = [
        "Contacts are too brief for their stiffness to be identifiable: harder surfaces of a radius "
        f"smaller by up to {depth / 2:.3g} explain as much."
    ] if depth > 0 else []  # fmt: skip
    return (*_format_masses(graph), *_format_rods(graph, least), *brief, *_format_parameters(names, values, sigma))


def _format_masses(graph: SpringSystem) -> Iterator[str]:
    for first in find_reference_particles(graph).tolist():
        yield f"Masses are identifiable only as multiples of that of particle {first}, where forces join them."


def _format_rods(graph: SpringSystem, least: FloatArray) -> Iterator[str]:
    for edge in graph.rods.tolist():
        i, j = graph.pairs[edge].tolist()
        bound = f", but the stiffness exceeds {least[edge]:.3g}" if np.isfinite(least[edge]) else ""
        yield f"Stiffness and damping of the rod {i}-{j} are not identifiable{bound}."


def _format_parameters(names: Sequence[str], values: FloatArray, sigma: FloatArray) -> Iterator[str]:
    for name, value, error in zip(names, values.tolist(), sigma.tolist(), strict=True):
        unsure = not np.isfinite(error) or error > MAX_RELATIVE_SIGMA * abs(value)
        if unsure and not name.startswith(("gravity", "place")):  # these may be zero
            yield f"{name} is hardly identifiable: {value:.3g} with a standard deviation of {error:.3g}."


def estimate_overlap(fit: SpringFit) -> float:
    """Estimate the largest overlap of surfaces in contacts that are too brief to identify their stiffness, else 0.

    Harder surfaces would reverse the motion as well, at a radius that is smaller by half of this.
    """
    graph = fit.graph
    i, j = graph.colliding_pairs.T
    if not len(i) or graph.contact[0] <= 0:
        return 0.0
    lightness = np.where(graph.fixed, 0.0, 1 / graph.mass)
    lasts = np.pi / np.sqrt(graph.contact[0] * float((lightness[i] + lightness[j]).max()))
    if lasts > BRIEF_CONTACT * fit.model.units.span:
        return 0.0
    return max(float((graph.radius[i] + graph.radius[j] - _contact_distances(fit)).max()), 0.0)


def _contact_distances(fit: SpringFit) -> FloatArray:
    """Compute the distances (M, C) of pairs that may collide, at times between samples."""
    graph, none = fit.graph, np.empty(0, np.int64)
    i, j = graph.colliding_pairs.T
    distances = []
    for share in OVERLAP_SHARES:
        spans = share * fit.model.spans
        x = integrate_springs(graph, fit.states[:-1], spans, none, count_steps(graph, spans)).ends[:, 0]
        distances.append(np.linalg.norm(x[:, i] - x[:, j], axis=2))
    return np.concatenate(distances)
