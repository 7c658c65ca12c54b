"""What a fit leaves, and noise that has gone through the same fit: the yardstick for all that looks systematic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.fitting.hypothesis_fits import Fitted, Question, Seen
from diagnosis.fitting.noise_whitening import chain
from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import Covariates, Recording
from models.estimation.multiple_shooting.normal_equations import huber, sloped

DRAWS = 300
"""how often the noise is drawn anew."""
_UNSURE = 0.06
"""standard deviation of an estimated correlation of the noise."""
_MOST = 0.97


@dataclass(frozen=True, slots=True)
class Residuals:
    """Of all windows of a fit: K observations with D coordinates each, white where the model is right."""

    left: FloatArray
    """(K, D) seen minus predicted, in standard deviations, outliers bounded, divided by their own overall size."""
    drawn: FloatArray
    """(K, D, DRAWS) noise of size 1 that went through the same fit."""
    window: IntArray
    """(K,)"""
    shot: IntArray
    """(K,)"""
    body: IntArray
    """(K,)"""
    frame: IntArray
    """(K,)"""
    t: FloatArray
    """(K,) s since the beginning of its window."""
    phase: NDArray[np.str_]
    """(K,)"""
    place: FloatArray
    """(K, D)"""
    velocity: FloatArray
    """(K, D)"""
    since_contact: FloatArray
    """(K,) s; NaN where there was none."""
    image: FloatArray | None
    """(K, 2)"""
    size: float
    """overall size of what is left, 1 where the noise explains it."""

    @property
    def speed(self) -> FloatArray:
        return np.asarray(np.linalg.norm(self.velocity, axis=1))


def residuals(question: Question, fitted: Fitted, seen: Seen, rng: np.random.Generator) -> Residuals:
    """Residuals of a fit, with noise drawn and projected through it; what has no observation is left out."""
    weights = [np.sqrt(huber(flow.misfit)[0]) for flow in seen.point.flows]
    left = [-flow.misfit * weight[:, None] for flow, weight in zip(seen.point.flows, weights, strict=True)]
    noise = [_noise(question.correlation, piece, rng) for piece in fitted.pieces]
    # what is left goes through once more, as noise does: a search stops a little before its end
    both = [np.concatenate([a[..., None], b], axis=2) for a, b in zip(left, noise, strict=True)]
    through = _projected(seen, fitted, weights, both)
    # once more the weight: one outlier must not stand for a group
    left = [one[..., 0] * weight[:, None] for one, weight in zip(through, weights, strict=True)]
    through = [one[..., 1:] for one in through]
    expected = sum(float(np.square(one).sum()) for one in through) / DRAWS
    size = float(np.sqrt(sum(float(np.square(one).sum()) for one in left) / max(expected, 1e-12)))
    covariates = [
        question.scene.covariates(piece, start, fitted.shared, fitted.forms)
        for piece, start in zip(fitted.pieces, fitted.starts, strict=True)
    ]
    where = [np.nonzero(piece.seen) for piece in fitted.pieces]
    return Residuals(
        left=np.concatenate(left) / size,
        drawn=np.concatenate(through),
        window=np.concatenate([np.full(len(rows), k) for k, (rows, _) in enumerate(where)]),
        shot=np.concatenate([np.full(len(r), piece.shot) for piece, (r, _) in zip(fitted.pieces, where, strict=True)]),
        body=np.concatenate([bodies for _, bodies in where]),
        frame=np.concatenate([piece.frame[rows] for piece, (rows, _) in zip(fitted.pieces, where, strict=True)]),
        t=np.concatenate([piece.t[rows] - piece.t[0] for piece, (rows, _) in zip(fitted.pieces, where, strict=True)]),
        phase=np.array([phase for one in covariates for phase in one.phase]),
        place=np.concatenate([one.place for one in covariates]),
        velocity=np.concatenate([one.velocity for one in covariates]),
        since_contact=np.concatenate([one.since_contact for one in covariates]),
        image=_pictured(covariates),
        size=size,
    )


def _pictured(covariates: list[Covariates]) -> FloatArray | None:
    """(K, 2) px from the middle of the picture, where every window has one."""
    found = [one.image for one in covariates if one.image is not None]
    return np.concatenate(found) if found and len(found) == len(covariates) else None


def _noise(correlation: float, piece: Recording, rng: np.random.Generator) -> FloatArray:
    """(K, D, DRAWS) as the fit sees noise: white, or nearly so where its correlation is itself an estimate."""
    count, coordinates = int(piece.seen.sum()), piece.places.shape[2]
    fresh = rng.standard_normal((count, coordinates, DRAWS))
    if correlation == 0:
        return fresh
    own = chain(piece, 1.0)
    rows, _ = np.nonzero(piece.seen)
    steps = rows - rows[own.before]
    true = np.clip(correlation + _UNSURE * rng.standard_normal(DRAWS), 0.0, _MOST)
    for k in np.flatnonzero(own.told):
        told = true ** steps[k]
        fresh[k] = told * fresh[own.before[k]] + np.sqrt(1 - told**2) * fresh[k]
    return chain(piece, correlation).whitened(fresh)


def _projected(seen: Seen, fitted: Fitted, weights: list[FloatArray], noise: list[FloatArray]) -> list[FloatArray]:
    """What states and free parameters leave of noise, to first order; priors and links are not counted as knowledge."""
    left, by_shared = [], []
    for k, (weight, drawn) in enumerate(zip(weights, noise, strict=True)):
        flow = sloped(seen.point, k)
        states = (flow.by_start * weight[:, None, None]).reshape(-1, flow.by_start.shape[2])
        free = (flow.by_shared[..., fitted.free] * weight[:, None, None]).reshape(len(states), -1)
        basis = _basis(states)
        values = drawn.reshape(len(states), -1)
        left.append(values - basis @ (basis.T @ values))
        by_shared.append(free - basis @ (basis.T @ free))
    shared = _basis(np.concatenate(by_shared))
    values = np.concatenate(left)
    values = values - shared @ (shared.T @ values)
    ends = np.cumsum([len(one) for one in left])[:-1]
    return [part.reshape(drawn.shape) for part, drawn in zip(np.split(values, ends), noise, strict=True)]


def _basis(columns: FloatArray) -> FloatArray:
    """Orthonormal directions that columns (R, m) span."""
    if columns.shape[1] == 0:
        return columns
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, sizes > 1e-9 * max(float(sizes[0]), 1e-300)]) if len(sizes) else scaled
