"""Motion of one ball on the cloth as pieces that are polynomials in time: it slides, rolls, rests.

A sliding ball feels friction mu g against its slip u (the velocity of the point that touches the cloth), which also
changes the slip: u' = -7/2 mu g u/|u|, a constant direction, so the path is a parabola (Marlow 1995, The Physics of
Pocket Billiards). When the slip is 0 the ball rolls straight on, decelerates at mu_r g, and stops. Side spin decays at
a constant rate in every phase, and does not act on the path. All this has a closed form.

Three more effects act on the centre of a moving ball. The paths under slope and drag are integrated (`curved_paths`),
and so are those under the generic law of the cloth, see `models.physics.effects.cloth.cloth_force`.
Slope: g s, of which a rolling ball spends 2/7 on rotation; a ball at rest stays while rolling resistance exceeds it.
Drag: -k v v and -k v. Nap, the direction of the cloth's fibres towards +x, needs no integration: a ball that rolls at
an angle a to it decelerates at (mu_r - nap cos a) g. Without sliding friction slip has no effect: every ball then moves
as one that rolls, and keeps its spin.

Arguments that the functions share: s (7,) is x, y (m), vx, vy (m/s), wx, wy (rad/s) and the clock (s), changed in
place; radius in m; p (P,) physical parameters; bends is None where no effect that bends paths is present, so that
their integration need not be compiled; rows (K, PIECE_WIDTH) and phases (K,) receive pieces; count is their number.
"""

from __future__ import annotations

import numpy as np

from models.numerics.array_copies import copy_numbers
from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.curved_paths import integrate_path
from models.physics.billiards.cloth.forces import (
    ROLLING_SHARE,
    contact_slip,
    downhill_slope,
    evaluate_state_rate,
    has_curved_path,
    rolling_deceleration,
    travel_direction,
)
from models.physics.billiards.cloth.motion_pieces import CLOCK, GLIDE, REST, REST_DURATION, ROLL, SLIDE, write_parabola
from models.physics.billiards.parameter_vector import GRAVITY, ROLLING_MU, SLIDING_MU

SLIP_THRESHOLD = 1e-10
"""m/s; a slip below this is rounding error of a ball that rolls."""
DOWNHILL_START_DURATION = 1e-4
"""s during which a ball that a slope sets in motion moves straight."""


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
def complete_phase(s, radius, p, phase, bends, horizon, rows, phases, count):  # type: ignore[no-untyped-def]
    """Move s to the end of a phase, by integration if an effect bends the path; return the number of pieces."""
    curves = False
    if bends is not None:
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
def plan_motion(state, radius, p, bends, horizon, rows, phases):  # type: ignore[no-untyped-def]
    """Plan the motion of a ball from a state.

    All arrays and numbers have the type of `rows`, float64 or complex128.

    Args:
        state: (7,) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s).
        radius: m.
        p: (P,) physical parameters.
        bends: None where no effect that bends paths is present in p.
        horizon: s; the last piece ends beyond it.
        rows: (K, PIECE_WIDTH) receives the pieces.
        phases: (K,) receives their phases.

    Returns:
        The number of pieces.
    """
    s = np.zeros(7, rows.dtype)
    copy_numbers(state[:6], s)
    count, phase = 0, ROLL
    size = contact_slip(s, radius)[2]
    if size.real > SLIP_THRESHOLD:
        phase = SLIDE if p[SLIDING_MU].real > 0.0 else GLIDE
    if phase == SLIDE:
        count = complete_phase(s, radius, p, SLIDE, bends, horizon, rows, phases, count)
        phase = ROLL
    if p[SLIDING_MU].real > 0.0 and s[CLOCK].real < horizon:
        remove_remaining_slip(s, radius)
    sx, sy = downhill_slope(p)
    stays_at_rest = ROLLING_SHARE * 1e-3 * np.hypot(sx.real, sy.real) <= p[ROLLING_MU].real
    while s[CLOCK].real < horizon and count < len(rows) - 2:
        if travel_direction(s[2], s[3])[2].real > 0.0:
            count = complete_phase(s, radius, p, phase, bends, horizon, rows, phases, count)
            s[2:4] = 0.0
        elif p[ROLLING_MU].real > 0.0:
            s[2:4] = 0.0
        if stays_at_rest or s[CLOCK].real >= horizon:
            break
        if bends is None:
            break
        count = start_downhill(s, radius, p, phase, rows, phases, count)
    if s[CLOCK].real < horizon:
        if phase == ROLL:
            s[4], s[5] = -s[3] / radius, s[2] / radius
        write_parabola(s, np.zeros(6, rows.dtype), 0.0 * s[CLOCK] + REST_DURATION, REST, rows, phases, count)
        count += 1
    return count
