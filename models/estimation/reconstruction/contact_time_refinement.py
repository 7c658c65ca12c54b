"""Refinement of contact times: every ball contact is fitted again with exact physics.

The joint fit holds real tables with soft priors, which costs precision where a contact is observed well. Where the
contact laws of two balls explain the samples around a contact, they time it to the Cramer-Rao bound; elsewhere the time
of the joint fit stays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from models.core.joint_solution import JointSolution, Observations, layout_parameters
from models.core.scene import Scene
from models.core.shot import ContactTestResult
from models.core.typing import FloatArray
from models.estimation.contact_test.candidate_contacts import GUARD_SIGMAS, WINDOW_TIME
from models.estimation.contact_test.contact_moment import BallWindow, PossibleContact, make_ball_window
from models.estimation.contact_test.contact_probability import estimate_contact_time
from models.estimation.contact_test.shot_record import estimate_noise_scale, estimate_reach_sigma
from models.estimation.joint_fit.contact_cascades import evaluate_state
from models.estimation.joint_fit.fit_solution import evaluate_residuals
from models.estimation.segmentation.track_segmentation import BallSamples

MAX_CHI2 = 1.6
"""Per degree of freedom: beyond, two ideal balls do not explain the samples."""
MAX_MOVE_SIGMAS = 4.0
"""Standard deviations of the joint fit that a time may move."""
MAX_MOVE = 4e-3
"""s: upper limit of that move."""
MIN_SAMPLES = 3
"""Least number of samples of a ball on either side of a contact."""


class _FittedShot(NamedTuple):
    """What contacts are timed from."""

    solution: JointSolution
    observations: Observations
    sigma: FloatArray
    """(K,) m, of the observations, scaled to the scatter of their balls about the fitted paths."""
    time_sigma: FloatArray
    """(C,) s, of the contacts."""


def refine_contact_times(
    solution: JointSolution, observations: Observations, scene: Scene
) -> dict[int, ContactTestResult]:
    """Refine the times of all contacts of two balls where exact physics holds.

    Args:
        solution: A solution with its covariance.
        observations: K observations.
        scene: Table and camera.

    Returns:
        Result of the contact test by the number of the contact; its standard deviations include the lack of fit.
    """
    layout = layout_parameters(solution.graph)
    variance = np.diag(solution.covariance)[layout.contact : layout.shared]
    sigma = np.sqrt(np.trace(np.linalg.inv(observations.whiten.mT @ observations.whiten), axis1=1, axis2=2) / 2)
    residual = np.einsum("kij,kj->ki", observations.whiten, evaluate_residuals(solution, observations))
    for ball in np.unique(observations.ball):
        is_own = observations.ball == ball
        sigma[is_own] *= estimate_noise_scale(np.hypot(*residual[is_own].T))
    shot = _FittedShot(solution, observations, sigma, np.sqrt(np.maximum(variance, 0.0)))
    reach = 2 * scene.table.ball_radius, estimate_reach_sigma(scene.table, scene.camera)
    refined = (
        (k, _refine_contact_time(shot, k, *reach)) for k, c in enumerate(solution.graph.contacts) if c.kind == "ball"
    )
    return {k: result for k, result in refined if result is not None}


def _refine_contact_time(shot: _FittedShot, number: int, reach: float, reach_sigma: float) -> ContactTestResult | None:
    """Refine the time of a contact by exact physics; None where that does not hold."""
    t = shot.solution.graph.contacts[number].t
    try:
        windows = tuple(_cut_ball_window(shot, number, ball) for ball in (0, 1))
        if any(min(np.sum(ball.t < t), np.sum(ball.t > t)) < MIN_SAMPLES for ball in windows):
            return None
        result = estimate_contact_time(PossibleContact(windows, reach, reach_sigma), t)
    except (ValueError, np.linalg.LinAlgError):
        return None
    is_near = abs(result.t - t) < min(MAX_MOVE_SIGMAS * float(shot.time_sigma[number]), MAX_MOVE)
    holds = result.closing > 0 and result.chi2 < MAX_CHI2 and is_near
    excess = float(np.sqrt(max(result.chi2, 1.0)))
    inflated = replace(result, t_sigma=excess * result.t_sigma, gap_sigma=excess * result.gap_sigma)
    return inflated if holds else None


def _cut_ball_window(shot: _FittedShot, number: int, which: int) -> BallWindow:
    """Cut the samples of a ball of a contact, from its contact before to its next one after."""
    graph, observations = shot.solution.graph, shot.observations
    contact = graph.contacts[number]
    before, after = contact.before[which], contact.after[which]
    begin = max(contact.t - WINDOW_TIME, float(observations.t.min()), _guard(shot, graph.segments[before].start, 1))
    begin = min(begin, contact.t)
    end = min(contact.t + WINDOW_TIME, _guard(shot, graph.segments[after].end, -1))
    is_inside = (observations.t >= begin) & (observations.t <= max(end, contact.t))
    rows = (observations.ball == graph.segments[before].ball) & is_inside
    samples = BallSamples(observations.t[rows], observations.xy[rows], shot.sigma[rows])
    return make_ball_window(samples, contact.t, begin, evaluate_state(graph, shot.solution.friction, before, begin))


def _guard(shot: _FittedShot, number: int | None, sign: int) -> float:
    """Return the time, s, that samples keep from another contact: after it (sign 1) or before it (-1)."""
    if number is None:
        return -sign * np.inf
    return shot.solution.graph.contacts[number].t + sign * GUARD_SIGMAS * float(shot.time_sigma[number])
