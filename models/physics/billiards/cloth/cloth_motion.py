"""Motion of one ball on the cloth as pieces that are polynomials in time: it slides, rolls, rests.

A sliding ball feels friction mu g against its slip u (the velocity of the point that touches the cloth), which also
changes the slip: u' = -7/2 mu g u/|u|, a constant direction, so the path is a parabola (Marlow 1995, The Physics of
Pocket Billiards). When the slip is 0 the ball rolls straight on, decelerates at mu_r g, and stops. Side spin decays at
a constant rate in every phase, and does not act on the path. All this has a closed form.

The accelerations by all effects are in `forces.py`, that of side spin in `motion_pieces.py`; here are the paths that
follow from them.

Three more effects act on the centre of a moving ball. The paths under slope and drag are integrated,
and so are those under the generic law of the cloth, see `models.physics.effects.cloth.cloth_force`.
Slope: g s, of which a rolling ball spends 2/7 on rotation; a ball at rest stays while rolling resistance exceeds it.
Drag: -k v v and -k v. Nap, the direction of the cloth's fibres towards +x, needs no integration: a ball that rolls at
an angle a to it decelerates at (mu_r - nap cos a) g. Without sliding friction slip has no effect: every ball then moves
as one that rolls, and keeps its spin.

Arguments that the functions share: s (7,) is x, y (m), vx, vy (m/s), wx, wy (rad/s) and the clock (s), changed in
place; radius in m; p (P,) physical parameters; rows (K, PIECE_WIDTH) and phases (K,) receive pieces, K as
`count_pieces` returns it; count is the number of those written so far.

Paths under slope and drag are integrated with steps of variable length. The method is 5(4) of Dormand and Prince (1980,
doi:10.1016/0771-050X(80)90013-3).

A rolling ball is integrated in time. A slip u that dies away turns ever faster in time, about as the logarithm of the
remaining slip, so a sliding ball is integrated in another variable. With k = 7/2 mu g, the acceleration b of slope and
drag at the centre, and s defined by dt = |u| ds, friction makes u' = -k u/|u| + b a nearly linear equation,
du/ds = -k u + b |u|. So with f = exp(-k s), the part of the slip that would remain on a level table, u = f U, where U
hardly changes; nor does r = 5/7 v + 2/7 R (wy, -wx) = v - 2/7 u, which friction does not affect. By 1 - f, from 0 to 1,

    dt = |U|/k,   dr = 5/7 b |U|/k,   dU = b |U| / (k f),   dx = (r + 2/7 f U) |U|/k,

all of which are smooth, in the derivatives too, except for the logarithm in U, whose weight f vanishes. Under a
constant b, k |u| + b.u falls at the rate k^2 - b^2, which gives the moment at which the slip ends.

Between two steps the place is the quintic with the integrated place, velocity and acceleration at both ends.

Arguments of the integration: m (8,) are the integrated numbers: place (2), r or velocity (2), U or spin (2), f
and the time; radius in m; p (P,) physical parameters; phase one of `motion_pieces`; h the step in 1 - f or s.
"""

from __future__ import annotations

import numpy as np

from models.core.constants import GRAVITY
from models.numerics.jit import COMPLEX_STEP, compile_kernel, copy_numbers, copy_rows
from models.physics.billiards.cloth.forces import (
    ROLLING_SHARE,
    contact_slip,
    downhill_slope,
    evaluate_state_rate,
    has_curved_path,
    rolling_deceleration,
    slope_and_drag,
    travel_direction,
)
from models.physics.billiards.cloth.motion_pieces import (
    CLOCK,
    GLIDE,
    PIECE_END,
    PIECE_START,
    PIECE_WIDTH,
    REST,
    REST_DURATION,
    ROLL,
    SLIDE,
    WX,
    WY,
    X,
    write_parabola,
)
from models.physics.billiards.parameter_vector import ROLLING_MU, SLIDING_MU

# m/s; a slip below this is rounding error of a ball that rolls.
SLIP_THRESHOLD = 1e-10
# s during which a ball that a slope sets in motion moves straight.
DOWNHILL_START_DURATION = 1e-4


@compile_kernel
def remove_remaining_slip(s, radius):  # type: ignore[no-untyped-def]
    """Set the slip to 0: friction at the cloth conserves the angular momentum about the point of contact."""
    ux, uy, _ = contact_slip(s, radius)
    s[2], s[3] = s[2] - 2.0 / 7.0 * ux, s[3] - 2.0 / 7.0 * uy
    s[4], s[5] = -s[3] / radius, s[2] / radius


@compile_kernel
def remaining_time(s, radius, p, phase):  # type: ignore[no-untyped-def]
    """Return how long (s) the ball goes on sliding or rolling at its present deceleration.

    `REST_DURATION` if it does not stop.
    """
    if phase == SLIDE:
        _, _, size = contact_slip(s, radius)
        return 2.0 / 7.0 * size / (p[SLIDING_MU] * GRAVITY)
    (hx, hy, speed), (sx, sy) = travel_direction(s[2], s[3]), downhill_slope(p)
    slow = rolling_deceleration(hx, p) - ROLLING_SHARE * GRAVITY * 1e-3 * (sx * hx + sy * hy)
    if slow.real * REST_DURATION <= speed.real:
        return 0.0 * speed + REST_DURATION
    return speed / slow


@compile_kernel
def complete_phase(s, radius, p, phase, horizon, rows, phases, count):  # type: ignore[no-untyped-def]
    """Move s to the end of a phase, by integration if an effect bends the path; return the number of pieces."""
    curves = has_curved_path(p)
    if curves:
        count = integrate_path(s, radius, p, phase, horizon, rows, phases, count)
    if s[CLOCK].real < horizon and not (curves and phase == SLIDE):
        rate = np.zeros(6, rows.dtype)
        evaluate_state_rate(s, radius, p, phase, rate)
        write_parabola(s, rate, remaining_time(s, radius, p, phase), phase, rows, phases, count)
        count += 1
    return count


@compile_kernel
def start_downhill(s, radius, p, phase, rows, phases, count):  # type: ignore[no-untyped-def]
    """Set a ball at rest in motion on a slope that exceeds rolling resistance; return the number of pieces."""
    sx, sy = downhill_slope(p)
    steep = np.sqrt(sx * sx + sy * sy)
    pull = (ROLLING_SHARE * 1e-3 * steep - p[ROLLING_MU]) * GRAVITY / steep
    rate = np.zeros(6, rows.dtype)
    rate[2], rate[3] = pull * sx, pull * sy
    if phase == ROLL:
        rate[4], rate[5] = -rate[3] / radius, rate[2] / radius
    write_parabola(s, rate, 0.0 * s[CLOCK] + DOWNHILL_START_DURATION, phase, rows, phases, count)
    return count + 1


@compile_kernel
def plan_motion(state, radius, p, horizon, rows, phases):  # type: ignore[no-untyped-def]
    """Plan the motion of a ball from a state.

    All arrays and numbers have the type of `rows`, float64 or complex128.

    Args:
        state: (7,) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s).
        radius: m.
        p: (P,) physical parameters.
        horizon: s; the last piece ends beyond it.
        rows: (K, PIECE_WIDTH) receives the pieces.
        phases: (K,) receives their phases.

    Returns:
        The number of pieces.
    """
    s = np.zeros(7, rows.dtype)
    copy_numbers(state[:6], s)
    count, phase = np.int64(0), ROLL
    size = contact_slip(s, radius)[2]
    if size.real > SLIP_THRESHOLD:
        phase = SLIDE if p[SLIDING_MU].real > 0.0 else GLIDE
    if phase == SLIDE:
        count = complete_phase(s, radius, p, SLIDE, horizon, rows, phases, count)
        phase = ROLL
    if p[SLIDING_MU].real > 0.0 and s[CLOCK].real < horizon:
        remove_remaining_slip(s, radius)
    sx, sy = downhill_slope(p)
    stays_at_rest = ROLLING_SHARE * 1e-3 * np.hypot(sx.real, sy.real) <= p[ROLLING_MU].real
    while s[CLOCK].real < horizon and count < len(rows) - 2:
        if travel_direction(s[2], s[3])[2].real > 0.0:
            count = complete_phase(s, radius, p, phase, horizon, rows, phases, count)
            s[2], s[3] = 0.0, 0.0
        elif p[ROLLING_MU].real > 0.0:
            s[2], s[3] = 0.0, 0.0
        if stays_at_rest or s[CLOCK].real >= horizon:
            break
        count = start_downhill(s, radius, p, phase, rows, phases, count)
    if s[CLOCK].real < horizon:
        if phase == ROLL:
            s[4], s[5] = -s[3] / radius, s[2] / radius
        write_parabola(s, np.zeros(6, rows.dtype), 0.0 * s[CLOCK] + REST_DURATION, REST, rows, phases, count)
        count += 1
    return count


# m and m/s, error of one step; the second one where derivatives are carried, and then also for their error times a unit
# change of the input.
TOLERANCE, DERIVATIVE_TOLERANCE = 3e-10, 1e-7
# m/s; below this speed rolling ends in closed form, because its direction may turn without bound.
STOPPING_SPEED = 1e-6
# m and m/s, error of a step that is much too long, as all are where drag outweighs a friction close to 0.
FAILED_STEP_ERROR = 1e30
# Indices of f and of the time in the integrated numbers.
_LEFT, _TIME = 6, 7


@compile_kernel
def _error_size(z):  # type: ignore[no-untyped-def]
    """Return the size of an error, or of the error of the derivative that it carries."""
    return max(abs(z.real), abs(z.imag) / COMPLEX_STEP)


@compile_kernel
def evaluate_rates(m, radius, p, phase, rate):  # type: ignore[no-untyped-def]
    """Write to rate (8,) the derivative of m by 1 - f while the ball slides, otherwise by time."""
    if phase != SLIDE:
        evaluate_state_rate(m, radius, p, phase, rate)
        rate[_LEFT], rate[_TIME] = 0.0, 1.0
        return
    k, size, left = 3.5 * p[SLIDING_MU] * GRAVITY, np.sqrt(m[4] * m[4] + m[5] * m[5]), m[_LEFT]
    vx, vy = m[2] + 2.0 / 7.0 * left * m[4], m[3] + 2.0 / 7.0 * left * m[5]
    bx, by = slope_and_drag(vx, vy, p)
    slow = size / k
    rate[0], rate[1], rate[2], rate[3] = vx * slow, vy * slow, 5.0 / 7.0 * bx * slow, 5.0 / 7.0 * by * slow
    rate[4], rate[5] = bx * slow / left, by * slow / left
    rate[_LEFT], rate[_TIME] = -1.0, slow


# Coefficients of the method: rows of stages, of which the last one is the result, and those of the error.
_STAGES = np.array([
    [1 / 5, 0, 0, 0, 0, 0],
    [3 / 40, 9 / 40, 0, 0, 0, 0],
    [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
    [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
    [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
    [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
])  # fmt: skip
_ERROR = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


@compile_kernel
def take_step(m, radius, p, phase, h, k, y):  # type: ignore[no-untyped-def]
    """Take one step from m to y (8,) with the rates k (7, 8), of which k[0] is given; return the error, m and m/s."""
    for stage in range(6):
        for i in range(8):  # loops over numbers: whole rows would take several times as long to compile
            total = 0.0 * m[i]
            for j in range(stage + 1):
                total += _STAGES[stage, j] * k[j, i]
            y[i] = m[i] + h * total
        evaluate_rates(y, radius, p, phase, k[stage + 1])
    worst = 0.0
    for i in range(8):
        miss = 0.0 * m[i]
        for j in range(7):
            miss += _ERROR[j] * k[j, i]
        scale = 1.0
        if 4 <= i < 6:
            scale = 2.0 / 7.0 * y[_LEFT].real if phase == SLIDE else radius.real
        size = scale * _error_size(h * miss)
        if not size < FAILED_STEP_ERROR:  # NaN too: numbers overflowed on the way
            return FAILED_STEP_ERROR
        worst = max(worst, size)
    return worst


@compile_kernel
def _evaluate_node(m, radius, p, phase, rate, end):  # type: ignore[no-untyped-def]
    """Write end (6, 2): place, velocity, acceleration, r and its rate while the ball slides, spin as (wy, -wx).

    `rate` (8,) is room to work in.
    """
    for i in range(2):
        end[0, i], end[1, i], end[3, i], end[4, i] = m[i], m[2 + i], m[2 + i], 0.0
    if phase != SLIDE:
        evaluate_state_rate(m, radius, p, phase, rate)
        end[2, 0], end[2, 1], end[5, 0], end[5, 1] = rate[2], rate[3], m[5], -m[4]
        return
    size = np.sqrt(m[4] * m[4] + m[5] * m[5])
    for i in range(2):
        end[1, i] = m[2 + i] + 2.0 / 7.0 * m[_LEFT] * m[4 + i]
    bx, by = slope_and_drag(end[1, 0], end[1, 1], p)
    end[4, 0], end[4, 1] = 5.0 / 7.0 * bx, 5.0 / 7.0 * by
    for i in range(2):
        end[2, i] = 1.4 * end[4, i] - p[SLIDING_MU] * GRAVITY / size * m[4 + i]
        end[5, i] = (3.5 * m[2 + i] - 2.5 * end[1, i]) / radius


@compile_kernel
def _interpolate_nodes(a, b, start, h, radius, phase, row):  # type: ignore[no-untyped-def]
    """Write to row the piece between two nodes (6, 2) of `_evaluate_node`, the second one h (s) after the first."""
    for k in range(PIECE_WIDTH):
        row[k] = 0.0
    row[PIECE_START], row[PIECE_END] = start, start + h
    for i in range(2):
        x = b[0, i] - a[0, i] - h * (a[1, i] + 0.5 * h * a[2, i])
        v = h * (b[1, i] - a[1, i] - h * a[2, i])
        bend = 0.5 * h * h * (b[2, i] - a[2, i])
        at = X + 6 * i
        row[at], row[at + 1], row[at + 2] = a[0, i], a[1, i], 0.5 * a[2, i]
        row[at + 3] = (10.0 * x - 4.0 * v + bend) / h**3
        row[at + 4] = (-15.0 * x + 7.0 * v - 2.0 * bend) / h**4
        row[at + 5] = (6.0 * x - 3.0 * v + bend) / h**5
        spin, sign = (WY, 1.0) if i == 0 else (WX, -1.0)
        if phase == GLIDE:
            row[spin] = sign * a[5, i]
            continue
        of_velocity = -2.5 if phase == SLIDE else 1.0
        for power in range(5):
            row[spin + power] = of_velocity * sign / radius * (power + 1) * row[at + power + 1]
        if phase == SLIDE:
            r0, r1, d0, d1 = a[3, i], b[3, i], a[4, i], b[4, i]
            cubic = (r0, d0, (3.0 * (r1 - r0) / h - 2.0 * d0 - d1) / h, (2.0 * (r0 - r1) / h + d0 + d1) / h**2)
            for power in range(4):
                row[spin + power] += 3.5 * sign / radius * cubic[power]


@compile_kernel
def _needs_step(m, p, phase, tolerance):  # type: ignore[no-untyped-def]
    """Whether the remainder of a slide or a roll is too long for a parabola."""
    if phase != SLIDE:
        return travel_direction(m[2], m[3])[2].real > STOPPING_SPEED
    left = m[_LEFT] * np.sqrt(m[4] * m[4] + m[5] * m[5]) / (3.5 * p[SLIDING_MU] * GRAVITY)
    bx, by = slope_and_drag(m[2], m[3], p)
    return max(_error_size(bx), _error_size(by)) * left.real * left.real > tolerance


@compile_kernel
def _limit_step(m, p, phase, h, horizon):  # type: ignore[no-untyped-def]
    """Limit a step h so that it stays away from the end, where directions turn without bound."""
    if phase == SLIDE:
        return min(h, 0.75 * m[_LEFT].real)
    speed = travel_direction(m[2], m[3])[2].real
    slow = max(p[ROLLING_MU].real * GRAVITY, 1e-9)
    return min(h, 0.75 * speed / slow, horizon + 1e-6 - m[_TIME].real)


@compile_kernel
def integrate_path(s, radius, p, phase, horizon, rows, phases, count):  # type: ignore[no-untyped-def]
    """Integrate s until the phase nearly ends, the horizon (s), or the end of the table; return the number of pieces.

    A slide is integrated to its end.
    """
    k, y, m = np.zeros((7, 8), rows.dtype), np.zeros(8, rows.dtype), np.zeros(8, rows.dtype)
    first, last = np.zeros((6, 2), rows.dtype), np.zeros((6, 2), rows.dtype)
    rate = np.zeros(8, rows.dtype)
    copy_numbers(s[:6], m)
    m[_TIME] = s[CLOCK]
    if phase == SLIDE:
        m[4], m[5], m[_LEFT] = s[2] - radius * s[5], s[3] + radius * s[4], 1.0
        m[2], m[3] = s[2] - 2.0 / 7.0 * m[4], s[3] - 2.0 / 7.0 * m[5]
    evaluate_rates(m, radius, p, phase, k[0])
    _evaluate_node(m, radius, p, phase, rate, first)
    tolerance = DERIVATIVE_TOLERANCE if np.iscomplexobj(rows) else TOLERANCE
    h = 0.1 if phase == SLIDE else 0.02
    while m[_TIME].real < horizon and _needs_step(m, p, phase, tolerance) and count < len(rows) - 4:
        h = _limit_step(m, p, phase, h, horizon)
        worst = take_step(m, radius, p, phase, h, k, y)
        if worst <= tolerance:
            _evaluate_node(y, radius, p, phase, rate, last)
            _interpolate_nodes(first, last, m[_TIME], y[_TIME] - m[_TIME], radius, phase, rows[count])
            phases[count] = phase
            count += 1
            copy_numbers(y, m)
            copy_numbers(k[6], k[0])
            copy_rows(last, first)
        h = h * min(4.0, max(0.2, 0.9 * (tolerance / max(worst, 1e-30)) ** 0.2))
    for i in range(2):
        s[i], s[2 + i] = first[0, i], first[1, i]
    s[4], s[5], s[CLOCK] = -first[5, 1], first[5, 0], m[_TIME]
    if phase == SLIDE and m[_TIME].real < horizon:
        count = _finish_slide(s, m, radius, p, rows, phases, count)
    return count


@compile_kernel
def _finish_slide(s, m, radius, p, rows, phases, count):  # type: ignore[no-untyped-def]
    """Write the rest of a slide as a parabola; return the number of pieces.

    It leads to where a constant acceleration ends the slip.
    """
    k = 3.5 * p[SLIDING_MU] * GRAVITY
    bx, by = slope_and_drag(s[2], s[3], p)
    ux, uy = m[_LEFT] * m[4], m[_LEFT] * m[5]
    length = (k * np.sqrt(ux * ux + uy * uy) + bx * ux + by * uy) / (k * k - bx * bx - by * by)
    rate = np.zeros(6, rows.dtype)
    rate[2], rate[3] = 5.0 / 7.0 * bx - 2.0 / 7.0 * ux / length, 5.0 / 7.0 * by - 2.0 / 7.0 * uy / length
    rate[4], rate[5] = 2.5 / radius * (rate[3] - by), -2.5 / radius * (rate[2] - bx)
    write_parabola(s, rate, length, SLIDE, rows, phases, count)
    return count + 1
