"""Who is joined to whom, and how stiffly: hypotheses about a graph, tried at a glance, the best one fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.typing import BoolArray
from models.estimation.springs.coordinate_series import Coordinates, steadiness, units
from models.estimation.springs.fit_quality import compliance, doubts, tensions
from models.estimation.springs.spring_fit import (
    GLANCE,
    THOROUGH,
    Effort,
    SpringFit,
    covariance,
    descended,
    fit_graph,
    residuals,
)
from models.physics.springs.spring_system import Springs, springs

Pair = tuple[int, int]

GLANCED = 40
"""samples that hypotheses are tried on."""
LADDER = (1.0, 2.5, 0.4, 6.0)
"""rad that a spring swings between two samples."""
USUAL = 1.0
"""the rung from which a search goes farthest."""
STEADY = 0.25
"""relative change of the distance of two particles up to which they may be joined."""
ENOUGH = 1.5
"""chi2 per degree of freedom of a glance that needs no other."""
RIGID = (0.01, 0.05)
"""the same for rods: there are fewer or more of them."""
SAME = 0.02
"""relative difference of chi2 at which two rungs have found the same springs."""
UNSURE = 0.3
"""standard deviation of the logarithm of a stiffness from which a pair may not be joined at all."""
SLACK = 5.0
"""of the noise: a rod that moves its ends by less from one sample to the next may not be there."""
STRETCHED = 1.0
"""standard deviations of its stretching from which a rod is tried as a spring: errors of a poor fit are too large."""
LOSS = 0.02
"""of a critical damper's: what springs are guessed to have."""
START, NEAR = Effort(stages=0), Effort(stages=4, iterations=5, last=20)
"""Not yet descended; from a fit that is almost right."""
MOST_TRIED = 2
"""hypotheses that are fitted to all samples before the search gives up."""
MOST_ADDED = 6
"""pairs that are tried as the one that is missing."""
MOST_MIXED = 4
"""pairs up to which each is tried as a rod among springs, or the other way round."""
SETTLING = 4
"""rounds in which the noise is learned from residuals."""


def searched(seen: Coordinates, still: BoolArray, noise: float | None) -> SpringFit:
    """The best fit of the graphs that are plausible; it may still leave more than noise."""
    steady, missing = _pairs(seen, still, STEADY)
    rigid = {tuple(_pairs(seen, still, change)[0]) for change in RIGID}
    rods = [_guess(seen, still, list(pairs), np.inf) for pairs in sorted(rigid, key=len)]
    fit = _best(seen, rods + [_guess(seen, still, steady, swing) for swing in LADDER], noise)
    if not doubts(fit, noise is not None):
        return fit
    more = [_guess(seen, still, sorted([*steady, pair]), USUAL) for pair in missing[:MOST_ADDED]]
    edges = range(len(fit.graph.pairs)) if len(fit.graph.pairs) <= MOST_MIXED else ()
    mixed = [_with(fit.graph, e, swing, seen) for e in edges for swing in (np.inf, USUAL)]
    if not more and not mixed:
        return fit
    other = _best(seen, more + mixed, noise)
    return min((fit, other), key=lambda one: (bool(doubts(one, noise is not None)), one.chain.cost))


def _best(seen: Coordinates, graphs: list[Springs], noise: float | None) -> SpringFit:
    """The first that explains all samples, of those graphs that explain the first samples best; else the best one."""
    few = seen.first(GLANCED) if len(seen.t) > GLANCED else seen
    tried: list[SpringFit] = []
    for glance in sorted(_glances(few, graphs, noise), key=lambda fit: fit.chain.cost)[:MOST_TRIED]:
        tried.append(_pruned(seen, _whole(seen, _pruned(few, glance), noise), THOROUGH))
        if len(tried[-1].graph.rods) and doubts(tried[-1], noise is not None):
            tried.append(_stretching(seen, tried[-1], noise))
        if not doubts(tried[-1], noise is not None):
            break
    return min(tried[::-1], key=lambda fit: (bool(doubts(fit, noise is not None)), fit.chain.cost))


def _glances(few: Coordinates, graphs: list[Springs], noise: float | None) -> list[SpringFit]:
    """Fits to the first samples, up to one that explains them, or that two guesses lead to."""
    found: list[SpringFit] = []
    for graph in graphs:
        fit = fit_graph(few, graph, noise, GLANCE)
        twice = any(_same(fit, other) for other in found)
        found.append(fit)
        if twice or fit.chain.cost < ENOUGH * fit.freedom:
            break
    return found


def _same(fit: SpringFit, other: SpringFit) -> bool:
    """Whether two searches among springs ended at one place."""
    springy = len(fit.graph.pairs) > len(fit.graph.rods) == 0 and np.array_equal(fit.graph.pairs, other.graph.pairs)
    return bool(springy and abs(fit.chain.cost - other.chain.cost) < SAME * fit.chain.cost)


def _pruned(seen: Coordinates, fit: SpringFit, effort: Effort = GLANCE) -> SpringFit:
    """The fit without the pairs that explain nothing: without all of them at once, or else one after another."""
    doubtful = _doubtful(fit)
    together = _cheaper(seen, fit, doubtful, effort) if len(doubtful) > 1 else fit
    if together is not fit:
        return together
    for pair in doubtful:
        fit = _cheaper(seen, fit, [pair], effort)
    return fit


def _cheaper(seen: Coordinates, fit: SpringFit, pairs: list[list[int]], effort: Effort) -> SpringFit:
    """The fit without some pairs where they cost more numbers than they explain, or else as it is."""
    worth = float(np.log(seen.x.size)) * max(1.0, fit.chain.cost / max(fit.freedom, 1))
    less = fit_graph(seen, _without(fit.graph, pairs), fit.noise, effort, start=fit if effort is THOROUGH else None)
    pays = less.chain.cost - fit.chain.cost < worth * (len(fit.values) - len(less.values))
    return less if pays else fit


def _doubtful(glance: SpringFit) -> list[list[int]]:
    """Pairs whose stiffness is hardly known or least, or whose tension hardly moves anything between two samples."""
    graph, names = glance.graph, glance.model.layout.names
    if not np.isfinite(glance.chain.cost):
        return []
    sigma = dict(zip(names, np.sqrt(np.diag(covariance(glance)).clip(0)).tolist(), strict=True))
    least = dict(zip(names, (glance.chain.shared <= glance.model.layout.low).tolist(), strict=True))
    pull = np.sqrt((tensions(graph, glance.states) ** 2).mean(axis=0)) * glance.model.units.span**2
    slack = dict(zip(graph.rods.tolist(), (pull < SLACK * glance.noise).tolist(), strict=True))
    return [
        pair for e, pair in enumerate(graph.pairs.tolist())
        if slack.get(e, False) or least.get(name := f"stiffness {pair[0]}-{pair[1]}", False)
        or sigma.get(name, 0.0) > UNSURE
    ]  # fmt: skip


def _pairs(seen: Coordinates, still: BoolArray, change: float) -> tuple[list[Pair], list[Pair]]:
    """Pairs whose distance changes by less than `change`, in order, and the others, those that change least first."""
    pairs, _, vary = steadiness(seen)
    free = [k for k, (i, j) in enumerate(pairs) if not (still[i] and still[j])]
    return sorted(pairs[k] for k in free if vary[k] < change), [pairs[k] for k in free if vary[k] >= change]


def _whole(seen: Coordinates, glance: SpringFit, noise: float | None) -> SpringFit:
    """The fit to all samples."""
    return settled(fit_graph(seen, glance.graph, noise, start=glance), noise)


def settled(fit: SpringFit, noise: float | None) -> SpringFit:
    """The fit; where the noise is not known, the residuals tell it."""
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


def _stretching(seen: Coordinates, rigid: SpringFit, noise: float | None) -> SpringFit:
    """Springs as stiff as rods are seen to stretch, from the fit of the rods; that fit where none of them does.

    So stiff that they swing often between two samples, they are found from nowhere else: what is slow in their motion
    is seen, and their swings are damped away.
    """
    if not np.isfinite(rigid.chain.cost):
        return rigid
    give, sigma, rods = *compliance(seen, rigid), rigid.graph.rods
    stretching = rods[give > STRETCHED * sigma]
    stiffness, damping = rigid.graph.stiffness.copy(), rigid.graph.damping.copy()
    stiffness[stretching] = 1 / give[give > STRETCHED * sigma]
    damping[stretching] = LOSS * np.sqrt(stiffness[stretching])
    graph = replace(rigid.graph, stiffness=stiffness, damping=damping)
    left = float(np.sqrt(np.nanmean(residuals(rigid) ** 2)))
    return settled(descended(fit_graph(seen, graph, noise, START, start=rigid), left, NEAR), noise)


def _guess(seen: Coordinates, still: BoolArray, pairs: list[Pair], swing: float) -> Springs:
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


def _without(graph: Springs, pairs: list[list[int]]) -> Springs:
    kept = np.array([pair not in pairs for pair in graph.pairs.tolist()], bool)
    return replace(
        graph, pairs=graph.pairs[kept], stiffness=graph.stiffness[kept], damping=graph.damping[kept],
        rest=graph.rest[kept],
    )  # fmt: skip
