"""Who is joined to whom, and how stiffly: hypotheses about a graph, tried at a glance, the best one fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.coordinates import Bools, Coordinates, steadiness, units
from models.spring_fit import GLANCE, SpringFit, descended, fit_graph
from models.spring_verdict import doubts
from models.springs import Springs, springs

Floats = NDArray[np.float64]
Pair = tuple[int, int]

GLANCED = 40
"""samples that hypotheses are tried on."""
LADDER = (np.inf, 1.0, 2.5, 0.4, 6.0, 15.0)
"""rad that a spring swings between two samples; infinite for a rod."""
STEADY = 0.25
"""relative change of the distance of two particles up to which they may be joined."""
ENOUGH = 1.5
"""chi2 per degree of freedom of a glance that needs no other."""
MOST_TRIED = 3
"""hypotheses that are fitted to all samples before the search gives up."""
MOST_ADDED = 10
"""pairs that are tried as the one that is missing."""
SETTLING = 4
"""rounds in which the noise is learned from residuals."""


def searched(seen: Coordinates, still: Bools, noise: float | None) -> SpringFit:
    """The best fit of the graphs that are plausible; it may still leave more than noise."""
    steady, missing = _pairs(seen, still)
    fit = _best(seen, [_guess(seen, still, steady, swing) for swing in LADDER], noise)
    if not doubts(fit, noise is not None):
        return fit
    more = [_guess(seen, still, [*steady, pair], swing) for pair in missing[:MOST_ADDED] for swing in LADDER]
    mixed = [_with(fit.graph, e, swing, seen) for e in range(len(fit.graph.pairs)) for swing in LADDER]
    if not more and not mixed:
        return fit
    other = _best(seen, more + mixed, noise)
    return min((fit, other), key=lambda one: (bool(doubts(one, noise is not None)), one.chain.cost))


def _best(seen: Coordinates, graphs: list[Springs], noise: float | None) -> SpringFit:
    """The first that explains all samples, of those graphs that explain the first samples best; else the best one."""
    few = seen.first(GLANCED) if len(seen.t) > GLANCED else seen
    tried: list[SpringFit] = []
    for glance in sorted(_glances(few, graphs, noise), key=lambda fit: fit.chain.cost)[:MOST_TRIED]:
        tried.append(_fitted(seen, _pruned(few, glance), noise))
        if not doubts(tried[-1], noise is not None):
            break
    return min(tried[::-1], key=lambda fit: (bool(doubts(fit, noise is not None)), fit.chain.cost))


def _glances(few: Coordinates, graphs: list[Springs], noise: float | None) -> list[SpringFit]:
    """Fits to the first samples, up to one that explains them."""
    found = []
    for graph in graphs:
        found.append(fit_graph(few, graph, noise, GLANCE))
        if found[-1].chain.cost < ENOUGH * found[-1].freedom:
            break
    return found


def _pruned(few: Coordinates, glance: SpringFit) -> SpringFit:
    """The glance without the pairs that explain nothing."""
    worth = float(np.log(few.x.size)) * max(1.0, glance.chain.cost / max(glance.freedom, 1))
    for pair in glance.graph.pairs.tolist():
        less = fit_graph(few, _without(glance.graph, pair), glance.noise, GLANCE)
        if less.chain.cost - glance.chain.cost < worth * (len(glance.values) - len(less.values)):
            glance = less
    return glance


def _pairs(seen: Coordinates, still: Bools) -> tuple[list[Pair], list[Pair]]:
    """Pairs that keep their distance, and the others, in the order of how well they do."""
    pairs, _, vary = steadiness(seen)
    free = [k for k, (i, j) in enumerate(pairs) if not (still[i] and still[j])]
    return [pairs[k] for k in free if vary[k] < STEADY], [pairs[k] for k in free if vary[k] >= STEADY]


def _fitted(seen: Coordinates, glance: SpringFit, noise: float | None) -> SpringFit:
    """The fit to all samples; where the noise is not known, the residuals tell it."""
    fit = fit_graph(seen, glance.graph, noise, start=glance)
    for _ in range(SETTLING if noise is None else 0):
        ratio = float(np.sqrt(fit.chain.cost / max(fit.freedom, 1)))
        if not np.isfinite(ratio) or abs(np.log(max(ratio, 1e-12))) < 0.05:
            break
        fit = _rescaled(fit, max(ratio, 1e-3))
    return fit


def _rescaled(fit: SpringFit, ratio: float) -> SpringFit:
    """The fit with another idea of the noise."""
    weights = replace(fit.seen, weight=fit.seen.weight / ratio, shared_weight=fit.seen.shared_weight / ratio)
    return descended(replace(fit, seen=weights, noise=fit.noise * ratio), fit.model.bond)


def _guess(seen: Coordinates, still: Bools, pairs: list[Pair], swing: float) -> Springs:
    """A graph to begin with: `swing` rad between two samples, distances as they are."""
    every, distance, _ = steadiness(seen)
    far = dict(zip(every, distance.tolist(), strict=True))
    count, axes = seen.x.shape[1:]
    return springs(
        np.ones(count), pairs, (swing / units(seen).span) ** 2, _damping(swing, seen),
        np.array([far[pair] for pair in pairs]), np.zeros(axes), tuple(np.flatnonzero(still).tolist()),
    )  # fmt: skip


def _damping(swing: float, seen: Coordinates) -> float:
    """Of a spring that loses little in one swing; of a rod, none."""
    return 0.02 * swing / units(seen).span if np.isfinite(swing) else 0.0


def _with(graph: Springs, edge: int, swing: float, seen: Coordinates) -> Springs:
    """The graph with another stiffness of one pair."""
    here = np.arange(len(graph.pairs)) == edge
    return replace(
        graph, stiffness=np.where(here, (swing / units(seen).span) ** 2, graph.stiffness),
        damping=np.where(here, _damping(swing, seen), graph.damping),
    )  # fmt: skip


def _without(graph: Springs, pair: list[int]) -> Springs:
    kept = ~(graph.pairs == pair).all(axis=1)
    return replace(
        graph, pairs=graph.pairs[kept], stiffness=graph.stiffness[kept], damping=graph.damping[kept],
        rest=graph.rest[kept],
    )  # fmt: skip
