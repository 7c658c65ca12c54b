"""Joint refinement of all segments, contacts and coefficients of a clip: damped least squares (Levenberg-Marquardt).

Observations are weighted by their noise with a robust (Huber) loss;
`models.estimation.joint_fit.pseudo_observations` adds the physics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.core.contact_graph import SEGMENT_STATE_SIZE, ClothFriction, ContactGraph, JointSolution, Observations
from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_solution import (
    DIAMETER_COLUMN,
    NONE,
    ROLLING_COLUMN,
    SEARCH_CONTINUITY,
    SLIDING_COLUMN,
    FitParameters,
    GraphArrays,
    apply_parameters,
    assign_sorted_observations,
    build_graph_arrays,
    end_times,
    extract_parameters,
    start_times,
)
from models.estimation.joint_fit.pseudo_observations import (
    ROLLING_PRIOR,
    RUBBER_PRIOR,
    SLIDING_PRIOR,
    PriorRows,
    evaluate_priors,
)
from models.numerics.jit import compile_kernel
from models.numerics.least_squares import (
    NormalEquations,
    SearchOptions,
    minimize_cost,
    solve_damped,
    solve_normal_equations,
)
from models.numerics.statistics import evaluate_pair_loss
from models.physics.billiards.cloth.closed_form_motion import differentiate_segment

# Bounds of the friction coefficients of any cloth, polished or wet.
SLIDING_RANGE, ROLLING_RANGE = (0.05, 0.5), (0.002, 0.04)
# chi2 that an iteration must gain: far below a relevant difference.
MIN_COST_DECREASE = 0.03
# Iterations between updates of the standard deviations that depend on speeds.
SIGMA_UPDATE_INTERVAL = 4
# s: least time between two contacts of a ball.
SHORTEST_SEGMENT = 1e-4
# Share of the time between two contacts of a ball by which one step may shorten it.
MAX_SHORTENING = 0.7
# m by which paths of a final solution may jump at contacts: the bend of a path, extrapolated from both sides, is at its
# contact.
CONTINUITY = 2e-5
# The covariance before it is evaluated.
NO_COVARIANCE = np.empty((0, 0))
# The search converges after two steps that gain little, the second one with updated standard deviations.
SEARCH = SearchOptions(
    iterations=30, attempts=8, min_gain=MIN_COST_DECREASE, min_relative_gain=1e-5, quiet_steps=2,
    min_iterations=SIGMA_UPDATE_INTERVAL + 2, raising_offset=1e-4, largest_damping=1e8,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Linearization:
    """Parameters with their residuals and derivatives."""

    parameters: FitParameters
    reference: FitParameters
    """Parameters that the standard deviations belong to which depend on speeds."""
    residual: FloatArray
    """(2K + M,) in standard deviations: of the observations, then of the priors."""
    jacobian: FloatArray
    columns: IntArray
    """(K, 2, 11) and (K, 11): derivatives of the observations, and their columns among the P; -1 for none."""
    priors: PriorRows
    """Pseudo-observations of physics and priors."""
    weight: FloatArray
    """(2K + M,) of the rows, by the robust loss."""
    cost: float


def refine_graph(
    graph: ContactGraph,
    observations: Observations,
    table: Table,
    iterations: int = 30,
    initial: JointSolution | None = None,
    fixed_contacts: Sequence[int] = (),
    continuity_sigma: float = SEARCH_CONTINUITY,
) -> JointSolution:
    """Refine the states, contact times and coefficients of a contact graph.

    Args:
        graph: Graph with initial states and times.
        observations: K observations.
        iterations: Largest number of iterations.
        initial: Solution with the initial coefficients; the priors by default.
        fixed_contacts: Contacts that keep their times.
        continuity_sigma: m by which paths may jump at contacts.

    Returns:
        The best-fitting solution, without covariance.
    """
    cloth = ClothFriction(SLIDING_PRIOR[0], ROLLING_PRIOR[0])
    initial = initial or JointSolution(graph, cloth, 1.0, np.zeros(4), RUBBER_PRIOR.copy(), np.inf, NO_COVARIANCE)
    arrays, parameters = build_graph_arrays(graph, continuity_sigma), extract_parameters(initial, graph)
    fixed = arrays.first_contact + np.array(fixed_contacts, np.int64)
    first = _linearize_fit(arrays, parameters, observations, table, parameters)

    def move(now: _Linearization, step: FloatArray) -> tuple[_Linearization, float] | None:
        trial = _apply_step(arrays, now.parameters, step)
        if not _has_valid_order(arrays, trial.t):
            return None
        moved = _linearize_fit(arrays, trial, observations, table, now.reference)
        return moved, moved.cost

    def update_sigmas(now: _Linearization, cost: float, iteration: int, is_quiet: bool) -> tuple[_Linearization, float]:
        if is_quiet or iteration % SIGMA_UPDATE_INTERVAL == SIGMA_UPDATE_INTERVAL - 1:
            now = _linearize_fit(arrays, now.parameters, observations, table, now.parameters)
        return now, now.cost

    def is_negligible(now: _Linearization, equations: NormalEquations, step: FloatArray) -> bool:
        gain = -float(equations.gradient @ step)
        return gain < MIN_COST_DECREASE / 10 and now.reference is now.parameters

    best = minimize_cost(
        first,
        first.cost,
        lambda now: _hold_parameters(_build_normal_equations(now, arrays.size), fixed),
        solve_normal_equations,
        move,
        replace(SEARCH, iterations=iterations),
        is_negligible=is_negligible,
        refresh=update_sigmas,
    )
    refined = apply_parameters(initial, graph, best.point.parameters)
    return replace(refined, chi2=best.cost, covariance=NO_COVARIANCE)


def add_covariance(solution: JointSolution, observations: Observations, table: Table) -> JointSolution:
    """Add the covariance of all parameters to a refined solution.

    Args:
        solution: A refined solution.
        observations: K observations.

    Returns:
        The solution with its covariance (P, P).
    """
    arrays = build_graph_arrays(solution.graph, CONTINUITY)
    parameters = extract_parameters(solution, solution.graph)
    linear = _linearize_fit(arrays, parameters, observations, table, parameters)
    normal = _build_normal_equations(linear, arrays.size).normal
    return replace(solution, covariance=solve_damped(normal, np.eye(arrays.size), 0.0, lower=True))


def condition_on_contact_times(
    solution: JointSolution, times: Mapping[int, tuple[float, float]], observations: Observations, table: Table
) -> JointSolution:
    """Replace the distribution of some contact times, or of none; all other parameters follow.

    The times are given, not combined with those of the solution: they may come from the same observations. All other
    parameters are refined between the contacts held in time, so that paths stay continuous.

    Args:
        times: Time of each contact and its standard deviation, s, by the number of the contact.
        observations: K observations.

    Returns:
        The solution with its covariance; times between which a segment would not last stay as they are.
    """
    arrays = build_graph_arrays(solution.graph, CONTINUITY)
    parameters = extract_parameters(solution, solution.graph)
    while True:
        t = parameters.t.copy()
        t[list(times)] = [time for time, _ in times.values()]
        is_short = end_times(arrays, t) <= start_times(arrays, t) + SHORTEST_SEGMENT
        limits = {*arrays.start[is_short].tolist(), *arrays.end[is_short].tolist()}
        if not limits & times.keys():
            break
        times = {number: time for number, time in times.items() if number not in limits}
    moved = apply_parameters(solution, solution.graph, parameters._replace(t=t))
    refined = refine_graph(moved.graph, observations, table, 30, moved, list(times), CONTINUITY)
    free = add_covariance(refined, observations, table).covariance
    columns = arrays.first_contact + np.array(list(times), np.int64)
    block = free[np.ix_(columns, columns)]
    gain = free[:, columns] @ np.linalg.inv(block)
    variance = np.diag([sigma**2 for _, sigma in times.values()])
    return replace(refined, covariance=free - gain @ (block - variance) @ gain.T)


def _build_normal_equations(linear: _Linearization, size: int) -> NormalEquations:
    """Build the normal equations of P = `size` parameters."""
    normal, gradient, rows = np.zeros((size, size)), np.zeros(size), linear.priors
    _add_prior_rows(rows.residual, rows.derivative, rows.column, rows.first, normal, gradient)
    _add_observation_rows(linear.jacobian, linear.columns, linear.residual, linear.weight, normal, gradient)
    return NormalEquations(normal, gradient)


def _hold_parameters(equations: NormalEquations, fixed: IntArray) -> NormalEquations:
    """Keep some parameters as they are: their step is zero."""
    normal, gradient = equations.normal.copy(), equations.gradient.copy()
    normal[fixed], normal[:, fixed], gradient[fixed] = 0.0, 0.0, 0.0
    normal[fixed, fixed] = 1.0
    return NormalEquations(normal, gradient)


@compile_kernel
def _add_prior_rows(residual, derivative, column, first, normal, gradient):  # type: ignore[no-untyped-def]
    """Add the pseudo-observations, see `pseudo_observations.PriorRows`, to the normal equations."""
    for row in range(len(residual)):
        for i in range(first[row], first[row + 1]):
            gradient[column[i]] += derivative[i] * residual[row]
            for j in range(first[row], first[row + 1]):
                normal[column[i], column[j]] += derivative[i] * derivative[j]


@compile_kernel
def _add_observation_rows(jacobian, columns, residual, weight, normal, gradient):  # type: ignore[no-untyped-def]
    """Add the first 2K rows: observations, Jacobian (K, 2, C) at columns (K, C), negative if unused."""
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
        share, is_shortened = np.ones(len(moves)), False
        for k in range(len(start)):
            if arrays.end[k] == NONE:
                continue
            duration = end[k] - start[k]
            approach = -moves[arrays.end[k]]
            if arrays.start[k] != NONE:
                approach += moves[arrays.start[k]]
            room = max(min(MAX_SHORTENING * duration, duration - 2 * SHORTEST_SEGMENT), 0.0)
            if approach > room + 1e-9:
                is_shortened = True
                share[arrays.end[k]] = min(share[arrays.end[k]], 0.9 * room / approach)
                if arrays.start[k] != NONE:
                    share[arrays.start[k]] = min(share[arrays.start[k]], 0.9 * room / approach)
        if not is_shortened:
            return
        for k in range(len(moves)):
            moves[k] *= share[k]


def _has_valid_order(arrays: GraphArrays, t: FloatArray) -> bool:
    """Return whether all segments last."""
    return bool(np.all(end_times(arrays, t) > start_times(arrays, t) + SHORTEST_SEGMENT))


def _linearize_fit(
    arrays: GraphArrays, parameters: FitParameters, observations: Observations, table: Table, reference: FitParameters
) -> _Linearization:
    """Evaluate whitened residuals, their derivatives and loss: observations first, then physics and priors.

    Standard deviations that depend on speeds are taken from `reference`, so that the costs of steps are comparable.
    """
    residual, jacobian, columns = _linearize_observations(
        arrays, parameters, observations.ball, observations.t, observations.xy, observations.whiten
    )
    rows = evaluate_priors(arrays, parameters, reference, table)
    residual = np.concatenate([residual, rows.residual])
    weight, cost = evaluate_pair_loss(residual, 2 * len(observations.t))
    return _Linearization(parameters, reference, residual, jacobian, columns, rows, weight, cost)


@compile_kernel
def _linearize_observations(arrays, parameters, ball, t, xy, whiten):  # type: ignore[no-untyped-def]
    """Evaluate whitened residuals (2K,), derivatives (K, 2, 11) and columns (K, 11), NONE where there is none."""
    start = start_times(arrays, parameters.t)
    owner = assign_sorted_observations(arrays.ball, start, ball, t)
    residual, jacobian = np.empty(2 * len(t)), np.zeros((len(t), 2, SEGMENT_STATE_SIZE + 3))
    columns = np.full((len(t), SEGMENT_STATE_SIZE + 3), NONE)
    slide_end, slide_derivative = np.empty(7), np.empty((7, SEGMENT_STATE_SIZE + 3))
    value, derivative = np.empty(6), np.zeros((6, SEGMENT_STATE_SIZE + 3))
    sliding, rolling = parameters.shared[SLIDING_COLUMN], parameters.shared[ROLLING_COLUMN]
    for row in range(len(t)):  # loops over numbers: whole rows would take several times as long to compile
        k, w = owner[row], whiten[row]
        size = 2 if arrays.static[k] else SEGMENT_STATE_SIZE
        if arrays.static[k]:  # most balls rest most of the time
            for axis in range(2):
                value[axis] = parameters.state[k, axis]
                for i in range(SEGMENT_STATE_SIZE + 3):
                    derivative[axis, i] = 1.0 if i == axis else 0.0
        else:
            state, tau = parameters.state[k], t[row] - start[k]
            differentiate_segment(state, tau, sliding, rolling, slide_end, slide_derivative, value, derivative)
            for axis in range(2):
                derivative[axis, SEGMENT_STATE_SIZE] *= -1  # a later start is a shorter time since
                columns[row, SEGMENT_STATE_SIZE + 1 + axis] = arrays.first_shared + axis
            if arrays.start[k] != NONE:
                columns[row, SEGMENT_STATE_SIZE] = arrays.first_contact + arrays.start[k]
        for i in range(size):
            columns[row, i] = arrays.column[k] + i
        x, y = value[0] - xy[row, 0], value[1] - xy[row, 1]
        for axis in range(2):
            residual[2 * row + axis] = w[axis, 0] * x + w[axis, 1] * y
            for i in range(SEGMENT_STATE_SIZE + 3):
                jacobian[row, axis, i] = w[axis, 0] * derivative[0, i] + w[axis, 1] * derivative[1, i]
    return residual, jacobian, columns
