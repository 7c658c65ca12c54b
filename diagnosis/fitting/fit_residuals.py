"""Residuals of a fit, and noise that was projected through the same fit: the reference for systematic deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, LinearizedFit
from diagnosis.fitting.noise_whitening import build_noise_chain
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import Covariates
from models.estimation.multiple_shooting.normal_equations import require_linearized
from models.numerics.statistics import evaluate_huber_loss

# Number of noise samples.
NOISE_DRAWS = 300
# Standard deviation of an estimated correlation of the noise.
_CORRELATION_SIGMA = 0.06
# Largest correlation that is drawn.
_MAX_CORRELATION = 0.97


@dataclass(frozen=True, slots=True)
class FitResiduals:
    """Residuals of all windows of a fit: K observations with D coordinates; white noise where the model is right."""

    values: FloatArray
    """(K, D) observed minus predicted, in standard deviations, outliers bounded, divided by `scale`."""
    noise_draws: FloatArray
    """(K, D, NOISE_DRAWS) unit noise, projected through the same fit."""
    window: IntArray
    """(K,) index of the window."""
    shot: IntArray
    """(K,) index of the shot."""
    body: IntArray
    """(K,) index of the body in its window."""
    frame: IntArray
    """(K,) frame number."""
    t: FloatArray
    """(K,) s since the start of the window."""
    phase: NDArray[np.str_]
    """(K,) phase of motion."""
    position: FloatArray
    """(K, D) in the unit of the frame of reference."""
    velocity: FloatArray
    """(K, D) in the unit of the frame of reference per s."""
    since_contact: FloatArray
    """(K,) s since the last contact; NaN where there was none."""
    image: FloatArray | None
    """(K, 2) px from the image centre; None without an image."""
    reference: ReferenceFrame
    """Frame of reference of `position` and `velocity`."""
    scale: float
    """Overall size of the residuals, 1 where noise explains them."""

    @property
    def speed(self) -> FloatArray:
        """(K,) in the unit of the frame of reference per s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))


def compute_residuals(
    problem: DiagnosisProblem, fitted: EffectFit, linearized: LinearizedFit, rng: np.random.Generator
) -> FitResiduals:
    """Compute the residuals of a fit, and noise samples projected through it.

    Args:
        problem: Scene and noise.
        fitted: The fit.
        linearized: The fit, linearised by its parameters and start states.
        rng: Random generator of the noise.

    Returns:
        Residuals of all K observations.
    """
    weights = [np.sqrt(evaluate_huber_loss(flow.residual)[0]) for flow in linearized.point.windows]
    left = [-flow.residual * weight[:, None] for flow, weight in zip(linearized.point.windows, weights, strict=True)]
    noise = [_draw_noise(problem.correlation, segment, rng) for segment in fitted.segments]
    # the residuals are projected like the noise: an iteration stops slightly before its minimum
    both = [np.concatenate([a[..., None], b], axis=2) for a, b in zip(left, noise, strict=True)]
    through = _project_out_fit(linearized, fitted, weights, both)
    # the weight once more: one outlier must not represent a group
    left = [one[..., 0] * weight[:, None] for one, weight in zip(through, weights, strict=True)]
    through = [one[..., 1:] for one in through]
    expected = sum(float(np.square(one).sum()) for one in through) / NOISE_DRAWS
    size = float(np.sqrt(sum(float(np.square(one).sum()) for one in left) / max(expected, 1e-12)))
    covariates = [
        problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms)
        for segment, start in zip(fitted.segments, fitted.starts, strict=True)
    ]
    where = [np.nonzero(segment.is_observed) for segment in fitted.segments]
    return FitResiduals(
        values=np.concatenate(left) / size,
        noise_draws=np.concatenate(through),
        window=np.concatenate([np.full(len(rows), k) for k, (rows, _) in enumerate(where)]),
        shot=np.concatenate(
            [np.full(len(r), segment.shot) for segment, (r, _) in zip(fitted.segments, where, strict=True)]
        ),
        body=np.concatenate([bodies for _, bodies in where]),
        frame=np.concatenate([segment.frame[rows] for segment, (rows, _) in zip(fitted.segments, where, strict=True)]),
        t=np.concatenate(
            [segment.t[rows] - segment.t[0] for segment, (rows, _) in zip(fitted.segments, where, strict=True)]
        ),
        phase=np.array([phase for one in covariates for phase in one.phase]),
        position=np.concatenate([one.position for one in covariates]),
        velocity=np.concatenate([one.velocity for one in covariates]),
        since_contact=np.concatenate([one.since_contact for one in covariates]),
        image=_collect_image_positions(covariates),
        reference=fitted.segments[0].reference,
        scale=size,
    )


def _collect_image_positions(covariates: list[Covariates]) -> FloatArray | None:
    """Collect px (K, 2) from the image centre; None where a window has no image."""
    images = [one.image for one in covariates if one.image is not None]
    return np.concatenate(images) if images and len(images) == len(covariates) else None


def _draw_noise(correlation: float, segment: Recording, rng: np.random.Generator) -> FloatArray:
    """Draw whitened noise (K, D, NOISE_DRAWS): white, or nearly so where its correlation is an estimate."""
    count, coordinates = int(segment.is_observed.sum()), segment.positions.shape[2]
    fresh = rng.standard_normal((count, coordinates, NOISE_DRAWS))
    if correlation == 0:
        return fresh
    own = build_noise_chain(segment, 1.0)
    rows, _ = np.nonzero(segment.is_observed)
    steps = rows - rows[own.previous]
    drawn_correlation = np.clip(
        correlation + _CORRELATION_SIGMA * rng.standard_normal(NOISE_DRAWS), 0.0, _MAX_CORRELATION
    )
    for k in np.flatnonzero(own.correlation):
        correlations = drawn_correlation ** steps[k]
        fresh[k] = correlations * fresh[own.previous[k]] + np.sqrt(1 - correlations**2) * fresh[k]
    return build_noise_chain(segment, correlation).whiten(fresh)


def _project_out_fit(
    linearized: LinearizedFit, fitted: EffectFit, weights: list[FloatArray], noise: list[FloatArray]
) -> list[FloatArray]:
    """Remove from values what start states and free parameters absorb, to first order; priors and links are ignored."""
    left, by_shared = [], []
    for k, (weight, drawn) in enumerate(zip(weights, noise, strict=True)):
        flow = require_linearized(linearized.point, k)
        states = (flow.start_jacobian * weight[:, None, None]).reshape(-1, flow.start_jacobian.shape[2])
        free = (flow.shared_jacobian[..., fitted.free] * weight[:, None, None]).reshape(len(states), -1)
        basis = _orthonormal_basis(states)
        values = drawn.reshape(len(states), -1)
        left.append(values - basis @ (basis.T @ values))
        by_shared.append(free - basis @ (basis.T @ free))
    shared = _orthonormal_basis(np.concatenate(by_shared))
    values = np.concatenate(left)
    values = values - shared @ (shared.T @ values)
    ends = np.cumsum([len(one) for one in left])[:-1]
    return [part.reshape(drawn.shape) for part, drawn in zip(np.split(values, ends), noise, strict=True)]


def _orthonormal_basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the span of columns (R, m)."""
    if columns.shape[1] == 0:
        return columns
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, sizes > 1e-9 * max(float(sizes[0]), 1e-300)]) if len(sizes) else scaled
