"""Latent inference: masses, springs, dampers, gravity and connections, from coordinates alone.

Chen 2022 names it in the abstract; here the mass-spring-damper model itself (eqs 1 to 9) is fitted. The stiffness is
searched from soft springs to rods; springs that are too stiff for an observable stretching become rods, with a lower
bound on their stiffness; particles that reverse at a jolt are tried as colliding surfaces. A fit that leaves more than
noise is rejected with reasons, and properties that the coordinates cannot identify are listed.

The fit is simplified where the data do not contradict it: equal springs, gravity along an axis, a start from rest. Each
removes parameters, and the others become more certain. A simplification is adopted where its increase of chi2 is less
than the removed parameters are worth (Schwarz 1978, doi:10.1214/aos/1176344136).

Chen 2022 models collisions as stiff springs between surfaces (section 2.2). Distances that reverse at a jolt show which
particles collide. A contact is shorter than the sample interval, so its stiffness is poorly identified and correlated
with the radius: several stiffnesses are tried, and the errors of the fit express how well either is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.springs.dense_shooting import build_normal_equations, state_covariance
from models.estimation.springs.graph_search import compute_stiffness_bound, find_rejections, fit_noise, search_graphs
from models.estimation.springs.parameter_layout import (
    MIN_RELATIVE_NOISE,
    MIN_SAMPLES,
    estimate_coordinate_noise,
    find_fixed_particles,
    find_reference_particles,
    measure_scales,
)
from models.estimation.springs.spring_fit import (
    SearchEffort,
    SpringFit,
    assume_resting_start,
    assume_unstretched_start,
    covariance_of_shared,
    fit_graph,
    tighten_links,
)
from models.physics.springs.spring_system import (
    SpringSystem,
    build_springs,
    count_steps,
    integrate_springs,
    simulate_springs,
)

# Relative standard deviation above which a value expresses at most an order of magnitude.
MAX_RELATIVE_SIGMA = 0.5
# Duration of a contact in samples: a shorter one may have any stiffness.
BRIEF_CONTACT = 2.0
# Shares of the sample interval at which overlaps are evaluated.
OVERLAP_SHARES = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875)


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
        fit = _fit_collisions(series, fit, coordinate_noise)
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


PARAMETER_KINDS = ("mass", "stiffness", "damping", "rest")
REST_AT_START = "starts from rest"
SLACK_AT_START = "starts unstretched"
# Search effort from a fit that is almost right.
REFIT = SearchEffort(stages=2, iterations=6, last_iterations=15)
# Link sigma, over the noise, from which a simplified graph is refitted.
REFIT_LINK_SIGMA = 3.0


@dataclass(frozen=True, slots=True)
class Simplification:
    """Parameters that are equal, or zero."""

    name: str
    """Description in words."""
    coordinates: tuple[str, ...]
    """Names of the coordinates involved; none for a start from rest."""
    chi2_increase: float
    """Increase of chi2 by the simplification."""
    parameters_saved: int
    """Number of parameters that it removes."""


def simplify_fit(series: Recording, fit: SpringFit) -> tuple[SpringFit, tuple[str, ...]]:
    """Refit with all simplifications that pay off; return the fit and their names."""
    worth = float(np.log((fit.observed.weight > 0).sum()))
    adopted = [one for one in list_simplifications(fit) if one.chi2_increase < worth * one.parameters_saved]
    while adopted:
        simpler = _refit_simplified(series, fit, adopted)
        if simpler.chain.cost - fit.chain.cost < worth * sum(one.parameters_saved for one in adopted):
            return simpler, tuple(one.name for one in adopted)
        adopted.remove(max(adopted, key=lambda one: one.chi2_increase / one.parameters_saved))
    return fit, ()


def list_simplifications(fit: SpringFit) -> list[Simplification]:
    """List possible simplifications, each with the increase of chi2 that it causes alone (Wald)."""
    names, spread = fit.model.layout.names, covariance_of_shared(fit)
    simplifications = [
        Simplification(f"equal {kind}", tuple(alike), *_test_equality(fit, alike, kind, spread))
        for kind in PARAMETER_KINDS
        if (alike := [name for name in names if name.startswith(kind + " ")]) and (len(alike) > 1 or kind == "mass")
    ]
    for name in names:
        if name.startswith("gravity"):
            k = names.index(name)
            chi2_increase = float(fit.chain.shared[k] ** 2 / spread[k, k])
            simplifications.append(Simplification(f"no {name}", (name,), chi2_increase, 1))
    half = fit.model.state_inputs.size // 2
    v, around = fit.chain.states[0, half:], state_covariance(build_normal_equations(fit.observed, fit.chain), spread)
    simplifications.append(Simplification(REST_AT_START, (), *_wald_statistic(v, around[half:, half:])))
    if len(fit.graph.pairs) > len(fit.graph.rods):
        simplifications.append(Simplification(SLACK_AT_START, (), *_test_unstretched_start(fit, spread, around)))
    return simplifications


def _test_unstretched_start(fit: SpringFit, spread: FloatArray, around: FloatArray) -> tuple[float, int]:
    """Test whether springs have their rest lengths at the first sample.

    Errors of lengths and positions are assumed to be independent, which the following fit corrects.
    """
    slack = replace(fit.model, starts_unstretched=True, constraint_sigma=1.0).predict(
        fit.chain.states, fit.chain.shared
    )
    rows = slice(2 * len(fit.graph.rods), None)
    by_state, by_shared = slack.constraint_state_jacobian[0, rows], slack.constraint_shared_jacobian[0, rows]
    return _wald_statistic(
        slack.constraints[0, rows], by_state @ around @ by_state.T + by_shared @ spread @ by_shared.T
    )


def _test_equality(fit: SpringFit, names: list[str], kind: str, spread: FloatArray) -> tuple[float, int]:
    """Test whether parameters are equal."""
    where = [fit.model.layout.names.index(name) for name in names]
    values, around = fit.chain.shared[where], spread[np.ix_(where, where)]
    if kind == "mass":  # the first one is the unit
        return _wald_statistic(values, around)
    contrast = np.eye(len(where))[1:] - np.eye(len(where))[0]
    return _wald_statistic(contrast @ values, contrast @ around @ contrast.T)


def _wald_statistic(off: FloatArray, spread: FloatArray) -> tuple[float, int]:
    """Compute chi2 of the hypothesis that all values are zero, and the number of independent values."""
    scale = np.sqrt(np.diag(spread).clip(1e-300))
    values, vectors = np.linalg.eigh(spread / scale / scale[:, None])
    free = values > 1e-8 * values.max()
    return float((((off / scale) @ vectors[:, free]) ** 2 / values[free]).sum()), int(free.sum())


def _refit_simplified(series: Recording, fit: SpringFit, adopted: list[Simplification]) -> SpringFit:
    """Refit with the adopted simplifications."""
    layout, graph = fit.model.layout, fit.graph
    for one in adopted:
        if not one.coordinates:
            continue
        if one.coordinates[0].startswith("gravity"):
            axis = "xyz".index(one.coordinates[0][-1])
            graph = replace(graph, gravity=np.where(np.arange(len(graph.gravity)) == axis, 0.0, graph.gravity))
            layout = layout.drop_coordinates(set(one.coordinates))
        elif one.coordinates[0].startswith("mass"):
            graph = replace(graph, mass=np.ones_like(graph.mass))
            layout = layout.drop_coordinates(set(one.coordinates))
        else:
            layout = layout.merge_coordinates(list(one.coordinates), one.coordinates[0].split()[0])
    simpler = fit_graph(series, graph, fit.noise, SearchEffort(stages=0), layout, fit)
    names = [one.name for one in adopted]
    simpler = assume_resting_start(simpler) if REST_AT_START in names else simpler
    simpler = assume_unstretched_start(simpler) if SLACK_AT_START in names else simpler
    return tighten_links(simpler, REFIT_LINK_SIGMA * fit.noise, REFIT)


# Second difference of a distance vector, over its usual value, that indicates a push.
JOLT_RATIO = 8.0
# Samples around the nearest one within which the jolt is.
JOLT_SAMPLES = 1
# rad of the contact oscillation between two samples: from a contact of three sample intervals to one of a quarter.
CONTACT_PHASES = (1.0, 4.0, 12.0)
# Guessed damping of a contact, relative to critical damping.
GUESSED_DAMPING_RATIO = 0.02


def _fit_collisions(series: Recording, fit: SpringFit, noise: float | None) -> SpringFit:
    """Fit colliding surfaces.

    Return the fit where surfaces explain more than springs between the particles, else the old one.
    """
    fits = [fit]
    for graph in (_remove_pairs(fit.graph), fit.graph):  # a fit without surfaces may have joined pairs wrongly
        near = find_nearest_jolt(series, graph)
        if np.isfinite(near):
            guesses = (_add_surfaces(graph, near, phase, series) for phase in CONTACT_PHASES)
            fits += [fit_noise(fit_graph(series, guess, noise), noise) for guess in guesses]
        if any(not find_rejections(one, noise is not None) for one in fits) or not len(graph.pairs):
            break
    return min(fits, key=lambda one: (bool(find_rejections(one, noise is not None)), _comparable_chi2(one)))


def find_nearest_jolt(series: Recording, graph: SpringSystem) -> float:
    """Find the least distance at which two unconnected particles reversed at a jolt; infinite without one."""
    joined = {frozenset(pair) for pair in graph.pairs.tolist()}
    least = MIN_RELATIVE_NOISE * measure_scales(series).length
    near = [
        _find_least_at_jolt(series.positions[:, i] - series.positions[:, j], least)
        for i, j in combinations(range(series.positions.shape[1]), 2)
        if frozenset((i, j)) not in joined and not (graph.fixed[i] and graph.fixed[j])
    ]
    return min(near, default=np.inf)


def _find_least_at_jolt(between: FloatArray, least: float) -> float:
    """Find the least distance at which two particles `between` (T, D) apart reverse within a sample or two.

    The result is infinite if their motion is never much more abrupt than usual.
    """
    apart, bend = np.linalg.norm(between, axis=1), np.linalg.norm(np.diff(between, 2, axis=0), axis=1)
    usual = max(float(np.nanmedian(bend)), least)
    turns = np.flatnonzero((apart[1:-1] <= apart[:-2]) & (apart[1:-1] <= apart[2:]))  # rows of `bend`
    jolts = [
        k
        for k in turns
        if np.nanmax(bend[max(k - JOLT_SAMPLES, 0) : k + JOLT_SAMPLES + 1], initial=0.0) > JOLT_RATIO * usual
    ]
    return float(np.min(apart[np.array(jolts) + 1])) if jolts else np.inf


def _add_surfaces(graph: SpringSystem, near: float, phase: float, series: Recording) -> SpringSystem:
    """Give the free particles surfaces that collide at a distance of `near`."""
    rate = phase / measure_scales(series).span
    return replace(
        graph, radius=np.full(len(graph.mass), near / 2), contact=np.array([rate**2, GUESSED_DAMPING_RATIO * rate])
    )


def _remove_pairs(graph: SpringSystem) -> SpringSystem:
    """Return the graph without any springs."""
    none = np.empty(0)
    fixed = tuple(np.flatnonzero(graph.fixed).tolist())
    return build_springs(np.ones(len(graph.mass)), [], none, none, none, graph.gravity, fixed)


def _comparable_chi2(fit: SpringFit) -> float:
    """Compute chi2 with the noise that the fit assumed, so that fits that estimated their noise can be compared."""
    rows = float((fit.observed.weight > 0).sum())
    return float(fit.chain.cost + 2 * rows * np.log(fit.noise)) if np.isfinite(fit.chain.cost) else np.inf
