"""Acceptance of segments, and the trust level of a clip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import JointSolution, Observations
from models.core.fit_result import AMBER_SHARE, GREEN_SHARE, Trust, TrustLevel
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import assign_observations, evaluate_residuals

# Per degree of freedom of a segment, against the noise that the samples themselves show.
MAX_CHI2 = 4.0
# px and ball radii, in quadrature: a misfit below the resolution of an image is accepted whatever its chi2. Random
# noise may be a twentieth of a pixel, yet texture, dark limbs, lens and homography shift balls by up to half a pixel
# over longer ways, and no cloth is even to half a millimetre: slow balls curl, and settle back into their dent.
BLUR_PIXELS, UNEVENNESS_RADII = 0.5, 0.02
# Ball radii: a ball that stays so near to one place rests there, since no ball goes to and fro by itself.
JITTER_RADII = 0.25
# Ball radii: a path with larger residuals explains nothing, however noisy its samples are.
MAX_MISFIT_RADII = 0.7
# Relative error of the assumed variances: real noise is known to about 10 %; and the standard deviations by which chi2
# may deviate, which also scatters between segments.
VARIANCE_ERROR, MAX_DEVIATION = 0.2, 3.0
# Beginning of the reason that is no doubt.
EXPLAINED = "Between contacts, the laws of motion explain how the balls move"


def evaluate_segment_chi2(
    solution: JointSolution, observations: Observations
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Evaluate the misfit of each segment.

    Args:
        observations: K observations.

    Returns:
        Robust chi2 per degree of freedom (S,), root mean square residual (S,) m, and number of samples (S,).
    """
    graph = solution.graph
    residual = evaluate_residuals(solution, observations)
    whitened = np.einsum("kij,kj->ki", observations.whiten, residual)
    owner = assign_observations(graph, observations)
    chi2, rms = np.full(len(graph.segments), np.nan), np.full(len(graph.segments), np.nan)
    count = np.bincount(owner, minlength=len(graph.segments))
    for k in np.flatnonzero(count):
        size = (whitened[owner == k] ** 2).sum(axis=1)
        free = 2.0 if graph.segments[k].static else 4.0
        trimmed = np.minimum(size, 25.0).sum()  # single outliers do not reject a segment
        chi2[k] = trimmed / max(2 * count[k] - free, count[k])
        rms[k] = np.sqrt((residual[owner == k] ** 2).sum(axis=1).mean() / 2)
    return chi2, rms, count


def find_accepted_segments(
    solution: JointSolution, observations: Observations, radius: float, pixel: float
) -> NDArray[np.bool_]:
    """Find the segments that the physics explains.

    An unobserved segment is accepted if both neighbours are.

    Args:
        observations: K observations.
        radius: Ball radius, m.
        pixel: Size of a pixel on the table, m.

    Returns:
        (S,) True for accepted segments.
    """
    chi2, rms, count = evaluate_segment_chi2(solution, observations)
    static = np.array([segment.static for segment in solution.graph.segments], dtype=bool)
    floor = np.where(static, JITTER_RADII * radius, np.hypot(BLUR_PIXELS * pixel, UNEVENNESS_RADII * radius))
    is_accepted = ((chi2 < MAX_CHI2) | (rms < floor)) & (rms < MAX_MISFIT_RADII * radius)
    graph = solution.graph
    for k in np.flatnonzero(count == 0):
        segment = graph.segments[k]
        neighbours = [
            other
            for c in (segment.start, segment.end)
            if c is not None
            for other in (*graph.contacts[c].before, *graph.contacts[c].after)
            if graph.segments[other].ball == segment.ball
        ]
        observed_neighbours = [other for other in neighbours if other != k and count[other] > 0]
        is_accepted[k] = bool(observed_neighbours) and all(bool(is_accepted[other]) for other in observed_neighbours)
    accepted: NDArray[np.bool_] = is_accepted
    return accepted


@dataclass(frozen=True, slots=True)
class NoiseAssessment:
    """Noise of measured positions, and how it agrees with the errors that the fit assumes."""

    sigma: float
    """m per axis, estimated robustly from the residuals."""
    chi2: float
    """Per degree of freedom; outliers are trimmed."""
    chi2_range: tuple[float, float]
    """Values that agree with the assumed errors: a part of them is common to all frames, so that residuals need not
    show it."""


def assess_noise(
    solution: JointSolution, observations: Observations, is_accepted: NDArray[np.bool_], floor: float
) -> NoiseAssessment:
    """Assess the noise of moving balls, or of all where none moves: frames of a ball at rest repeat their errors.

    Args:
        observations: K observations.
        is_accepted: (S,) whether physics explains a segment.
        floor: m, part of all errors that is common to frames.

    Returns:
        The noise; NaN where no segment is accepted.
    """
    segments, owner = solution.graph.segments, assign_observations(solution.graph, observations)
    is_static = np.array([segment.static for segment in segments], dtype=bool)
    rows = is_accepted[owner] & ~is_static[owner]
    rows = rows if rows.any() else is_accepted[owner]
    if not rows.any():
        return NoiseAssessment(np.nan, np.nan, (0.0, np.inf))
    residual, whiten = evaluate_residuals(solution, observations)[rows], observations.whiten[rows]
    size = np.minimum((np.einsum("kij,kj->ki", whiten, residual) ** 2).sum(axis=1), 25.0)
    _, part = np.unique(owner[rows], return_inverse=True)
    count = np.bincount(part)
    free = np.maximum(2 * count - 5, count)
    chi2 = float(size.sum() / free.sum())
    scatter = float(np.sqrt(((np.bincount(part, size) - chi2 * free) ** 2).sum()) / free.sum())
    varying = float(np.maximum(1 - floor**2 * (whiten**2).sum(axis=(1, 2)) / 2, 0.0).mean())
    low, high = (np.hypot(scatter, one * VARIANCE_ERROR) for one in (varying, 1.0))
    return NoiseAssessment(
        float(np.sqrt(np.median((residual**2).sum(axis=1)) / (2 * np.log(2)))), chi2,
        (max(varying - MAX_DEVIATION * low, 0.0), 1 + MAX_DEVIATION * high),
    )  # fmt: skip


def assess_trust(share: float, noise: NoiseAssessment | None, moving_seconds: float, warnings: list[str]) -> Trust:
    """Assess the trust level of a clip.

    Args:
        share: Share of the moving time that accepted segments explain.
        noise: Noise of measured positions; None where nothing was fitted.
        moving_seconds: Moving time, s; 0 if no ball moves.
        warnings: Sentences on other doubts.

    Returns:
        Trust level with its reasons.
    """
    if moving_seconds == 0:
        return Trust("green", ("No ball moves.",)) if not warnings else Trust("amber", ("No ball moves.", *warnings))
    time = "all the time" if share > 0.995 else f"{100 * share:.0f} % of the time"
    reasons = [f"{EXPLAINED} {time}."]
    if noise is not None and not noise.chi2_range[0] <= np.nan_to_num(noise.chi2, nan=1.0) <= noise.chi2_range[1]:
        low, high = noise.chi2_range
        doubt = (
            f"The positions scatter {np.sqrt(noise.chi2):.1f} times as much around the fitted paths as their errors say"
        )
        warnings = [f"{doubt}; {np.sqrt(low):.1f} to {np.sqrt(high):.1f} times would agree.", *warnings]
    colour: TrustLevel = "green"
    if share < AMBER_SHARE:
        colour = "red"
    elif share < GREEN_SHARE or warnings:
        colour = "amber"
    return Trust(colour, (*reasons, *warnings) if share < GREEN_SHARE else (*warnings, *reasons))


def add_warnings(trust: Trust, warnings: tuple[str, ...]) -> Trust:
    """Add warnings, such as an uncertain table size, to a trust level; it is green no longer.

    Args:
        trust: Trust level of a fit.
        warnings: Sentences.

    Returns:
        The same trust level, at best amber if there are warnings.
    """
    if not warnings:
        return trust
    if trust.level == "red":  # what makes a level stands first
        return Trust("red", (*trust.reasons, *warnings))
    return Trust("amber", (*warnings, *trust.reasons))
