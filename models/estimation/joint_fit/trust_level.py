"""Acceptance of segments, and the trust level of a clip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Trust, TrustLevel
from models.core.joint_solution import JointSolution, Observations
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import assign_observations, evaluate_residuals

MAX_CHI2 = 4.0
"""Per degree of freedom of a segment, against the noise that the samples themselves show."""
BLUR_PIXELS, UNEVENNESS_RADII = 0.5, 0.02
"""px and ball radii, in quadrature: a misfit below the resolution of an image is accepted whatever its chi2. Random
noise may be a twentieth of a pixel, yet texture, dark limbs, lens and homography shift balls by up to half a pixel over
longer ways, and no cloth is even to half a millimetre: slow balls curl, and settle back into their dent.
"""
JITTER_RADII = 0.25
"""Ball radii: a ball that stays so near to one place rests there, since no ball goes to and fro by itself."""
MAX_MISFIT_RADII = 0.7
"""Ball radii: a path with larger residuals explains nothing, however noisy its samples are."""
GREEN_SHARE, AMBER_SHARE = 0.9, 0.6
"""Shares of the moving time that accepted fits must explain."""


def evaluate_segment_chi2(
    solution: JointSolution, observations: Observations
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Evaluate the misfit of each segment.

    Args:
        solution: The solution.
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
        solution: The solution.
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
            for other in _segments_at_contact(solution, c, segment.ball)
        ]
        observed_neighbours = [other for other in neighbours if other != k and count[other] > 0]
        is_accepted[k] = bool(observed_neighbours) and all(bool(is_accepted[other]) for other in observed_neighbours)
    accepted: NDArray[np.bool_] = is_accepted
    return accepted


def assess_trust(share: float, chi2: float, moving_seconds: float, warnings: list[str]) -> Trust:
    """Assess the trust level of a clip.

    Args:
        share: Share of the moving time that accepted segments explain.
        chi2: chi2 per degree of freedom.
        moving_seconds: Moving time, s; 0 if no ball moves.
        warnings: Sentences on other doubts.

    Returns:
        Trust level with its reasons.
    """
    if moving_seconds == 0:
        return Trust("green", ("No ball moves.",)) if not warnings else Trust("amber", ("No ball moves.", *warnings))
    time = "all the time" if share == 1 else f"{100 * share:.0f} % of the time"
    reasons = [f"The listed strokes and contacts explain how the balls move {time}."]
    if np.isfinite(chi2) and chi2 > 2:
        reasons.append(f"Residuals exceed the stated errors: chi2 per degree of freedom is {chi2:.1f}.")
    colour: TrustLevel = "green"
    if share < AMBER_SHARE:
        colour = "red"
    elif share < GREEN_SHARE or (np.isfinite(chi2) and chi2 > 3) or warnings:
        colour = "amber"
    return Trust(colour, (*reasons, *warnings))


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
    return Trust("amber" if trust.level == "green" else trust.level, (*trust.reasons, *warnings))


def _segments_at_contact(solution: JointSolution, contact: int, ball: int) -> list[int]:
    c = solution.graph.contacts[contact]
    return [k for k in (*c.before, *c.after) if solution.graph.segments[k].ball == ball]
