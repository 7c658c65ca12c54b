"""Particles that push each other away where they meet: the radius of their surfaces, from coordinates alone.

Chen 2022 moves collisions as stiff springs between surfaces (section 2.2). Who collides is told by distances that
turn round at a jolt. Between two samples such a push is over, so that how stiff it was is told badly and the
radius hangs on it: several stiffnesses are tried, and the errors of the fit say how well either is known.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from models.core.typing import FloatArray
from models.estimation.springs.coordinate_series import EXACT, Coordinates, units
from models.estimation.springs.fit_quality import doubts
from models.estimation.springs.graph_search import settled
from models.estimation.springs.spring_fit import SpringFit, fit_graph
from models.physics.springs.spring_system import Springs, springs

JOLT = 8.0
"""times what the way from one particle to another usually bends from sample to sample: then something pushed."""
BESIDE = 1
"""samples from the nearest one within which the jolt is."""
SWINGS = (1.0, 4.0, 12.0)
"""rad that a push would swing between two samples: from one that lasts three of them to one that lasts a quarter."""
LOSS = 0.02
"""of a critical damper's: what pushes are guessed to have."""


def colliding(seen: Coordinates, fit: SpringFit, noise: float | None) -> SpringFit:
    """The fit with surfaces, where these explain more than pairs that are joined did; else as it was."""
    found = [fit]
    for graph in (_unjoined(fit.graph), fit.graph):  # pairs that a fit without surfaces joined may be none
        near = nearest_jolt(seen, graph)
        if np.isfinite(near):
            guesses = (_surfaces(graph, near, swing, seen) for swing in SWINGS)
            found += [settled(fit_graph(seen, guess, noise), noise) for guess in guesses]
        if any(not doubts(one, noise is not None) for one in found) or not len(graph.pairs):
            break
    return min(found, key=lambda one: (bool(doubts(one, noise is not None)), _misfit(one)))


def nearest_jolt(seen: Coordinates, graph: Springs) -> float:
    """The least distance at which two particles that nothing joins turned round at a jolt; infinite if none did."""
    joined = {frozenset(pair) for pair in graph.pairs.tolist()}
    least = EXACT * units(seen).length
    near = [
        _least_at_jolt(seen.x[:, i] - seen.x[:, j], least)
        for i, j in combinations(range(seen.x.shape[1]), 2)
        if frozenset((i, j)) not in joined and not (graph.held[i] and graph.held[j])
    ]
    return min(near, default=np.inf)


def _least_at_jolt(between: FloatArray, least: float) -> float:
    """The least distance at which two particles `between` (T, D) apart turn round within a sample or two, where they
    else go on as they were; infinite where they never do."""
    apart, bend = np.linalg.norm(between, axis=1), np.linalg.norm(np.diff(between, 2, axis=0), axis=1)
    usual = max(float(np.nanmedian(bend)), least)
    turns = np.flatnonzero((apart[1:-1] <= apart[:-2]) & (apart[1:-1] <= apart[2:]))  # rows of `bend`
    jolts = [k for k in turns if np.nanmax(bend[max(k - BESIDE, 0) : k + BESIDE + 1], initial=0.0) > JOLT * usual]
    return float(np.min(apart[np.array(jolts) + 1])) if jolts else np.inf


def _surfaces(graph: Springs, near: float, swing: float, seen: Coordinates) -> Springs:
    """The graph whose free particles collide at a distance of `near`."""
    rate = swing / units(seen).span
    return replace(graph, radius=np.full(len(graph.mass), near / 2), contact=np.array([rate**2, LOSS * rate]))


def _unjoined(graph: Springs) -> Springs:
    none = np.empty(0)
    held = tuple(np.flatnonzero(graph.held).tolist())
    return springs(np.ones(len(graph.mass)), [], none, none, none, graph.gravity, held)


def _misfit(fit: SpringFit) -> float:
    """chi2 with the noise that the fit itself took, so that fits that learnt it can be compared."""
    rows = float((fit.seen.weight > 0).sum())
    return float(fit.chain.cost + 2 * rows * np.log(fit.noise)) if np.isfinite(fit.chain.cost) else np.inf
