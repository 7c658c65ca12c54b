"""What an effect would look like in these data once everything that a simulator can adjust has been adjusted.

A refit hides most of what a missing effect does: states and the parameters that the simulator has take it up. What is
left of the derivative by a parameter, those projected out, is its signature: it gives the score test (Rao 1948), the
smallest strength that could have been seen, and by canonical correlations (Hotelling 1936,
doi:10.1093/biomet/28.3-4.321) which effects these data cannot tell apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.fitting.hypothesis_fits import Question, Told
from models.core.typing import BoolArray, FloatArray

TWINS = 0.9
"""canonical correlation from which two effects cannot be told apart."""
DETECTABLE = 3.0
"""standard deviations from which a single parameter is seen."""
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Signatures:
    """Information and score of all P parameters, those that are free projected out; 0 in their rows and columns."""

    information: FloatArray
    """(P, P), without what is known beforehand."""
    score: FloatArray
    """(P,)"""
    raw: FloatArray
    """(P,) information of each parameter before the free ones were projected out."""
    prior: FloatArray
    """(P,) 1/sigma^2 of what is known beforehand."""

    def gain(self, mask: BoolArray) -> float:
        """chi2 that freeing these parameters gains, to first order."""
        return float(self.score[mask] @ self.step(mask))

    def step(self, mask: BoolArray) -> FloatArray:
        """How far these parameters then move."""
        here = self.information[np.ix_(mask, mask)] + np.diag(self.prior[mask])
        return np.asarray(np.linalg.solve(here, self.score[mask]))

    def surviving(self) -> FloatArray:
        """(P,) share of each signature, as an amplitude, that the free parameters cannot mimic."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.information), 0, None) / np.maximum(self.raw, _TINY)))

    def detectable(self, effect: BoolArray) -> FloatArray:
        """(P,) smallest strength of each parameter of an effect that the data could show; infinite where none."""
        found = np.full(len(self.score), np.inf)
        known = np.flatnonzero(effect & (np.diag(self.information) > 1e-6 * self.raw))
        if len(known):
            inverse = np.linalg.pinv(self.information[np.ix_(known, known)], hermitian=True)
            found[known] = DETECTABLE * np.sqrt(np.diag(inverse))
        return found


def signatures(question: Question, told: Told, free: BoolArray, lack: float = 1.0) -> Signatures:
    """From what shots tell, all their variances larger by the factor `lack`."""
    prior = np.array([1 / known.sigma**2 for known in question.priors])
    information, score = told.information.sum(axis=0) / lack, told.score.sum(axis=0) / lack
    raw = np.diag(information).copy()
    inside = information[np.ix_(free, free)] + np.diag(prior[free])
    across = information[free]
    taken = (
        np.linalg.solve(inside, np.column_stack([across, score[free]])) if free.any() else np.zeros((0, len(raw) + 1))
    )
    left = information - across.T @ taken[:, :-1]
    left[free] = left[:, free] = 0.0
    return Signatures((left + left.T) / 2, np.where(free, 0.0, score - across.T @ taken[:, -1]), raw, prior)


def canonical_correlation(found: Signatures, one: BoolArray, other: BoolArray) -> float:
    """The largest correlation of any strength of one effect with any of another, as signatures in these data."""
    a, b = _whitener(found, one), _whitener(found, other)
    if a.size == 0 or b.size == 0:
        return 0.0
    across = a.T @ found.information[np.ix_(one, other)] @ b
    return min(float(np.linalg.norm(across, ord=2)), 1.0)


def _whitener(found: Signatures, mask: BoolArray) -> FloatArray:
    """(p, q) directions of an effect's parameters with signatures of size 1, those without any left out."""
    here = found.information[np.ix_(mask, mask)]
    scale = 1 / np.sqrt(np.maximum(found.raw[mask], _TINY))
    sizes, axes = np.linalg.eigh(here * scale * scale[:, None])
    kept = sizes > 1e-8
    return np.asarray(scale[:, None] * axes[:, kept] / np.sqrt(sizes[kept]))


def explained_direction(found: Signatures, one: BoolArray, other: BoolArray) -> float:
    """Correlation of the signature that the data ask of effect `one` with the best that effect `other` can offer."""
    step = found.step(one)
    size = float(step @ found.information[np.ix_(one, one)] @ step)
    b = _whitener(found, other)
    if size <= 0 or b.size == 0:
        return 0.0
    across = float(np.linalg.norm(b.T @ found.information[np.ix_(other, one)] @ step))
    return min(across / float(np.sqrt(size)), 1.0)
