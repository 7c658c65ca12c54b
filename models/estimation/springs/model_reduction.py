"""Simplifications of a graph of springs that the data do not contradict.

Equal springs, gravity along an axis, a start from rest: each removes parameters from the fit, and the others become
more certain. One is adopted where its increase of chi2 is less than the removed parameters are worth (Schwarz 1978,
doi:10.1214/aos/1176344136).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.springs.dense_shooting import build_normal_equations, state_covariance
from models.estimation.springs.spring_fit import (
    SearchEffort,
    SpringFit,
    assume_resting_start,
    assume_unstretched_start,
    covariance_of_shared,
    fit_graph,
    tighten_links,
)

PARAMETER_KINDS = ("mass", "stiffness", "damping", "rest")
REST_AT_START = "starts from rest"
SLACK_AT_START = "starts unstretched"
REFIT = SearchEffort(stages=2, iterations=6, last_iterations=15)
"""Search effort from a fit that is almost right."""
REFIT_LINK_SIGMA = 3.0
"""Link sigma, over the noise, from which a simplified graph is refitted."""


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
