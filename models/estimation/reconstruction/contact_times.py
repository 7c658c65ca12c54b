"""Times of contacts: how a contact gets its time, the only one that it has.

1. The joint fit (`joint_fit.joint_refinement.refine_graph`) times every contact, together with all states and
   coefficients. It holds real tables with soft priors, which costs precision where a contact is observed well.
2. `refine_contact_times` times contacts of two balls again, by the exact physics of the samples around them
   (`contact_test.contact_probability.estimate_contact_time`). Where two ideal balls explain these samples, and the time
   hardly moves, it reaches the Cramer-Rao bound: it and its standard deviation replace those of the joint fit, which
   used the same samples. Elsewhere, and at cushions, strikes and changes without a cause, that of the joint fit stays.
3. A time that a person marked is another measurement: `hand_marks.graph_marks.combine_marked_times` combines it with
   the time so found, unless the motion contradicts it.
4. `joint_fit.joint_refinement.condition_on_contact_times` writes the times of steps 2 and 3 into the contact graph, and
   the joint fit of all else follows, times of the other contacts included; times between which a segment would not last
   are left out.

`explain_shot` takes these steps, in this order, once per shot. Events, trajectory, hypotheses and all answers read the
time of the contact graph; where frames were dropped or late, all of them convert it to the time of showing. Only what
is no contact of the graph has a time from elsewhere: a contact within a simulated break that of the simulation, a close
pass that of the nearest approach.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from models.core.contact_graph import JointSolution, Observations, layout_parameters
from models.core.scene import Scene
from models.core.shot import ContactTestResult
from models.core.typing import FloatArray
from models.estimation.contact_test.contact_motion import BallWindow, PossibleContact, make_ball_window
from models.estimation.contact_test.contact_probability import estimate_contact_time
from models.estimation.contact_test.shot_record import (
    GUARD_SIGMAS,
    WINDOW_TIME,
    estimate_noise_scale,
    estimate_reach_sigma,
)
from models.estimation.joint_fit.contact_cascades import evaluate_state
from models.estimation.joint_fit.fit_solution import evaluate_residuals
from models.estimation.segmentation.track_segmentation import BallSamples

# Per degree of freedom: beyond, two ideal balls do not explain the samples.
MAX_CHI2 = 1.6
# Standard deviations of the joint fit that a time may move.
MAX_MOVE_SIGMAS = 4.0
# s: upper limit of that move.
MAX_MOVE = 4e-3
# Least number of samples of a ball on either side of a contact.
MIN_SAMPLES = 3


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


def list_gaps(solution: JointSolution, tests: Mapping[int, ContactTestResult]) -> FloatArray:
    """List the gaps (C, 2) and their sigmas of contacts by their contact tests; NaN where there is none."""
    gaps = np.full((len(solution.graph.contacts), 2), np.nan)
    for number, one in tests.items():
        gaps[number] = one.gap, one.gap_sigma
    return gaps
