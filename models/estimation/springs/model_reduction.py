"""Simpler descriptions of a graph of springs that the data do not contradict.

Equal springs, gravity along an axis, a start from rest: each takes numbers out of the fit, and what is left is known
better. One is adopted where it costs less chi2 than the numbers that it saves are worth (Schwarz 1978,
doi:10.1214/aos/1176344136).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray
from models.estimation.springs.coordinate_series import Coordinates
from models.estimation.springs.dense_shooting import normal_equations, state_covariance
from models.estimation.springs.spring_fit import (
    Effort,
    SpringFit,
    covariance,
    descended,
    fit_graph,
    from_rest,
    from_slack,
)

KINDS = ("mass", "stiffness", "damping", "rest")
REST_AT_START = "starts from rest"
SLACK_AT_START = "starts unstretched"
AGAIN = Effort(stages=2, iterations=6, last=15)
"""from a fit that is almost right."""
LOOSENED = 3.0
"""of the noise: ties from which a simplified graph settles again."""


@dataclass(frozen=True, slots=True)
class Simplification:
    """Numbers that are equal, or zero."""

    name: str
    """In words."""
    about: tuple[str, ...]
    """coordinates that it speaks of; none for a start from rest."""
    price: float
    """chi2 that it costs."""
    saves: int
    """numbers that need not be fitted any more."""


def simplified(seen: Coordinates, fit: SpringFit) -> tuple[SpringFit, tuple[str, ...]]:
    """The fit with all simplifications that pay, and their names."""
    worth = float(np.log((fit.seen.weight > 0).sum()))
    adopted = [one for one in candidates(fit) if one.price < worth * one.saves]
    while adopted:
        simpler = _refitted(seen, fit, adopted)
        if simpler.chain.cost - fit.chain.cost < worth * sum(one.saves for one in adopted):
            return simpler, tuple(one.name for one in adopted)
        adopted.remove(max(adopted, key=lambda one: one.price / one.saves))
    return fit, ()


def candidates(fit: SpringFit) -> list[Simplification]:
    """What could be simpler, each with the chi2 that it costs alone (Wald)."""
    names, spread = fit.model.layout.names, covariance(fit)
    found = [
        Simplification(f"equal {kind}", tuple(alike), *_price_of_equality(fit, alike, kind, spread))
        for kind in KINDS
        if (alike := [name for name in names if name.startswith(kind + " ")]) and (len(alike) > 1 or kind == "mass")
    ]
    for name in names:
        if name.startswith("gravity"):
            k = names.index(name)
            price = float(fit.chain.shared[k] ** 2 / spread[k, k])
            found.append(Simplification(f"no {name}", (name,), price, 1))
    half = fit.model.free.size // 2
    v, around = fit.chain.states[0, half:], state_covariance(normal_equations(fit.seen, fit.chain), spread)
    found.append(Simplification(REST_AT_START, (), *_wald(v, around[half:, half:])))
    if len(fit.graph.pairs) > len(fit.graph.rods):
        found.append(Simplification(SLACK_AT_START, (), *_price_of_slack(fit, spread, around)))
    return found


def _price_of_slack(fit: SpringFit, spread: FloatArray, around: FloatArray) -> tuple[float, int]:
    """Of springs that have their rest lengths at the first sample; errors of lengths and places taken as independent,
    which the fit that follows corrects."""
    slack = replace(fit.model, slack=True, bond=1.0).predict(fit.chain.states, fit.chain.shared)
    rows = slice(2 * len(fit.graph.rods), None)
    by_state, by_shared = slack.bonds_by_state[0, rows], slack.bonds_by_shared[0, rows]
    return _wald(slack.bonds[0, rows], by_state @ around @ by_state.T + by_shared @ spread @ by_shared.T)


def _price_of_equality(fit: SpringFit, names: list[str], kind: str, spread: FloatArray) -> tuple[float, int]:
    where = [fit.model.layout.names.index(name) for name in names]
    values, around = fit.chain.shared[where], spread[np.ix_(where, where)]
    if kind == "mass":  # the first one is the unit
        return _wald(values, around)
    contrast = np.eye(len(where))[1:] - np.eye(len(where))[0]
    return _wald(contrast @ values, contrast @ around @ contrast.T)


def _wald(off: FloatArray, spread: FloatArray) -> tuple[float, int]:
    """chi2 of numbers being zero, and how many of them were free."""
    scale = np.sqrt(np.diag(spread).clip(1e-300))
    values, vectors = np.linalg.eigh(spread / scale / scale[:, None])
    free = values > 1e-8 * values.max()
    return float((((off / scale) @ vectors[:, free]) ** 2 / values[free]).sum()), int(free.sum())


def _refitted(seen: Coordinates, fit: SpringFit, adopted: list[Simplification]) -> SpringFit:
    sought, graph = fit.model.layout, fit.graph
    for one in adopted:
        if not one.about:
            continue
        if one.about[0].startswith("gravity"):
            axis = "xyz".index(one.about[0][-1])
            graph = replace(graph, gravity=np.where(np.arange(len(graph.gravity)) == axis, 0.0, graph.gravity))
            sought = sought.without(set(one.about))
        elif one.about[0].startswith("mass"):
            graph = replace(graph, mass=np.ones_like(graph.mass))
            sought = sought.without(set(one.about))
        else:
            sought = sought.alike(list(one.about), one.about[0].split()[0])
    simpler = fit_graph(seen, graph, fit.noise, Effort(stages=0), sought, fit)
    names = [one.name for one in adopted]
    simpler = from_rest(simpler) if REST_AT_START in names else simpler
    simpler = from_slack(simpler) if SLACK_AT_START in names else simpler
    return descended(simpler, LOOSENED * fit.noise, AGAIN)
