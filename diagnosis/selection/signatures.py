"""Signatures: how an effect would show in these data after everything that a simulator adjusts has been adjusted.

A refit hides most of a missing effect: start states and the simulator's parameters absorb it. The derivative by a
parameter with those projected out is its signature. It gives the score test (Rao 1948,
doi:10.1017/S0305004100023987), the smallest detectable strength and, by correlations, which effects these data cannot
separate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, ShotInformation
from models.core.typing import BoolArray, FloatArray
from models.numerics.least_squares import invert_semidefinite, solve_damped

# Correlation from which two effects cannot be separated.
INSEPARABLE_CORRELATION = 0.9
# Standard deviations from which a single parameter is detected.
DETECTION_SIGMAS = 3.0
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Signatures:
    """Information and score of all P parameters, free ones projected out; their rows and columns are 0."""

    information: FloatArray
    """(P, P) information of the data, without priors."""
    score: FloatArray
    """(P,)"""
    raw: FloatArray
    """(P,) information on each parameter before the free ones were projected out."""
    prior: FloatArray
    """(P,) 1/sigma^2 of the priors."""

    def gain(self, mask: BoolArray) -> float:
        """Return the chi2 gain of freeing the parameters in `mask`, to first order."""
        return float(self.score[mask] @ self.step(mask))

    def step(self, mask: BoolArray) -> FloatArray:
        """Return the step of the parameters in `mask` when they are freed."""
        here = self.information[np.ix_(mask, mask)] + np.diag(self.prior[mask])
        return solve_damped(here, self.score[mask], 0.0)

    def detectable_strengths(self, effect: BoolArray) -> FloatArray:
        """Return the smallest detectable strength (P,) of each parameter of an effect; infinite where there is none."""
        strengths = np.full(len(self.score), np.inf)
        identifiable = np.flatnonzero(effect & (np.diag(self.information) > 1e-6 * self.raw))
        if len(identifiable):
            inverse = invert_semidefinite(self.information[np.ix_(identifiable, identifiable)])
            strengths[identifiable] = DETECTION_SIGMAS * np.sqrt(np.diag(inverse))
        return strengths


def compute_signatures(
    problem: DiagnosisProblem, shot_information: ShotInformation, free: BoolArray, variance_factor: float = 1.0
) -> Signatures:
    """Compute the signatures of all parameters.

    Args:
        problem: Scene and priors.
        shot_information: Information of each shot.
        free: (P,) mask of the parameters that are projected out.
        variance_factor: Factor by which the variance of the data exceeds that of the noise.

    Returns:
        The signatures.
    """
    prior = np.array([1 / one.sigma**2 for one in problem.priors])
    information, score = (
        shot_information.information.sum(axis=0) / variance_factor,
        shot_information.score.sum(axis=0) / variance_factor,
    )
    raw = np.diag(information).copy()
    absorbed = absorb_by_free(problem, information, free, np.column_stack([information[free], score[free]]))
    left = information - absorbed[:, :-1]
    left[free] = left[:, free] = 0.0
    return Signatures((left + left.T) / 2, np.where(free, 0.0, score - absorbed[:, -1]), raw, prior)


def absorb_by_free(
    problem: DiagnosisProblem, information: FloatArray, free: BoolArray, gradients: FloatArray
) -> FloatArray:
    """Return the part of gradients by all parameters that the free ones absorb, within their priors.

    Args:
        problem: Scene and priors.
        information: (P, P) information of the data.
        free: (P,) mask of F free parameters.
        gradients: (F, K) gradients by the free parameters.

    Returns:
        (P, K) gradients by all parameters.
    """
    prior = np.array([1 / one.sigma**2 for one in problem.priors])
    inside = information[np.ix_(free, free)] + np.diag(prior[free])
    return np.asarray(information[free].T @ solve_damped(inside, gradients, 0.0))


def whitening_directions(effect_signatures: Signatures, mask: BoolArray) -> FloatArray:
    """Return directions (p, q) of an effect's parameters with orthonormal signatures."""
    here = effect_signatures.information[np.ix_(mask, mask)]
    scale = 1 / np.sqrt(np.maximum(effect_signatures.raw[mask], _TINY))
    sizes, axes = np.linalg.eigh(here * scale * scale[:, None])
    significant = sizes > 1e-8
    return np.asarray(scale[:, None] * axes[:, significant] / np.sqrt(sizes[significant]))


def direction_correlation(effect_signatures: Signatures, one: BoolArray, other: BoolArray) -> float:
    """Return the correlation of the step that the data require of one effect with the best step of another.

    Args:
        effect_signatures: Signatures with everything else projected out.
        one: (P,) mask of the parameters of the first effect.
        other: (P,) mask of the parameters of the second effect.

    Returns:
        Correlation between 0 and 1.
    """
    step = effect_signatures.step(one)
    size = float(step @ effect_signatures.information[np.ix_(one, one)] @ step)
    b = whitening_directions(effect_signatures, other)
    if size <= 0 or b.size == 0:
        return 0.0
    across = float(np.linalg.norm(b.T @ effect_signatures.information[np.ix_(other, one)] @ step))
    return min(across / float(np.sqrt(size)), 1.0)
