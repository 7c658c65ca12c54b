"""State of a shot at a moment, from its joint solution.

The errors of speeds and of friction, which a prediction accumulates, keep their correlation. What no frame shows has a
realistic spread instead: spin about the vertical, the level of the table, the friction of cushions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.constants import GRAVITY
from models.core.contact_graph import JointSolution, Observations, Segment, layout_parameters
from models.core.fit_result import Trust
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock
from models.core.typing import FloatArray
from models.estimation.forecast.state_estimate import (
    NOSE_FRICTION,
    PARAMETERS_PER_BALL,
    SHARED_COUNT,
    StateEstimate,
    law_probabilities,
)
from models.estimation.joint_fit.contact_cascades import find_segment_at
from models.estimation.joint_fit.fit_solution import assign_observations, collect_observations, evaluate_residuals
from models.estimation.joint_fit.pseudo_observations import (
    BALL_RESTITUTION,
    NOSE_SCATTER,
    SHARED_SIGMA,
)
from models.estimation.table_learning.cushion_contacts import (
    CushionContacts,
    SpinHistory,
    evaluate_segment_state,
    extract_cushion_contacts,
)
from models.estimation.table_learning.cushion_learning import learn_own_cushions
from models.estimation.table_learning.learned_table import CLOTH_SPREAD, ROLLING_MODEL_SIGMA, LearnedTable
from models.estimation.table_learning.side_spin import infer_side_spins
from models.numerics.statistics import evaluate_huber_loss, measure_lack_of_fit
from models.physics.billiards.contact_models import CUSHION_MODELS
from models.physics.billiards.parameter_vector import AIR_DRAG, ROLLING_MU, SLIDING_MU, VISCOUS_DRAG
from models.tracking.track_noise import apply_noise, estimate_noise

# Share of the weight's component along a slope that accelerates a rolling ball: the rest turns it.
ROLLING_SLOPE_FACTOR = 5 / 7
# m/s^2 per axis: effect of an uneven cloth on a window, a slope of 1.5 mm/m.
UNEVENNESS = 0.01
# mm/m: prior standard deviation of the slope of a levelled table.
SLOPE_SIGMA = 2.0
# s: short enough for a nearly constant push by the cloth.
WINDOW_LENGTH = 0.3
# m/s: faster balls give the noise.
MIN_NOISE_SPEED = 0.1
# Upper limit of the factor on variances: a worse fit is wrong.
MAX_INFLATION = 30.0
# Standard deviation of the surface speed of side spin after a contact, over the speed of the ball: a nose that sticks
# gives 5/7 of the speed along it, a cue up to 5/4.
SIDE_SPIN_SHARE = 0.5
# The same, after a long time.
MIN_SIDE_SPIN_SHARE = 0.05
# rad/s^2, and standard deviation of its logarithm.
SPIN_DECAY_RATE, SPIN_DECAY_SIGMA = 10.0, 0.4
# Of the restitution: scatter of real cushions about every law, 5 % of the speed, and the effect of the scatter of spin,
# 12 %, once the ball rolls.
RETURN_SCATTER = 0.075
# Of its logarithm (Marlow 1995: 0.14 to 0.2).
NOSE_FRICTION_SIGMA = 0.4


def collect_captured_observations(tracks: Tracks, clock: CaptureClock | None, table: Table) -> Observations:
    """Collect the observations of a clip at their capture times, with realistic noise.

    Args:
        tracks: Tracks of T frames and N balls, in presentation time.
        clock: Clock of the frames, as in the trajectory of a fit; None where capture and presentation times are equal.
        table: Dimensions of the table.

    Returns:
        K observations.
    """
    captured = tracks if clock is None else replace(tracks, t=clock.capture_time)
    return collect_observations(apply_noise(captured, estimate_noise(captured, MIN_NOISE_SPEED, table.ball_radius)))


def estimate_lack_of_fit(solution: JointSolution, observations: Observations) -> float:
    """Estimate a factor >= 1 on variances, for residuals of moving balls that exceed the noise or are correlated.

    Balls with too few detections to be in the graph do not count.
    """
    balls = [ball for ball in np.unique(observations.ball) if solution.graph.segments_of_ball(int(ball))]
    rows = np.isin(observations.ball, balls)
    observations = observations.select_rows(rows)
    owner, residual = assign_observations(solution.graph, observations), evaluate_residuals(solution, observations)
    whitened = np.einsum("kij,kj->ki", observations.whiten, residual)
    bounded = whitened * evaluate_huber_loss(whitened)[0][:, None]
    series = [bounded[owner == k] for k, segment in enumerate(solution.graph.segments) if not segment.static]
    free = sum(min(one.size, 5) for one in series)
    return min(measure_lack_of_fit(series, free)[1], MAX_INFLATION)


def build_state_estimate(
    solution: JointSolution,
    ids: tuple[str, ...],
    t: float,
    table: Table,
    pocketed: set[str],
    trust: Trust,
    inflation: float = 1.0,
    learned: LearnedTable | None = None,
    is_last: bool = True,
) -> StateEstimate:
    """Build the state estimate at the capture time t (s) from a fit.

    Args:
        solution: Joint fit with covariance.
        ids: Names of the balls of the clip.
        t: s, capture time.
        table: Dimensions of the table.
        pocketed: Balls that have been potted.
        trust: Trust level of the fit.
        inflation: Factor on the variances.
        learned: The table, where known.
        is_last: Whether t is after the last contact, so that earlier contacts tell the side spin.

    Returns:
        States of the balls on the table, with their covariance.
    """
    inflated = replace(solution, covariance=inflate_covariance(solution, inflation))
    shift, covariance = _condition_on_table(inflated, t, learned)
    graph = solution.graph
    balls = [k for k, name in enumerate(ids) if name not in pocketed and graph.segments_of_ball(k)]
    size = PARAMETERS_PER_BALL * len(balls) + SHARED_COUNT
    mean, jacobian = np.zeros(size), np.zeros((size, len(covariance)))
    side = np.zeros(size)
    moving = np.zeros(len(balls), bool)
    for row, ball in enumerate(balls):
        segment = find_segment_at(graph, ball, t + 1e-9)
        here = slice(PARAMETERS_PER_BALL * row, PARAMETERS_PER_BALL * row + 6)
        mean[here], jacobian[here, : len(solution.covariance)] = evaluate_segment_state(solution, segment, t)
        moving[row] = bool(np.any(mean[here][2:4]))
        if moving[row]:
            since = t - graph.start_time(segment)
            side[here.stop] = _side_spin_sigma(graph.segments[segment], since, table.ball_radius)
    _fill_shared_parameters(solution, mean, jacobian)
    beyond_fit = side**2
    beyond_fit[-SHARED_COUNT:] = _variances_beyond_fit()
    total = jacobian @ covariance @ jacobian.T + np.diag(beyond_fit)
    names = tuple(ids[k] for k in balls)
    grip = layout_parameters(graph).shared + 9
    laws = law_probabilities(float(solution.rubber[2] + shift[grip]), float(np.sqrt(covariance[grip, grip])))
    state = StateEstimate(t, names, table, mean + jacobian @ shift, (total + total.T) / 2, moving, trust, laws)
    contacts, histories = extract_cushion_contacts(solution, table)
    used = learn_own_cushions(contacts, solution, table) if learned is None else learned
    if used is None:
        return state
    return _use_learned_table(state, solution, balls, used, contacts, histories if is_last else ())


def _use_learned_table(
    state: StateEstimate, solution: JointSolution, balls: list[int], learned: LearnedTable, contacts: CushionContacts,
    histories: tuple[SpinHistory, ...],
) -> StateEstimate:  # fmt: skip
    """Replace the default cushions, friction and side spins of a state by those of a learned table."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    first = len(mean) - SHARED_COUNT
    effective = float(np.exp(mean[first + 1]))
    drag = min(_drag_as_friction(solution, state.t, learned), 0.5 * effective)
    mean[first + 1] = np.log(effective - drag)  # the engine adds the drag of the table again
    graph = solution.graph
    since = {one.ball: max(state.t - graph.start_time(graph.segments_of_ball(one.ball)[-1]), 0.0) for one in histories}
    spins = infer_side_spins(contacts, histories, since, learned, state.table.ball_radius, state.table.ball_mass)
    own = tuple(spins.get(ball) if moves else None for ball, moves in zip(balls, state.moving, strict=True))
    for row, spin in enumerate(own):
        if spin is not None:
            column = PARAMETERS_PER_BALL * row + 6
            mean[column] = spin.mean
            covariance[column], covariance[:, column] = 0.0, 0.0
            covariance[column, column] = spin.sigma**2
    laws = np.eye(len(CUSHION_MODELS))[learned.law_code]
    return replace(state, mean=mean, covariance=covariance, laws=laws, learned=learned, spins=own)


def inflate_covariance(solution: JointSolution, factor: float) -> FloatArray:
    """Multiply the covariance of a fit by a factor, but keep the priors of the shared parameters.

    Args:
        solution: Joint fit with covariance of P parameters.
        factor: At least 1.

    Returns:
        (P, P) covariance.
    """
    covariance = factor * solution.covariance
    first = layout_parameters(solution.graph).shared
    if factor > 1:
        both = covariance[first:, first:] + np.diag(SHARED_SIGMA**2)
        covariance = covariance - covariance[:, first:] @ np.linalg.solve(both, covariance[first:])
    return np.asarray(covariance, np.float64)


def _condition_on_table(
    solution: JointSolution, t: float, learned: LearnedTable | None
) -> tuple[FloatArray, FloatArray]:
    """Condition a fit on what its segments share: one slope of an uneven cloth, and the learned table if there is one.

    Returns the shift of the parameters of a fit (P + 2,), and their covariance (P + 2, P + 2) with two more for the
    slope (m/s^2).
    """
    layout, graph = layout_parameters(solution.graph), solution.graph
    covariance = np.zeros((layout.size + 2, layout.size + 2))
    covariance[:-2, :-2] = solution.covariance
    covariance[-2:, -2:] = np.eye(2) * (SLOPE_SIGMA * _acceleration_per_slope()) ** 2
    rows, deviations, sigmas = [], [], []
    for k, segment in enumerate(graph.segments):
        for axis in range(0 if segment.static else 2):
            row = np.zeros(layout.size + 2)
            row[layout.segment[k] + 6 + axis], row[layout.size + axis] = 1.0, -1.0
            rows.append(row)
            deviations.append(segment.state[6 + axis])
            sigmas.append(UNEVENNESS)
    if learned is not None:
        shared = np.concatenate([np.log([solution.friction.sliding, solution.friction.rolling]), solution.nose_offsets])
        columns = layout.shared + np.array([0, 1, 3, 4, 5, 6])  # frictions and noses, without the diameter
        rows += list(np.eye(layout.size + 2)[columns])
        deviations += (shared - _expected_shared(solution, t, learned)).tolist()
        sigmas += [*np.hypot(CLOTH_SPREAD, [0.0, ROLLING_MODEL_SIGMA]), *learned.nose_sigma]
    if not rows:
        return np.zeros(layout.size + 2), covariance
    constraints, noise = np.array(rows), np.diag(np.square(sigmas))
    if learned is not None:
        noise[-4:, -4:] = learned.nose_covariance
    gain = np.linalg.solve(constraints @ covariance @ constraints.T + noise, constraints @ covariance).T
    return -gain @ np.array(deviations), covariance - gain @ constraints @ covariance


def _expected_shared(solution: JointSolution, t: float, learned: LearnedTable) -> FloatArray:
    """Return ln sliding, ln rolling friction and nose offsets (6,) that a fit of the learned table would have.

    The joint fit has one rolling friction for all speeds, so that drag adds to it.
    """
    rolling = learned.physics[ROLLING_MU] + _drag_as_friction(solution, t, learned)
    return np.concatenate([[np.log(learned.physics[SLIDING_MU]), np.log(rolling)], learned.noses])


def _drag_as_friction(solution: JointSolution, t: float, learned: LearnedTable) -> float:
    """Return the rolling friction that acts like the drag of the table at the mean speed of the last segments."""
    graph = solution.graph
    speeds = [
        float(np.hypot(*one.state[2:4]))
        for k, one in enumerate(graph.segments)
        if not one.static and graph.end_time(k) >= t
    ]
    speed = float(np.mean(speeds)) if speeds else 0.0
    return float(learned.physics[VISCOUS_DRAG] * speed + learned.physics[AIR_DRAG] * speed**2) / GRAVITY


def _acceleration_per_slope() -> float:
    """Return the acceleration of a rolling ball, m/s^2, on a slope of 1 mm/m."""
    return ROLLING_SLOPE_FACTOR * GRAVITY * 1e-3


def _side_spin_sigma(segment: Segment, since: float, radius: float) -> float:
    """Return the standard deviation of the surface speed of side spin, m/s, some time after a contact."""
    speed = float(np.hypot(*segment.state[2:4]))
    return max(SIDE_SPIN_SHARE * speed - SPIN_DECAY_RATE * radius * since, MIN_SIDE_SPIN_SHARE * speed)


def _fill_shared_parameters(solution: JointSolution, mean: FloatArray, jacobian: FloatArray) -> None:
    """Fill in the shared parameters and their derivatives."""
    layout = layout_parameters(solution.graph)
    friction = solution.friction
    mean[-SHARED_COUNT:] = [
        np.log(friction.sliding), np.log(friction.rolling), 0.0, 0.0, solution.diameter_factor, *solution.nose_offsets,
        *solution.rubber[:2], BALL_RESTITUTION[0], np.log(NOSE_FRICTION), np.log(SPIN_DECAY_RATE),
    ]  # fmt: skip
    first = len(mean) - SHARED_COUNT
    for row, column in ((0, 0), (1, 1), *((4 + k, 2 + k) for k in range(7))):
        jacobian[first + row, layout.shared + column] = 1.0
    jacobian[first + 2, -2] = jacobian[first + 3, -1] = 1 / _acceleration_per_slope()


def _variances_beyond_fit() -> FloatArray:
    """Return the variances (SHARED_COUNT,) that the fit does not contain."""
    variance = np.zeros(SHARED_COUNT)
    # effect of an uneven cloth over a second, as one slope
    variance[2:4] = 4 / 3 * WINDOW_LENGTH * (UNEVENNESS / _acceleration_per_slope()) ** 2
    variance[5:9] = NOSE_SCATTER**2
    variance[9] = RETURN_SCATTER**2
    variance[11:] = BALL_RESTITUTION[1] ** 2, NOSE_FRICTION_SIGMA**2, SPIN_DECAY_SIGMA**2
    return variance
