"""Numbers that all windows of a fit share, as coordinates of a search: logarithms where their priors are relative."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.physics.effect import Prior


def coordinate(prior: Prior, value: float) -> float:
    """Where the search puts a value."""
    return float(np.log(value)) if prior.relative else value


def coordinates(unknowns: tuple[Prior, ...], shared: FloatArray) -> FloatArray:
    """Where the search puts the values (P,)."""
    return np.array([coordinate(prior, value) for prior, value in zip(unknowns, shared, strict=True)])


def values_of(unknowns: tuple[Prior, ...], coordinates: FloatArray) -> FloatArray:
    """Values (P,) of coordinates (P,)."""
    return np.array([np.exp(q) if prior.relative else q for q, prior in zip(coordinates, unknowns, strict=True)])


def slopes(unknowns: tuple[Prior, ...], shared: FloatArray) -> FloatArray:
    """d value / d coordinate (P,)."""
    return np.array([value if prior.relative else 1.0 for value, prior in zip(shared, unknowns, strict=True)])


def bounds(unknowns: tuple[Prior, ...], shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coordinates (P,) of the values `shared`, and of the least and the largest that are allowed."""
    low = np.array([coordinate(prior, prior.bounds[0]) for prior in unknowns])
    high = np.array([coordinate(prior, prior.bounds[1]) for prior in unknowns])
    return coordinates(unknowns, shared), low, high


def prior_knowledge(unknowns: tuple[Prior, ...], shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """1/sigma, information and gradient (P,) of the priors, in coordinates."""
    scale = np.array([1 / prior.sigma for prior in unknowns])
    middle = np.array([coordinate(prior, prior.value) for prior in unknowns])
    return scale, scale**2, scale**2 * (coordinates(unknowns, shared) - middle)


def prior_cost(unknowns: tuple[Prior, ...], shared: FloatArray) -> float:
    """chi2 of the values (P,) against their priors."""
    scale, _, gradient = prior_knowledge(unknowns, shared)
    return float(np.square(gradient / scale).sum())
