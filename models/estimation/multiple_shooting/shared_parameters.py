"""Search coordinates of the shared parameters: logarithms of parameters whose prior is relative."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.physics.effect import Prior


def search_coordinate(prior: Prior, value: float) -> float:
    """Convert a value of one parameter into its search coordinate."""
    return float(np.log(value)) if prior.relative else value


def search_coordinates(unknowns: tuple[Prior, ...], shared: FloatArray) -> FloatArray:
    """Convert parameter values (P,) into search coordinates (P,)."""
    return np.array([search_coordinate(prior, value) for prior, value in zip(unknowns, shared, strict=True)])


def values_from_coordinates(unknowns: tuple[Prior, ...], coordinates: FloatArray) -> FloatArray:
    """Convert search coordinates (P,) into parameter values (P,)."""
    return np.array([np.exp(q) if prior.relative else q for q, prior in zip(coordinates, unknowns, strict=True)])


def value_derivatives(unknowns: tuple[Prior, ...], shared: FloatArray) -> FloatArray:
    """Compute d value / d coordinate (P,) at the values `shared` (P,)."""
    return np.array([value if prior.relative else 1.0 for value, prior in zip(shared, unknowns, strict=True)])


def coordinate_bounds(unknowns: tuple[Prior, ...], shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the coordinates (P,) of `shared` and of the lower and upper bounds."""
    low = np.array([search_coordinate(prior, prior.bounds[0]) for prior in unknowns])
    high = np.array([search_coordinate(prior, prior.bounds[1]) for prior in unknowns])
    return search_coordinates(unknowns, shared), low, high


def prior_terms(unknowns: tuple[Prior, ...], shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute 1/sigma, information and gradient (P,) of the priors, in search coordinates."""
    scale = np.array([1 / prior.sigma for prior in unknowns])
    middle = np.array([search_coordinate(prior, prior.value) for prior in unknowns])
    return scale, scale**2, scale**2 * (search_coordinates(unknowns, shared) - middle)


def prior_cost(unknowns: tuple[Prior, ...], shared: FloatArray) -> float:
    """Compute chi2 of the values (P,) with respect to their priors."""
    scale, _, gradient = prior_terms(unknowns, shared)
    return float(np.square(gradient / scale).sum())
