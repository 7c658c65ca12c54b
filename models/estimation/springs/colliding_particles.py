"""Fit of particles that repel each other on contact: the radius of their surfaces, from coordinates alone.

Chen 2022 models collisions as stiff springs between surfaces (section 2.2). Distances that reverse at a jolt show which
particles collide. A contact is shorter than the sample interval, so its stiffness is poorly identified and correlated
with the radius: several stiffnesses are tried, and the errors of the fit express how well either is known.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.springs.coordinate_series import MIN_RELATIVE_NOISE, measure_scales
from models.estimation.springs.fit_quality import find_rejections
from models.estimation.springs.graph_search import fit_noise
from models.estimation.springs.spring_fit import SpringFit, fit_graph
from models.physics.springs.spring_system import SpringSystem, build_springs

JOLT_RATIO = 8.0
"""Second difference of a distance vector, over its usual value, that indicates a push."""
JOLT_SAMPLES = 1
"""Samples around the nearest one within which the jolt is."""
CONTACT_PHASES = (1.0, 4.0, 12.0)
"""rad of the contact oscillation between two samples: from a contact of three sample intervals to one of a quarter."""
GUESSED_DAMPING_RATIO = 0.02
"""Guessed damping of a contact, relative to critical damping."""


def fit_collisions(series: Recording, fit: SpringFit, noise: float | None) -> SpringFit:
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
