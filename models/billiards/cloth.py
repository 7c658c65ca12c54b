"""One ball alone on the cloth: it slides, rolls, rests; its motion as pieces that are polynomials in time.

A sliding ball feels friction mu g against its slip u (the velocity of the point that touches the cloth), which also
turns it: u' = -7/2 mu g u/|u|, a constant direction, so the path is a parabola (Marlow 1995, The Physics of Pocket
Billiards). When the slip is gone the ball rolls straight on, slowed at mu_r g, and stops. Side spin decays at a
constant rate whatever else the ball does, and does not act on its path. All that is in closed form.

On a slope, or with drag, nothing is: those paths are integrated by Dormand and Prince's method 5(4) (1980,
doi:10.1016/0771-050X(80)90013-3) in steps whose error is below `TOLERANCE`. Between two steps the place is the quintic
that has the integrated place, velocity and acceleration at both ends, and the spin follows from the velocity: friction
changes both in a fixed proportion. While the ball slides, steps are made in s with dt = |u| ds: the direction of a slip
that dies away turns ever faster in time, but smoothly in s, so that derivatives stay exact.

Three more effects act on the centre of a moving ball. Slope: g s, of which a rolling ball has to spend 2/7 on turning;
a ball at rest stays while rolling resistance holds it. Drag: -k v v and -k v. Nap, the lie of the cloth's fibres
towards +x: a ball that rolls at an angle a to it is slowed at (mu_r - nap cos a) g. Without sliding friction the cloth
does not know slip: every ball then moves as one that rolls, and the spin it started with stays.
"""

from __future__ import annotations

import numpy as np

from models.billiards.compiled import compiled
from models.billiards.parameters import (
    AIR_DRAG,
    GRAVITY,
    NAP,
    ROLLING_MU,
    SLIDING_MU,
    SLOPE_X,
    SLOPE_Y,
    SPIN_DECAY,
    VISCOUS_DRAG,
)

SLIDE, ROLL, REST, GLIDE = range(4)
"""Phases; a ball glides where there is no sliding friction and it does not roll."""
PHASE_NAMES = ("slide", "roll", "rest", "roll")
"""As `models.trajectory.PHASES` has them."""
START, END, X, Y, WX, WY, WIDTH = 0, 1, 2, 8, 14, 19, 24
"""Columns of a piece: times since the state (s), then coefficients of powers of the time since the piece began."""
STRAIGHT_ROWS, CURVED_ROWS = 4, 400
"""Pieces that fit in a table, in closed form and integrated."""
FOREVER = 1e9
"""s, the end of rest."""
TOLERANCE = 3e-10
"""m and m/s, error of one integrated step."""
NO_SLIP = 1e-10
"""m/s: less than rounding leaves of the slip of a ball that rolls."""
NEARLY = 1e-6
"""m/s: below this slip or speed, sliding and rolling end in closed form, for their direction turns without bound."""
NUDGE = 1e-4
"""s for which a ball that a slope sets in motion goes straight."""
ROLLED = 5.0 / 7.0
"""Of a force along the cloth accelerates a solid sphere that rolls."""


@compiled
def curved(p):  # type: ignore[no-untyped-def]
    """Whether an effect acts that has no closed form; also where only its derivative is asked for."""
    return p[SLOPE_X] != 0 or p[SLOPE_Y] != 0 or p[AIR_DRAG] != 0 or p[VISCOUS_DRAG] != 0


@compiled
def slip(s, radius):  # type: ignore[no-untyped-def]
    """Velocity of the point that touches the cloth, and its size; s is x, y, vx, vy, wx, wy."""
    ux, uy = s[2] - radius * s[5], s[3] + radius * s[4]
    return ux, uy, np.sqrt(ux * ux + uy * uy)


@compiled
def heading(s):  # type: ignore[no-untyped-def]
    """Unit vector along the velocity, and the speed."""
    speed = np.sqrt(s[2] * s[2] + s[3] * s[3])
    if speed.real == 0.0:
        return 0.0 * speed, 0.0 * speed, speed
    return s[2] / speed, s[3] / speed, speed


@compiled
def resistance(hx, p):  # type: ignore[no-untyped-def]
    """Deceleration of a ball that rolls with hx = cos(angle to +x), m/s^2."""
    return (p[ROLLING_MU] - p[NAP] * hx) * GRAVITY


@compiled
def rub(s, radius, p, drag, rate):  # type: ignore[no-untyped-def]
    """Sliding friction: fill rate[2:8]. The direction of the slip s[6:8] turns as slope and drag turn it."""
    bx = GRAVITY * 1e-3 * p[SLOPE_X] - drag * s[2]
    by = GRAVITY * 1e-3 * p[SLOPE_Y] - drag * s[3]
    size = slip(s, radius)[2]
    fx, fy = -p[SLIDING_MU] * GRAVITY * s[6], -p[SLIDING_MU] * GRAVITY * s[7]
    rate[2], rate[3] = fx + bx, fy + by
    rate[4], rate[5] = 2.5 / radius * fy, -2.5 / radius * fx
    along = bx * s[6] + by * s[7]
    rate[6], rate[7] = (bx - along * s[6]) / size, (by - along * s[7]) / size


@compiled
def accelerate(s, radius, p, phase, rate):  # type: ignore[no-untyped-def]
    """Fill `rate` (9,) with the time derivative of s (9,): x, y, vx, vy, wx, wy, direction of the slip, time."""
    hx, hy, speed = heading(s)
    drag = p[AIR_DRAG] * speed + p[VISCOUS_DRAG]
    rate[0], rate[1], rate[8] = s[2], s[3], 1.0
    if phase == SLIDE:
        rub(s, radius, p, drag, rate)
        return
    slow, tilt = resistance(hx, p), ROLLED * GRAVITY * 1e-3
    rate[2] = -slow * hx + tilt * p[SLOPE_X] - drag * s[2]
    rate[3] = -slow * hy + tilt * p[SLOPE_Y] - drag * s[3]
    rate[4], rate[5] = -rate[3] / radius, rate[2] / radius
    rate[6:8] = 0.0
    if phase == GLIDE:
        rate[4:6] = 0.0


@compiled
def advance(s, radius, p, phase, rate):  # type: ignore[no-untyped-def]
    """`accelerate` by the variable of the steps: time, or |u| of it while the ball slides."""
    accelerate(s, radius, p, phase, rate)
    if phase == SLIDE:
        rate *= slip(s, radius)[2]


@compiled
def go_straight(s, rate, length, phase, rows, phases, k):  # type: ignore[no-untyped-def]
    """Piece k: constant acceleration and constant change of spin for `length` (s); s is moved to its end."""
    row = rows[k]
    row[:] = 0.0
    row[START], row[END] = s[8], s[8] + length
    phases[k] = phase
    for i in range(2):
        row[X + 6 * i], row[X + 6 * i + 1], row[X + 6 * i + 2] = s[i], s[2 + i], 0.5 * rate[2 + i]
        row[WX + 5 * i], row[WX + 5 * i + 1] = s[4 + i], rate[4 + i]
    for i in range(2):
        s[i] = s[i] + (s[2 + i] + 0.5 * rate[2 + i] * length) * length
        s[2 + i] = s[2 + i] + rate[2 + i] * length
        s[4 + i] = s[4 + i] + rate[4 + i] * length
    s[8] = row[END]


@compiled
def catch(s, radius):  # type: ignore[no-untyped-def]
    """Take the last slip away: friction at the cloth keeps the angular momentum about the point of contact."""
    ux, uy, _ = slip(s, radius)
    s[2], s[3] = s[2] - 2.0 / 7.0 * ux, s[3] - 2.0 / 7.0 * uy
    s[4], s[5] = -s[3] / radius, s[2] / radius


@compiled
def time_left(s, radius, p, phase):  # type: ignore[no-untyped-def]
    """How long the ball goes on sliding or rolling if its deceleration stays; `FOREVER` if nothing stops it."""
    if phase == SLIDE:
        _, _, size = slip(s, radius)
        return 2.0 / 7.0 * size / (p[SLIDING_MU] * GRAVITY)
    hx, hy, speed = heading(s)
    slow = resistance(hx, p) - ROLLED * GRAVITY * 1e-3 * (p[SLOPE_X] * hx + p[SLOPE_Y] * hy)
    if slow.real * FOREVER <= speed.real:
        return 0.0 * speed + FOREVER
    return speed / slow


@compiled
def remaining(s, radius, phase):  # type: ignore[no-untyped-def]
    """Slip of a sliding ball, speed of another one, m/s."""
    if phase == SLIDE:
        return slip(s, radius)[2].real
    return heading(s)[2].real


@compiled
def step(s, radius, p, phase, h, k, y):  # type: ignore[no-untyped-def]
    """One step of Dormand and Prince from s with the slopes k (7, 9), k[0] given: fills y (9,), k; the error."""
    advance(s + h * (k[0] / 5.0), radius, p, phase, k[1])
    advance(s + h * (3.0 / 40.0 * k[0] + 9.0 / 40.0 * k[1]), radius, p, phase, k[2])
    advance(s + h * (44.0 / 45.0 * k[0] - 56.0 / 15.0 * k[1] + 32.0 / 9.0 * k[2]), radius, p, phase, k[3])
    y[:] = 19372.0 / 6561.0 * k[0] - 25360.0 / 2187.0 * k[1] + 64448.0 / 6561.0 * k[2] - 212.0 / 729.0 * k[3]
    advance(s + h * y, radius, p, phase, k[4])
    y[:] = 9017.0 / 3168.0 * k[0] - 355.0 / 33.0 * k[1] + 46732.0 / 5247.0 * k[2] + 49.0 / 176.0 * k[3]
    advance(s + h * (y - 5103.0 / 18656.0 * k[4]), radius, p, phase, k[5])
    y[:] = 35.0 / 384.0 * k[0] + 500.0 / 1113.0 * k[2] + 125.0 / 192.0 * k[3] - 2187.0 / 6784.0 * k[4]
    y[:] = s + h * (y + 11.0 / 84.0 * k[5])
    advance(y, radius, p, phase, k[6])
    worst, left = 0.0, remaining(y, radius, phase)
    for i in range(9):
        miss = 71.0 / 57600.0 * k[0, i] - 71.0 / 16695.0 * k[2, i] + 71.0 / 1920.0 * k[3, i]
        miss = miss - 17253.0 / 339200.0 * k[4, i] + 22.0 / 525.0 * k[5, i] - k[6, i] / 40.0
        scale = radius.real if 4 <= i < 6 else left if 6 <= i < 8 else 1.0
        worst = max(worst, abs(h * scale * miss.real))
    return worst


@compiled
def join(s, y, k, radius, phase, row):  # type: ignore[no-untyped-def]
    """The piece from s to y; k (7, 9) are the slopes of the step between them."""
    row[:] = 0.0
    row[START], row[END] = s[8], y[8]
    h = y[8] - s[8]
    for i in range(2):
        first, last = k[0, 2 + i] / k[0, 8], k[6, 2 + i] / k[6, 8]
        x = y[i] - s[i] - h * (s[2 + i] + 0.5 * h * first)
        v = h * (y[2 + i] - s[2 + i] - h * first)
        a = 0.5 * h * h * (last - first)
        at = X + 6 * i
        row[at], row[at + 1], row[at + 2] = s[i], s[2 + i], 0.5 * first
        row[at + 3] = (10.0 * x - 4.0 * v + a) / h**3
        row[at + 4] = (-15.0 * x + 7.0 * v - 2.0 * a) / h**4
        row[at + 5] = (6.0 * x - 3.0 * v + a) / h**5
        j, sign = (5, 1.0) if i == 0 else (4, -1.0)
        spin = WY if i == 0 else WX
        if phase == GLIDE:
            row[spin] = s[j]
        else:
            for power in range(5):
                row[spin + power] = sign / radius * (power + 1) * row[at + power + 1]
        if phase == SLIDE:
            # What friction leaves alone, 5/7 v + 2/7 R (wy, -wx), is smooth in time.
            r0, r1 = s[2 + i] + 0.4 * sign * radius * s[j], y[2 + i] + 0.4 * sign * radius * y[j]
            d0 = first + 0.4 * sign * radius * k[0, j] / k[0, 8]
            d1 = last + 0.4 * sign * radius * k[6, j] / k[6, 8]
            kept = (r0, d0, (3.0 * (r1 - r0) / h - 2.0 * d0 - d1) / h, (2.0 * (r0 - r1) / h + d0 + d1) / h**2)
            for power in range(5):
                row[spin + power] = -2.5 * row[spin + power]
                if power < 4:
                    row[spin + power] += 2.5 * sign / radius * kept[power]


@compiled
def march(s, radius, p, phase, horizon, rows, phases, count):  # type: ignore[no-untyped-def]
    """Integrate until the phase nearly ends, the horizon or the end of the table; the number of pieces."""
    k, y = np.zeros((7, 9), rows.dtype), np.zeros(9, rows.dtype)
    advance(s, radius, p, phase, k[0])
    h = 0.02
    while s[8].real < horizon and remaining(s, radius, phase) > NEARLY and count < len(rows) - 4:
        if phase == SLIDE:
            h = min(h, 0.5 / (p[SLIDING_MU].real * GRAVITY))
        else:
            h = min(h, 0.75 * time_left(s, radius, p, phase).real, horizon + 1e-6 - s[8].real)
        worst = step(s, radius, p, phase, h, k, y)
        if worst <= TOLERANCE:
            join(s, y, k, radius, phase, rows[count])
            phases[count] = phase
            count += 1
            s[:] = y
            k[0] = k[6]
        h = h * min(4.0, max(0.2, 0.9 * (TOLERANCE / max(worst, 1e-30)) ** 0.2))
    return count


@compiled
def finish(s, radius, p, phase, curves, horizon, rows, phases, count):  # type: ignore[no-untyped-def]
    """The whole of one phase, integrated where it `curves`; the number of pieces."""
    if curves:
        count = march(s, radius, p, phase, horizon, rows, phases, count)
    if s[8].real < horizon:
        rate = np.zeros(9, rows.dtype)
        accelerate(s, radius, p, phase, rate)
        go_straight(s, rate, time_left(s, radius, p, phase), phase, rows, phases, count)
        count += 1
    return count


@compiled
def set_off(s, radius, p, phase, rows, phases, count):  # type: ignore[no-untyped-def]
    """A slope that rolling resistance does not hold moves a ball from rest; the number of pieces."""
    steep = np.sqrt(p[SLOPE_X] * p[SLOPE_X] + p[SLOPE_Y] * p[SLOPE_Y])
    pull = (ROLLED * 1e-3 * steep - p[ROLLING_MU]) * GRAVITY / steep
    rate = np.zeros(9, rows.dtype)
    rate[2], rate[3] = pull * p[SLOPE_X], pull * p[SLOPE_Y]
    if phase == ROLL:
        rate[4], rate[5] = -rate[3] / radius, rate[2] / radius
    go_straight(s, rate, 0.0 * s[8] + NUDGE, phase, rows, phases, count)
    return count + 1


@compiled
def plan(state, radius, p, horizon, rows, phases):  # type: ignore[no-untyped-def]
    """Fill rows (K, WIDTH) and phases (K,) with the motion from `state` (7,) up to `horizon` (s); the number of pieces.

    The last piece lasts beyond the horizon. Everything has the dtype of `rows`, real or complex.
    """
    s = np.zeros(9, rows.dtype)
    s[:6] = state[:6]
    curves, count, phase = curved(p), 0, ROLL
    ux, uy, size = slip(s, radius)
    if size.real > NO_SLIP:
        phase = SLIDE if p[SLIDING_MU].real > 0.0 else GLIDE
    if phase == SLIDE:
        s[6], s[7] = ux / size, uy / size
        count = finish(s, radius, p, SLIDE, curves, horizon, rows, phases, count)
        phase = ROLL
    if p[SLIDING_MU].real > 0.0 and s[8].real < horizon:
        catch(s, radius)
    held = ROLLED * 1e-3 * np.hypot(p[SLOPE_X].real, p[SLOPE_Y].real) <= p[ROLLING_MU].real
    while s[8].real < horizon and count < len(rows) - 2:
        if heading(s)[2].real > 0.0:
            count = finish(s, radius, p, phase, curves, horizon, rows, phases, count)
            s[2:4] = 0.0
        elif p[ROLLING_MU].real > 0.0:
            s[2:4] = 0.0
        if held or s[8].real >= horizon:
            break
        count = set_off(s, radius, p, phase, rows, phases, count)
    if s[8].real < horizon:
        if phase == ROLL:
            s[4], s[5] = -s[3] / radius, s[2] / radius
        go_straight(s, np.zeros(9, rows.dtype), 0.0 * s[8] + FOREVER, REST, rows, phases, count)
        count += 1
    return count


@compiled
def piece_at(rows, count, tau):  # type: ignore[no-untyped-def]
    """Index of the piece at tau (s) since the state."""
    for k in range(count - 1):
        if tau.real < rows[k, END].real:
            return k
    return count - 1


@compiled
def side_spin(wz, rate, tau):  # type: ignore[no-untyped-def]
    """wz and its derivative after tau of a decay at `rate` (rad/s^2)."""
    sign = 1.0 if wz.real > 0.0 else -1.0
    if wz.real * sign <= rate.real * tau.real:
        return (0.0 * wz, 0.0 * wz) if rate.real > 0.0 else (wz - sign * rate * tau, 0.0 * wz)
    return wz - sign * rate * tau, 0.0 * wz - sign * rate


@compiled
def follow(rows, count, wz, p, tau, out, rate):  # type: ignore[no-untyped-def]
    """State out (7,) and its time derivative rate (7,) at tau (s) since the state with side spin wz."""
    row = rows[piece_at(rows, count, tau)]
    t = tau - row[START]
    for i in range(2):
        x, v, a = 0.0 * t, 0.0 * t, 0.0 * t
        for j in range(5, -1, -1):
            a = a * t + v
            v = v * t + x
            x = x * t + row[X + 6 * i + j]
        w, turn = 0.0 * t, 0.0 * t
        for j in range(4, -1, -1):
            turn = turn * t + w
            w = w * t + row[WX + 5 * i + j]
        out[i], out[2 + i], out[4 + i] = x, v, w
        rate[i], rate[2 + i], rate[4 + i] = v, 2.0 * a, turn
    out[6], rate[6] = side_spin(wz, p[SPIN_DECAY], tau)
