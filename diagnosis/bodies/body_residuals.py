"""Residuals of a fit in which every body has strengths of its own, and the agreement of each body's shots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.bodies.body_strengths import BodyFit, select_body_fit
from diagnosis.fitting.fit_residuals import FitResiduals, compute_residuals
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, LinearizedFit, linearize_fit


def linearize_bodies(
    problem: DiagnosisProblem, like: EffectFit, body_fit: BodyFit
) -> tuple[tuple[EffectFit, LinearizedFit], ...]:
    """Linearise the windows of every body at its own strengths.

    Args:
        problem: Scene and priors.
        like: Fit with strengths that all bodies share.
        body_fit: Fit with strengths of every body.

    Returns:
        Fit and linearisation per body, in the order of `body_fit.bodies`.
    """
    fits = (select_body_fit(like, body_fit, body) for body in body_fit.bodies)
    return tuple((fitted, linearize_fit(problem, fitted)) for fitted in fits)


def compute_body_residuals(
    problem: DiagnosisProblem, bodies: tuple[tuple[EffectFit, LinearizedFit], ...], rng: np.random.Generator
) -> FitResiduals:
    """Compute the residuals of all windows of a `BodyFit`, in its order; or those of one fit of all bodies.

    Args:
        problem: Scene and noise.
        bodies: Fit and linearisation per body.
        rng: Random generator of the noise.

    Returns:
        Residuals of all observations; with several fits, `body` is 0 throughout, as a window has one body.
    """
    parts = [compute_residuals(problem, fitted, linearized, rng) for fitted, linearized in bodies]
    if len(parts) == 1:
        return parts[0]
    first_windows = np.cumsum([0, *(len(fitted.segments) for fitted, _ in bodies)])
    counts = np.array([one.values.size for one in parts])
    scale = float(np.sqrt(counts @ np.square([one.scale for one in parts]) / counts.sum()))
    images = [one.image for one in parts if one.image is not None]
    return replace(
        parts[0],
        values=np.concatenate([one.values * one.scale / scale for one in parts]),
        noise_draws=np.concatenate([one.noise_draws for one in parts]),
        window=np.concatenate([one.window + first for one, first in zip(parts, first_windows[:-1], strict=True)]),
        shot=np.concatenate([one.shot for one in parts]),
        body=np.concatenate([one.body for one in parts]),
        frame=np.concatenate([one.frame for one in parts]),
        t=np.concatenate([one.t for one in parts]),
        phase=np.concatenate([one.phase for one in parts]),
        position=np.concatenate([one.position for one in parts]),
        velocity=np.concatenate([one.velocity for one in parts]),
        since_contact=np.concatenate([one.since_contact for one in parts]),
        image=np.concatenate(images) if len(images) == len(parts) else None,
        scale=scale,
    )
