"""Latent inference: masses, springs, dampers, gravity and connections, from coordinates alone.

Chen 2022 names it in the abstract; here the mass-spring-damper model itself (eqs 1 to 9) is fitted. The stiffness is
searched from soft springs to rods; springs that are too stiff for an observable stretching become rods, with a lower
bound on their stiffness; particles that reverse at a jolt are tried as colliding surfaces. A fit that leaves more than
noise is rejected with reasons, and properties that the coordinates cannot identify are listed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.springs.colliding_particles import fit_collisions
from models.estimation.springs.coordinate_series import MIN_SAMPLES, estimate_coordinate_noise, find_fixed_particles
from models.estimation.springs.fit_quality import compute_stiffness_bound, find_rejections
from models.estimation.springs.graph_search import search_graphs
from models.estimation.springs.model_reduction import simplify_fit
from models.estimation.springs.parameter_layout import find_reference_particles
from models.estimation.springs.spring_fit import SpringFit, covariance_of_shared
from models.physics.springs.spring_system import SpringSystem, count_steps, integrate_springs, simulate_springs

MAX_RELATIVE_SIGMA = 0.5
"""Relative standard deviation above which a value expresses at most an order of magnitude."""
BRIEF_CONTACT = 2.0
"""Duration of a contact in samples: a shorter one may have any stiffness."""
OVERLAP_SHARES = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
"""Shares of the sample interval at which overlaps are evaluated."""


@dataclass(frozen=True, slots=True)
class LatentSprings:
    """The springs inferred from coordinates."""

    t: FloatArray
    """(T,) s, of the samples."""
    states: FloatArray
    """(T, 2, N, D) positions and velocities at the samples."""
    graph: SpringSystem
    """Masses are relative to the first free particle of every connected group."""
    names: tuple[str, ...]
    """(P,) of the fitted parameters."""
    values: FloatArray
    """(P,) fitted values."""
    sigma: FloatArray
    """(P,) standard deviations."""
    stiffness_bound: FloatArray
    """(E,) lower bound of the stiffness of a rod, at two standard deviations; NaN for springs."""
    noise: float
    """Standard deviation of a coordinate."""
    simplifications: tuple[str, ...]
    """Simplifications that the data do not contradict."""
    not_identifiable: tuple[str, ...]
    """Sentences: which properties such coordinates cannot identify."""
    rejections: tuple[str, ...]
    """Reasons for the rejection of the fit; empty where it is accepted."""

    @property
    def is_accepted(self) -> bool:
        """Whether the residuals are noise."""
        return not self.rejections

    def states_at(self, t: FloatArray) -> FloatArray:
        """Compute states (M, 2, N, D) at any times (M,): between samples, before the first and after the last one."""
        after = np.flatnonzero(t > self.t[-1])
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        spans = np.where(t > self.t[-1], 0.0, t - self.t[k])
        speed = 2 * float(np.abs(self.states[:, 1]).max())
        steps = count_steps(self.graph, spans, speed)
        states = integrate_springs(self.graph, self.states[k], spans, np.empty(0, np.int64), steps).ends
        if len(after):
            later = np.unique(t[after])
            path = simulate_springs(self.graph, self.states[-1], np.concatenate([self.t[-1:], later]))[1:]
            states[after] = path[np.searchsorted(later, t[after])]
        return states


def infer_springs(series: Recording) -> LatentSprings:
    """Infer the springs behind coordinates.

    Args:
        series: Observed particles; without sigmas, fixed particles or the residuals of the fit determine the noise.

    Returns:
        The springs; where the fit fails, with the reasons of its rejection.

    Raises:
        ValueError: There are too few samples.
    """
    series.require_samples(MIN_SAMPLES)
    is_fixed = find_fixed_particles(series)
    coordinate_noise = estimate_coordinate_noise(series, is_fixed)
    fit = search_graphs(series, is_fixed, coordinate_noise)
    if find_rejections(fit, coordinate_noise is not None):
        fit = fit_collisions(series, fit, coordinate_noise)
    rejections = find_rejections(fit, coordinate_noise is not None)
    fit, simplifications = simplify_fit(series, fit) if not rejections else (fit, ())
    return _summarize_fit(series, fit, simplifications, find_rejections(fit, coordinate_noise is not None))


def _summarize_fit(
    series: Recording, fit: SpringFit, simplifications: tuple[str, ...], rejections: tuple[str, ...]
) -> LatentSprings:
    layout = fit.model.layout
    names, values = layout.names, layout.values(fit.chain.shared)
    sigma = np.sqrt(np.diag(covariance_of_shared(fit)).clip(0)) * layout.slope(fit.chain.shared)
    least, depth = compute_stiffness_bound(series, fit), estimate_overlap(fit)
    sigma = np.hypot(sigma, np.where(np.array(names) == "radius", depth / 2, 0.0))
    return LatentSprings(
        series.t, fit.states, fit.graph, names, values, sigma, least, fit.noise, simplifications,
        format_not_identifiable(fit.graph, names, values, sigma, least, depth), rejections,
    )  # fmt: skip


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
