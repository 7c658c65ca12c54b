"""Joint refinement of all segments, contacts and coefficients of a clip: damped least squares (Levenberg-Marquardt).

Observations are weighted by their noise with a robust (Huber) loss; `models.estimation.joint_fit.prior_residuals` adds
the physics as pseudo-observations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dposv

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_arrays import (
    DIAMETER_COLUMN,
    NONE,
    ROLLING_COLUMN,
    SLIDING_COLUMN,
    FitParameters,
    GraphArrays,
    apply_parameters,
    build_graph_arrays,
    end_times,
    extract_parameters,
    start_times,
)
from models.estimation.joint_fit.fit_solution import JointSolution, Observations, assign_sorted_observations
from models.estimation.joint_fit.prior_residuals import (
    ROLLING_PRIOR,
    RUBBER_PRIOR,
    SLIDING_PRIOR,
    PriorRows,
    evaluate_priors,
)
from models.estimation.segmentation.contact_graph import ContactGraph
from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.closed_form_motion import SEGMENT_STATE_SIZE, ClothFriction, differentiate_segment

SLIDING_RANGE, ROLLING_RANGE = (0.05, 0.5), (0.002, 0.04)
"""Bounds of the friction coefficients of any cloth, polished or wet."""
MIN_COST_DECREASE = 0.03
"""chi2 that an iteration must gain: far below a relevant difference."""
SIGMA_UPDATE_INTERVAL = 4
"""Iterations between updates of the standard deviations that depend on speeds."""
MIN_INFORMATION = 1e-6
"""1/variance of an unobserved parameter, in its own unit."""
RIDGE = 1e-10
"""Relative to the information of a parameter: a thousand times the rounding errors of a large fit."""
SHORTEST_SEGMENT = 1e-4
"""s: least time between two contacts of a ball."""
MAX_SHORTENING = 0.7
"""Share of the time between two contacts of a ball by which one step may shorten it."""
NO_COVARIANCE = np.empty((0, 0))
"""The covariance before it is evaluated."""
HUBER_THRESHOLD = 2.5
"""Standard deviations where the loss turns linear."""


@dataclass(frozen=True, slots=True)
class _Linearization:
    """Residuals and their derivatives at one point."""

    residual: FloatArray
    """(2K + M,) in standard deviations: of the observations, then of the priors."""
    jacobian: FloatArray
    columns: IntArray
    """(K, 2, 11) and (K, 11): derivatives of the observations, and their columns among the P; -1 for none."""
    priors: PriorRows
    """Pseudo-observations of physics and priors."""


def refine_graph(
    graph: ContactGraph,
    observations: Observations,
    table: Table,
    iterations: int = 30,
    initial: JointSolution | None = None,
) -> JointSolution:
    """Refine the states, contact times and coefficients of a contact graph.

    Args:
        graph: Graph with initial states and times.
        observations: K observations.
        table: The table.
        iterations: Largest number of iterations.
        initial: Solution with the initial coefficients; the priors by default.

    Returns:
        The best-fitting solution, without covariance.
    """
    initial = initial or JointSolution(
        graph,
        ClothFriction(SLIDING_PRIOR[0], ROLLING_PRIOR[0]),
        1.0,
        np.zeros(4),
        RUBBER_PRIOR.copy(),
        np.inf,
        NO_COVARIANCE,
    )
    arrays, parameters = build_graph_arrays(graph), extract_parameters(initial, graph)
    damping, reference, settled = 1e-3, parameters, False
    linear = _linearize_fit(arrays, parameters, observations, table, reference)
    for iteration in range(iterations):
        weight, cost = _evaluate_huber_loss(linear.residual, 2 * len(observations.t))
        normal, gradient = _build_normal_equations(linear, weight, arrays.size)
        step = _solve_normal_equations(normal, -gradient, damping)
        if -float(gradient @ step) < MIN_COST_DECREASE / 10 and reference is parameters:
            break
        for _ in range(8):
            trial = _apply_step(arrays, parameters, step)
            if _has_valid_order(arrays, trial.t):
                further = _linearize_fit(arrays, trial, observations, table, reference)
                new_cost = _evaluate_huber_loss(further.residual, 2 * len(observations.t))[1]
                if new_cost < cost:
                    break
            damping = min(damping * 6 + 1e-4, 1e8)
            step = _solve_normal_equations(normal, -gradient, damping)
        else:
            break
        settled, before = cost - new_cost < MIN_COST_DECREASE + 1e-5 * cost, settled
        parameters, linear = trial, further
        damping *= 0.15
        if settled and before and iteration > SIGMA_UPDATE_INTERVAL:  # after an update of the standard deviations
            break
        if settled or iteration % SIGMA_UPDATE_INTERVAL == SIGMA_UPDATE_INTERVAL - 1:
            reference = parameters  # update the standard deviations that depend on speeds
            linear = _linearize_fit(arrays, parameters, observations, table, reference)
    refined = apply_parameters(initial, graph, parameters)
    return replace(
        refined, chi2=_evaluate_huber_loss(linear.residual, 2 * len(observations.t))[1], covariance=NO_COVARIANCE
    )


def add_covariance(solution: JointSolution, observations: Observations, table: Table) -> JointSolution:
    """Add the covariance of all parameters to a refined solution.

    Args:
        solution: A refined solution.
        observations: K observations.
        table: The table.

    Returns:
        The solution with its covariance (P, P).
    """
    arrays, parameters = build_graph_arrays(solution.graph), extract_parameters(solution, solution.graph)
    linear = _linearize_fit(arrays, parameters, observations, table, parameters)
    weight, _ = _evaluate_huber_loss(linear.residual, 2 * len(observations.t))
    normal, _ = _build_normal_equations(linear, weight, arrays.size)
    return replace(solution, covariance=_solve_normal_equations(normal, np.eye(arrays.size), 0.0))


def _solve_normal_equations(normal: FloatArray, right: FloatArray, damping: float) -> FloatArray:
    """Solve damped normal equations (P, P) for (P, ...), also where a parameter is unobserved.

    They are scaled to a unit diagonal, so that one ridge far above rounding makes every finite matrix invertible:
    contacts known to a nanosecond stand beside unobserved accelerations.
    """
    if not np.all(np.isfinite(normal)):
        raise np.linalg.LinAlgError("the normal equations of a fit hold numbers that are not finite")
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), MIN_INFORMATION))
    scaled = normal * scale * scale[:, None]
    scaled.flat[:: len(scaled) + 1] += damping + RIDGE
    _, solution, failed = dposv(scaled.T, (right.T * scale).T, lower=1, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("the normal equations of a fit have no single solution")
    return np.asarray((solution.T * scale).T, dtype=np.float64)


def _evaluate_huber_loss(residual: FloatArray, observed: int) -> tuple[FloatArray, float]:
    """Return weights (rows,) and cost: Huber over the pairs of the first `observed` rows, squares for the rest."""
    size = np.linalg.norm(residual[:observed].reshape(-1, 2), axis=1)
    inner = np.minimum(size, HUBER_THRESHOLD)
    weight = np.ones(len(residual))
    weight[:observed] = np.repeat(inner / np.maximum(size, 1e-12), 2)
    weight[:observed][np.repeat(size == 0, 2)] = 1.0
    cost = float((2 * size * inner - inner**2).sum() + (residual[observed:] ** 2).sum())
    return weight, cost


def _build_normal_equations(linear: _Linearization, weight: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Build the normal matrix (P, P) and the gradient (P,)."""
    observed = linear.jacobian.shape[0] * 2
    normal, gradient, priors = np.zeros((size, size)), np.zeros(size), linear.priors
    _add_prior_rows(priors.residual, priors.derivative, priors.column, priors.first, normal, gradient)
    _add_observation_rows(
        linear.jacobian, linear.columns, linear.residual[:observed], weight[:observed], normal, gradient
    )
    return normal, gradient


@compile_kernel
def _add_prior_rows(residual, derivative, column, first, normal, gradient):  # type: ignore[no-untyped-def]
    """Add the pseudo-observations, see `physics_priors.PriorRows`, to the normal equations."""
    for row in range(len(residual)):
        for i in range(first[row], first[row + 1]):
            gradient[column[i]] += derivative[i] * residual[row]
            for j in range(first[row], first[row + 1]):
                normal[column[i], column[j]] += derivative[i] * derivative[j]


@compile_kernel
def _add_observation_rows(jacobian, columns, residual, weight, normal, gradient):  # type: ignore[no-untyped-def]
    """Add the observations, Jacobian (K, 2, C) at columns (K, C), negative if unused, to the normal equations."""
    for k in range(jacobian.shape[0]):
        for axis in range(2):
            w, r = weight[2 * k + axis], residual[2 * k + axis]
            for i in range(jacobian.shape[2]):
                row = columns[k, i]
                if row < 0 or jacobian[k, axis, i] == 0.0:
                    continue
                scaled = w * jacobian[k, axis, i]
                gradient[row] += scaled * r
                for j in range(jacobian.shape[2]):
                    if columns[k, j] >= 0:
                        normal[row, columns[k, j]] += scaled * jacobian[k, axis, j]


def _apply_step(arrays: GraphArrays, parameters: FitParameters, step: FloatArray) -> FitParameters:
    """Apply a step (P,) to the parameters.

    No contact moves by more than 20 ms at once, nor most of the way to another one of its balls; no coefficient by more
    than a third.
    """
    contact_moves = np.clip(step[arrays.first_contact : arrays.first_shared], -0.02, 0.02)
    _limit_contact_moves(contact_moves, arrays, start_times(arrays, parameters.t), end_times(arrays, parameters.t))
    shared, shared_step = parameters.shared.copy(), step[arrays.first_shared :]
    friction = shared[:DIAMETER_COLUMN] * np.exp(np.clip(shared_step[:DIAMETER_COLUMN], -0.3, 0.3))
    shared[:DIAMETER_COLUMN] = np.clip(friction, *np.transpose([SLIDING_RANGE, ROLLING_RANGE]))
    shared[DIAMETER_COLUMN:] += shared_step[DIAMETER_COLUMN:]
    return FitParameters(_step_states(arrays, parameters.state, step), parameters.t + contact_moves, shared)


@compile_kernel
def _step_states(arrays, state, step):  # type: ignore[no-untyped-def]
    """Apply a step (P,) to the states (S, 8) of segments."""
    stepped = state.copy()
    for k in range(len(state)):
        for i in range(2 if arrays.static[k] else SEGMENT_STATE_SIZE):
            stepped[k, i] += step[arrays.column[k] + i]
    return stepped


@compile_kernel
def _limit_contact_moves(moves, arrays, start, end):  # type: ignore[no-untyped-def]
    """Shorten the moves (C,) s of contacts until all segments last."""
    while True:
        share = np.ones(len(moves))
        for k in range(len(start)):
            if arrays.end[k] == NONE:
                continue
            duration = end[k] - start[k]
            approach = -moves[arrays.end[k]]
            if arrays.start[k] != NONE:
                approach += moves[arrays.start[k]]
            room = max(min(MAX_SHORTENING * duration, duration - 2 * SHORTEST_SEGMENT), 0.0)
            if approach > room + 1e-9:
                share[arrays.end[k]] = min(share[arrays.end[k]], 0.9 * room / approach)
                if arrays.start[k] != NONE:
                    share[arrays.start[k]] = min(share[arrays.start[k]], 0.9 * room / approach)
        if np.all(share == 1.0):
            return
        moves *= share


def _has_valid_order(arrays: GraphArrays, t: FloatArray) -> bool:
    """Return whether all segments last."""
    return bool(np.all(end_times(arrays, t) > start_times(arrays, t) + SHORTEST_SEGMENT))


def _linearize_fit(
    arrays: GraphArrays, parameters: FitParameters, observations: Observations, table: Table, reference: FitParameters
) -> _Linearization:
    """Evaluate whitened residuals and their derivatives: observations first, then physics and priors.

    Standard deviations that depend on speeds are taken from `reference`, so that the costs of steps are comparable.
    """
    residual, jacobian, columns = _linearize_observations(
        arrays, parameters, observations.ball, observations.t, observations.xy, observations.whiten
    )
    rows = evaluate_priors(arrays, parameters, reference, table)
    return _Linearization(np.concatenate([residual, rows.residual]), jacobian, columns, rows)


@compile_kernel
def _linearize_observations(arrays, parameters, ball, t, xy, whiten):  # type: ignore[no-untyped-def]
    """Evaluate whitened residuals (2K,), derivatives (K, 2, 11) and columns (K, 11), NONE where there is none."""
    start = start_times(arrays, parameters.t)
    owner = assign_sorted_observations(arrays.ball, start, ball, t)
    residual, jacobian = np.empty(2 * len(t)), np.zeros((len(t), 2, SEGMENT_STATE_SIZE + 3))
    columns = np.full((len(t), SEGMENT_STATE_SIZE + 3), NONE)
    slide_end, slide_derivative, value, derivative = (
        np.empty(7),
        np.empty((7, SEGMENT_STATE_SIZE + 3)),
        np.empty(6),
        np.zeros((6, SEGMENT_STATE_SIZE + 3)),
    )
    for row in range(len(t)):
        k, w = owner[row], whiten[row]
        size = 2 if arrays.static[k] else SEGMENT_STATE_SIZE
        if arrays.static[k]:  # most balls rest most of the time
            value[:2], derivative[:2] = parameters.state[k, :2], 0.0
            derivative[0, 0] = derivative[1, 1] = 1.0
        else:
            tau = t[row] - start[k]
            differentiate_segment(
                parameters.state[k],
                tau,
                parameters.shared[SLIDING_COLUMN],
                parameters.shared[ROLLING_COLUMN],
                slide_end,
                slide_derivative,
                value,
                derivative,
            )
            derivative[:, SEGMENT_STATE_SIZE] *= -1  # a later start is a shorter time since
            columns[row, SEGMENT_STATE_SIZE + 1], columns[row, SEGMENT_STATE_SIZE + 2] = (
                arrays.first_shared,
                arrays.first_shared + 1,
            )
        if arrays.start[k] != NONE and not arrays.static[k]:
            columns[row, SEGMENT_STATE_SIZE] = arrays.first_contact + arrays.start[k]
        for i in range(size):
            columns[row, i] = arrays.column[k] + i
        for axis in range(2):
            residual_xy = value[:2] - xy[row]
            residual[2 * row + axis] = w[axis, 0] * residual_xy[0] + w[axis, 1] * residual_xy[1]
            jacobian[row, axis] = w[axis, 0] * derivative[0] + w[axis, 1] * derivative[1]
    return residual, jacobian, columns
