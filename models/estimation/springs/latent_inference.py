"""Latent inference: masses, springs, dampers, gravity and connections, from coordinates alone.

Chen 2022 names it in the abstract; here the mass-spring-damper model itself (eqs 1 to 9) is fitted. The stiffness is
searched from soft springs to rods; springs that are too stiff for an observable stretching become rods, with a lower
bound on their stiffness; particles that reverse at a jolt are tried as colliding surfaces. A fit that leaves more than
noise is rejected with reasons, and properties that the coordinates cannot identify are listed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.springs.colliding_particles import fit_collisions
from models.estimation.springs.coordinate_series import MIN_SAMPLES, estimate_coordinate_noise, find_fixed_particles
from models.estimation.springs.fit_quality import compute_stiffness_bound, find_rejections
from models.estimation.springs.graph_search import search_graphs
from models.estimation.springs.identifiability import estimate_overlap, format_not_identifiable
from models.estimation.springs.model_reduction import simplify_fit
from models.estimation.springs.spring_fit import SpringFit, covariance_of_shared
from models.physics.springs.spring_system import SpringSystem, count_steps, integrate_springs, simulate_springs


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
