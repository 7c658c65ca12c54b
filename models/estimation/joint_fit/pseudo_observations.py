"""Physics priors of the joint fit: pseudo-observations with realistic standard deviations.

Real cushions and cloths obey no single law: paths are continuous, balls touch at two radii, cushions at one, equal
masses share momentum, spin survives a contact with another ball, and coefficients are typical of tables.

Usual values and widths of the coefficients of friction and restitution are in `models/physics/effects/`, one file per
effect: cloth/sliding_friction.py, cloth/rolling_resistance.py, contacts/ball_restitution.py,
contacts/cushion_restitution.py; the width of nose offsets is in `models/physics/billiards/tables.py`. All else, such as
how far real contacts scatter about the laws, stands here; the test of a single contact has friction widths of its own,
`BALL_FRICTION, CUSHION_FRICTION` in `models.estimation.contact_test.contact_probability`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.contact_graph import SEGMENT_STATE_SIZE, SHARED_COUNT
from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_solution import (
    BALL,
    BREAK,
    CUSHION,
    DIAMETER_COLUMN,
    FREE,
    JUMP,
    NONE,
    NOSE_COLUMN,
    ROLLING_COLUMN,
    RUBBER_COLUMN,
    SLIDING_COLUMN,
    STRIKE,
    FitParameters,
    GraphArrays,
    end_times,
    start_times,
)
from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.closed_form_motion import differentiate_segment
from models.physics.billiards.tables import NOSE_SIGMA
from models.physics.effects.billiards_catalogue import find_prior

_PRIORS = {
    name: find_prior(name, parameter)
    for name, parameter in (
        ("sliding_friction", "mu"),
        ("rolling_resistance", "mu"),
        ("ball_restitution", "e"),
        ("cushion_restitution", "e"),
    )
}
# Mean and standard deviation: of the logarithm for friction, of the coefficient itself for restitution.
SLIDING_PRIOR, ROLLING_PRIOR, BALL_RESTITUTION, CUSHION_RESTITUTION = ((p.value, p.sigma) for p in _PRIORS.values())
BALL_RESTITUTION_MEAN, BALL_RESTITUTION_SIGMA = BALL_RESTITUTION
# Relative: one factor per clip on the distance of touching balls, for calibration errors.
DIAMETER_SIGMA = 0.02
# s: how far a jump may move in one step; the time at which a ball leaves a break is fixed.
JUMP_SIGMA, BREAK_SIGMA = 0.01, 1e-6
# m/s: errors are not smaller for slower contacts.
MIN_HIT_SPEED = 0.02
# m: scatter of the distance of touching balls.
TOUCH_SIGMA = 8e-4
# m: balls that lie beside each other are driven apart, so that their distance hardly constrains the diameter.
RACK_GAP = 2e-3
# Standard deviations beyond which a contact distance counts less, and the largest inflation of its sigma: a pair that
# never met must neither resize all balls nor be accepted where it lies far apart.
TOUCH_HUBER, MAX_TOUCH_INFLATION = 2.5, 2.0
RUBBER_PRIOR = np.array([CUSHION_RESTITUTION[0], 0.0, 0.5])
# Restitution, its change with speed (s/m), grip: between a nose that slips and one that sticks. In Mathavan 2010 the
# nose sticks, so that a ball leaves with a slip of its speed of arrival, whatever its spin; in a mirror law it slips.
RUBBER_SIGMA = np.array([CUSHION_RESTITUTION[1], 0.04, 0.5])
# Share of the speed into the cushion: difference of published laws with these three coefficients.
RESTITUTION_SCATTER, SPIN_SCATTER = 0.03, 0.12
# m: scatter of the contact line of a nose.
NOSE_SCATTER = 1.5e-3

# m/s^2 per axis: slope, nap and drag, per segment.
EXTRA_ACCELERATION_SIGMA = 0.02
# Slip of a ball that begins to move for an unknown cause: share of its speed, and m/s.
UNEXPLAINED_SLIP_SIGMA = 0.7, 0.2
# Standard deviation of the slip after a strike, about that of a ball hit in its middle: share of the speed along the
# path and across it, and m/s. A central hit gives no spin, so that the ball slips with all its velocity; a hit a fifth
# of a radius above or below takes or adds half of that. Across the path only a raised cue makes a ball slip (Coriolis
# 1835).
STRUCK_SLIP, SWERVE_SLIP, LEAST_SLIP = 0.5, 0.25, 0.1
# m/s: prior standard deviation of a velocity.
_VELOCITY_SIGMA = 5.0

# Standard deviations of the shared parameters, in their order.
SHARED_SIGMA = np.array([SLIDING_PRIOR[1], ROLLING_PRIOR[1], DIAMETER_SIGMA, *[NOSE_SIGMA] * 4, *RUBBER_SIGMA])
# Most rows of one contact.
MAX_ROWS = 15
# Most parameters that one of these rows depends on: four segments, three contacts and the shared ones.
MAX_PARAMETERS = 48


@dataclass(frozen=True, slots=True)
class PriorRows:
    """M pseudo-observations in standard deviations, and their sparse derivatives by P parameters, row by row."""

    residual: FloatArray
    """(M,)"""
    derivative: FloatArray
    """(E,) derivatives of all rows, one after the other."""
    column: IntArray
    """(E,) parameter of each derivative."""
    first: IntArray
    """(M + 1,) first entry of each row."""


def evaluate_priors(
    arrays: GraphArrays, parameters: FitParameters, reference: FitParameters, table: Table
) -> PriorRows:
    """Evaluate the priors of a contact graph.

    Args:
        arrays: The contact graph.
        parameters: Parameters at which the priors are evaluated.
        reference: Parameters that the standard deviations belong to which depend on speeds.

    Returns:
        The rows of pseudo-observations.
    """
    shared_deviation = parameters.shared - np.array([0.0, 0.0, 1.0, *np.zeros(4), *RUBBER_PRIOR])
    shared_deviation[:DIAMETER_COLUMN] = np.log(
        parameters.shared[:DIAMETER_COLUMN] / [SLIDING_PRIOR[0], ROLLING_PRIOR[0]]
    )
    size = np.array([table.length, table.width, table.ball_radius])
    return PriorRows(*evaluate_prior_rows(arrays, parameters, reference, size, shared_deviation / SHARED_SIGMA))


@compile_kernel
def evaluate_prior_rows(arrays, parameters, reference, table, shared_deviation):  # type: ignore[no-untyped-def]
    """Evaluate the fields of `PriorRows`.

    Args:
        arrays: The contact graph.
        parameters: As of `evaluate_priors`.
        reference: As of `evaluate_priors`.
        table: (3,) length, width and ball radius, m.
        shared_deviation: (10,) normalized deviation of the shared parameters from their priors.

    Returns:
        Residual, derivative, column and first entry of each row.
    """
    segment_count, contact_count = len(arrays.ball), len(arrays.kind)
    max_rows = MAX_ROWS * contact_count + 6 * segment_count + SHARED_COUNT
    max_entries = MAX_ROWS * contact_count * MAX_PARAMETERS + 12 * segment_count + SHARED_COUNT
    output = (
        np.empty(max_rows),
        np.empty(max_entries),
        np.empty(max_entries, np.int64),
        np.zeros(max_rows + 1, np.int64),
    )
    end, jacobian = evaluate_end_states(arrays, parameters)
    reference_end, _ = evaluate_end_states(arrays, reference)
    count = np.int64(0)
    workspace = (
        np.empty(MAX_ROWS), np.empty(MAX_ROWS), np.zeros((MAX_ROWS, 2, 6)), np.zeros((MAX_ROWS, 2, SEGMENT_STATE_SIZE)),
        np.zeros((MAX_ROWS, SHARED_COUNT)),
    )  # fmt: skip
    for contact in range(contact_count):
        rows = _write_contact_rows(arrays, contact, parameters, end, reference, reference_end, table, workspace)
        count = _append_contact_rows(arrays, contact, rows, workspace, jacobian, output, count)
    for segment in range(segment_count):
        if not arrays.static[segment]:
            count = _append_segment_priors(
                arrays, segment, parameters.state[segment], reference.state[segment], output, count
            )
    for k in range(SHARED_COUNT):
        count = _append_prior_row(output, count, shared_deviation[k], arrays.first_shared + k, 1 / SHARED_SIGMA[k])
    entries = output[3][count]
    values, derivatives, columns, firsts = output
    return values[:count].copy(), derivatives[:entries].copy(), columns[:entries].copy(), firsts[: count + 1].copy()


@compile_kernel
def evaluate_end_states(arrays, parameters):  # type: ignore[no-untyped-def]
    """Evaluate states (S, 6) of segments at their ends, and the derivatives (S, 6, 11) of the moving ones."""
    start, end = start_times(arrays, parameters.t), end_times(arrays, parameters.t)
    end_state, jacobian = np.zeros((len(start), 6)), np.zeros((len(start), 6, SEGMENT_STATE_SIZE + 3))
    slide_end, slide_derivative = np.empty(7), np.empty((7, SEGMENT_STATE_SIZE + 3))
    sliding, rolling = parameters.shared[SLIDING_COLUMN], parameters.shared[ROLLING_COLUMN]
    for k in range(len(start)):
        if arrays.static[k] or arrays.end[k] == NONE:
            for axis in range(2):  # a whole row would take several times as long to compile
                end_state[k, axis] = parameters.state[k, axis]
        else:
            state, tau = parameters.state[k], end[k] - start[k]
            differentiate_segment(state, tau, sliding, rolling, slide_end, slide_derivative, end_state[k], jacobian[k])
    return end_state, jacobian


# Places of velocity and slip in the state of a segment, and the only ball of a contact with a cushion.
_VELOCITY, _SLIP, _FIRST_BALL = map(np.int64, (2, 4, 0))


@compile_kernel
def _write_contact_rows(arrays, c, parameters, end, reference, reference_end, table, workspace):  # type: ignore[no-untyped-def]
    """Write the priors of one contact as rows of `workspace` and return their number.

    These are values, standard deviations, and derivatives by the ends (rows, 2, 6) and starts (rows, 2, 8) of the
    segments of its balls and by the shared parameters (rows, 10).
    """
    value, sigma, by_end, by_start, by_shared = workspace
    by_end.fill(0.0)
    by_start.fill(0.0)
    by_shared.fill(0.0)
    if arrays.kind[c] == JUMP or arrays.kind[c] == BREAK:  # no other row constrains the time of a jump
        value[0], sigma[0] = parameters.t[c] - reference.t[c], JUMP_SIGMA if arrays.kind[c] == JUMP else BREAK_SIGMA
        return _write_break_exit_rows(arrays, c, parameters, workspace) if arrays.kind[c] == BREAK else 1
    rows = np.int64(0)
    for ball in range(2):
        if arrays.before[c, ball] != NONE:
            for axis in range(2):
                by_end[rows, ball, axis], by_start[rows, ball, axis] = 1.0, -1.0
                sigma[rows] = arrays.continuity_sigma
                rows += 1
    offset = np.zeros(MAX_ROWS)
    if arrays.kind[c] == BALL:
        rows = _write_ball_contact_rows(arrays, c, parameters, reference, reference_end, table, workspace, offset, rows)
    elif arrays.kind[c] == CUSHION:
        rows = _write_cushion_rows(arrays, c, parameters, end, reference, reference_end, table, workspace, offset, rows)
    elif arrays.pushed[c]:
        hit = np.hypot(reference.state[arrays.after[c, 0], 2], reference.state[arrays.after[c, 0], 3])
        rows = _write_spin_rows(workspace, rows, _FIRST_BALL, hit)
    for row in range(rows):
        value[row] = offset[row]
        for ball in range(2):
            if arrays.before[c, ball] != NONE:
                for k in range(6):
                    value[row] += by_end[row, ball, k] * end[arrays.before[c, ball], k]
                for k in range(SEGMENT_STATE_SIZE):
                    value[row] += by_start[row, ball, k] * parameters.state[arrays.after[c, ball], k]
    return rows


@compile_kernel
def _write_break_exit_rows(arrays, c, parameters, workspace):  # type: ignore[no-untyped-def]
    """Write the rows of a ball that leaves a break in its simulated state."""
    value, sigma, _, by_start, _ = workspace
    state = parameters.state[arrays.after[c, 0]]
    for row in range(6):
        value[row + 1], sigma[row + 1] = 0.0, 1.0
        for k in range(6):
            by_start[row + 1, 0, k] = arrays.whiten[c, row, k]
            value[row + 1] += arrays.whiten[c, row, k] * (state[k] - arrays.leaves[c, k])
    return 7


@compile_kernel
def _write_ball_contact_rows(arrays, c, parameters, reference, reference_end, table, workspace, offset, row):  # type: ignore[no-untyped-def]
    """Write the rows of two balls: distance, momentum, restitution, little friction, spin that survives."""
    _, sigma, by_end, by_start, by_shared = workspace
    line, reach = _line_of_centres(arrays, c, parameters.state), 2 * table[2]
    for axis in range(2):
        by_start[row, 1, axis], by_start[row, 0, axis] = line[axis], -line[axis]
    by_shared[row, DIAMETER_COLUMN] = -reach
    offset[row] = -reach * parameters.shared[DIAMETER_COLUMN]
    sigma[row] = RACK_GAP if arrays.driven[c] else _contact_distance_sigma(arrays, c, reference, reach)
    row += 1
    if arrays.driven[c]:
        return row
    n, one, two = _line_of_centres(arrays, c, reference.state), arrays.before[c, 0], arrays.before[c, 1]
    x, y = reference_end[one, 2] - reference_end[two, 2], reference_end[one, 3] - reference_end[two, 3]
    hit = max(abs(x * n[0] + y * n[1]), MIN_HIT_SPEED)
    for axis in range(2):  # momentum
        for ball in range(2):
            by_start[row, ball, 2 + axis], by_end[row, ball, 2 + axis] = 1.0, -1.0
        sigma[row] = 0.03 * hit + 0.01
        row += 1
    for axis in range(2):  # restitution
        by_start[row, 1, 2 + axis], by_start[row, 0, 2 + axis] = n[axis], -n[axis]
        for ball in range(2):
            by_end[row, ball, 2 + axis] = BALL_RESTITUTION_MEAN * by_start[row, ball, 2 + axis]
    sigma[row] = BALL_RESTITUTION_SIGMA * hit + 0.01
    row += 1
    for ball in range(2):
        _add_state_change(workspace, row, ball, _VELOCITY, (-n[1], n[0]))
        sigma[row] = 0.06 * hit + 0.01
        row = _write_spin_rows(workspace, row + 1, ball, hit)
    return row


@compile_kernel
def _contact_distance_sigma(arrays, c, reference, reach):  # type: ignore[no-untyped-def]
    """Return the sigma of the distance of two balls at a contact, m; it grows as for a linear loss."""
    x = reference.state[arrays.after[c, 1], 0] - reference.state[arrays.after[c, 0], 0]
    y = reference.state[arrays.after[c, 1], 1] - reference.state[arrays.after[c, 0], 1]
    deviation = abs(np.hypot(x, y) - reach * reference.shared[DIAMETER_COLUMN]) / (TOUCH_HUBER * TOUCH_SIGMA)
    return TOUCH_SIGMA * min(np.sqrt(max(deviation, 1.0)), MAX_TOUCH_INFLATION)


@compile_kernel
def _write_spin_rows(workspace, row, ball, hit):  # type: ignore[no-untyped-def]
    """Write the rows of a ball hit by another at `hit` m/s: it keeps its spin, so slip changes as velocity does."""
    for axis in range(2):
        _add_spin_change(workspace, row, ball, (1.0 - axis, 0.0 + axis))
        workspace[1][row] = 0.12 * hit + 0.03
        row += 1
    return row


@compile_kernel
def _add_spin_change(workspace, row, ball, along):  # type: ignore[no-untyped-def]
    """Add the derivatives of the spin change, i.e. of the slip change minus the velocity change, along a direction."""
    _add_state_change(workspace, row, ball, _SLIP, along)
    _add_state_change(workspace, row, ball, _VELOCITY, (-along[0], -along[1]))


@compile_kernel
def _add_state_change(workspace, row, ball, part, along):  # type: ignore[no-untyped-def]
    """Add the derivatives of a change of `_VELOCITY` or `_SLIP` at a contact, along a direction."""
    for axis in range(2):
        workspace[3][row, ball, part + axis] += along[axis]
        workspace[2][row, ball, part + axis] -= along[axis]


@compile_kernel
def _write_cushion_rows(arrays, c, parameters, end, reference, reference_end, table, workspace, offset, row):  # type: ignore[no-untyped-def]
    """Write the rows of a cushion contact: distance, restitution, some friction, spin that partly survives."""
    _, sigma, by_end, by_start, by_shared = workspace
    side, before = arrays.side[c], arrays.before[c, 0]
    axis, inward = side // 2, 1.0 - 2.0 * (side % 2)
    n = (inward, 0.0) if axis == 0 else (0.0, inward)
    tangent = (-n[1], n[0])
    by_start[row, 0, axis], by_shared[row, NOSE_COLUMN + side] = inward, -1.0
    offset[row] = (table[axis] if side % 2 else 0.0) - table[2] - parameters.shared[NOSE_COLUMN + side]
    sigma[row] = NOSE_SCATTER
    row += 1
    hit = max(-inward * reference_end[before, 2 + axis], MIN_HIT_SPEED)
    speed = np.hypot(reference_end[before, 2], reference_end[before, 3])
    rubber = parameters.shared[RUBBER_COLUMN:]
    e, restitution_slope, grip = rubber[0], rubber[1], rubber[2]
    approach_speed = inward * end[before, 2 + axis]
    by_start[row, 0, 2 + axis], by_end[row, 0, 2 + axis] = inward, (e + restitution_slope * hit) * inward
    by_shared[row, RUBBER_COLUMN], by_shared[row, RUBBER_COLUMN + 1] = approach_speed, approach_speed * hit
    sigma[row] = RESTITUTION_SCATTER * hit + 0.02
    row += 1
    _add_state_change(workspace, row, _FIRST_BALL, _VELOCITY, tangent)
    sigma[row] = 0.25 * speed + 0.02
    row += 1
    _add_spin_change(workspace, row, _FIRST_BALL, n)
    restitution = reference.shared[RUBBER_COLUMN]
    # the slip that a sticking nose would stop
    stopped_slip = inward * (end[before, 4 + axis] - restitution * end[before, 2 + axis])
    by_end[row, 0, 4 + axis] += grip * inward
    by_end[row, 0, 2 + axis] -= grip * restitution * inward
    by_shared[row, RUBBER_COLUMN + 2] = stopped_slip
    sigma[row] = SPIN_SCATTER * hit + 0.05 * speed + 0.03
    row += 1
    _add_spin_change(workspace, row, _FIRST_BALL, tangent)
    sigma[row] = 0.2 * hit + 0.05 * speed + 0.05
    return row + 1


@compile_kernel
def _line_of_centres(arrays, c, state):  # type: ignore[no-untyped-def]
    """Return the direction from the first ball to the second at a contact."""
    x = state[arrays.after[c, 1], 0] - state[arrays.after[c, 0], 0]
    y = state[arrays.after[c, 1], 1] - state[arrays.after[c, 0], 1]
    apart = max(np.hypot(x, y), 1e-9)
    return x / apart, y / apart


@compile_kernel
def _append_contact_rows(arrays, c, rows, workspace, jacobian, output, count):  # type: ignore[no-untyped-def]
    """Append the rows of a contact, by all parameters, to the output; return the new number of rows."""
    value, sigma, by_end, by_start, by_shared = workspace
    for row in range(rows):
        s = sigma[row]
        output[0][count] = value[row] / s
        position = output[3][count]
        shared, time_derivative = by_shared[row], 0.0
        for ball in range(2):
            before, after = arrays.before[c, ball], arrays.after[c, ball]
            if before == NONE:
                continue
            first = arrays.column[before]
            if arrays.static[before]:
                for k in range(2):
                    position = _append_derivative(output, position, first + k, by_end[row, ball, k] / s)
            else:
                for k in range(SEGMENT_STATE_SIZE + 3):
                    derivative = 0.0
                    for j in range(6):
                        derivative += by_end[row, ball, j] * jacobian[before, j, k]
                    if k < SEGMENT_STATE_SIZE:
                        position = _append_derivative(output, position, first + k, derivative / s)
                    elif k > SEGMENT_STATE_SIZE:
                        shared[k - SEGMENT_STATE_SIZE - 1] += derivative
                    else:  # a later contact lengthens the segment, a later start shortens it
                        time_derivative += derivative
                        if arrays.start[before] != NONE:
                            column = arrays.first_contact + arrays.start[before]
                            position = _append_derivative(output, position, column, -derivative / s)
            for k in range(2 if arrays.static[after] else SEGMENT_STATE_SIZE):
                position = _append_derivative(output, position, arrays.column[after] + k, by_start[row, ball, k] / s)
        if row == 0 and (arrays.kind[c] == JUMP or arrays.kind[c] == BREAK):
            time_derivative = 1.0
        position = _append_derivative(output, position, arrays.first_contact + c, time_derivative / s)
        for k in range(SHARED_COUNT):
            position = _append_derivative(output, position, arrays.first_shared + k, shared[k] / s)
        count += 1
        output[3][count] = position
    return count


@compile_kernel
def _append_segment_priors(arrays, segment, state, reference_state, output, count):  # type: ignore[no-untyped-def]
    """Append the priors of slip, extra acceleration and velocity; those of slip after a contact are in its rows."""
    start, column = arrays.start[segment], arrays.column[segment]
    speed = np.hypot(reference_state[2], reference_state[3])
    if start == NONE or arrays.kind[start] in (FREE, JUMP, BREAK):
        for k in (4, 5):
            sigma = UNEXPLAINED_SLIP_SIGMA[0] * speed + UNEXPLAINED_SLIP_SIGMA[1]
            count = _append_prior_row(output, count, state[k] / sigma, column + k, 1 / sigma)
    elif arrays.kind[start] == STRIKE and not arrays.pushed[start]:
        count = _append_strike_priors(state, reference_state, column, output, count)
    for k in (2, 3, 6, 7):
        sigma = _VELOCITY_SIGMA if k < 4 else EXTRA_ACCELERATION_SIGMA
        count = _append_prior_row(output, count, state[k] / sigma, column + k, 1 / sigma)
    return count


@compile_kernel
def _append_strike_priors(state, reference_state, column, output, count):  # type: ignore[no-untyped-def]
    """Append the prior of slip after a strike: equal to the velocity, uncertain along the path, hardly across it."""
    speed = np.hypot(reference_state[2], reference_state[3])
    direction = (reference_state[2] / speed, reference_state[3] / speed) if speed > 0 else (1.0, 0.0)
    for share, (x, y) in ((STRUCK_SLIP, direction), (SWERVE_SLIP, (-direction[1], direction[0]))):
        sigma = share * speed + LEAST_SLIP
        output[0][count] = ((state[4] - state[2]) * x + (state[5] - state[3]) * y) / sigma
        position = output[3][count]
        for k, component in ((4, x), (5, y), (2, -x), (3, -y)):
            position = _append_derivative(output, position, column + k, component / sigma)
        count += 1
        output[3][count] = position
    return count


@compile_kernel
def _append_prior_row(output, count, value, column, derivative):  # type: ignore[no-untyped-def]
    """Append a row that depends on one parameter only."""
    output[0][count] = value
    output[3][count + 1] = _append_derivative(output, output[3][count], column, derivative)
    return count + 1


@compile_kernel
def _append_derivative(output, position, column, derivative):  # type: ignore[no-untyped-def]
    """Append one derivative to the current row if it is not zero."""
    if derivative != 0.0:
        output[1][position], output[2][position] = derivative, column
        position += 1
    return position
