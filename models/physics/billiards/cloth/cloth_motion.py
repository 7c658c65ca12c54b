"""One ball alone on the cloth: it slides, rolls, rests; its motion as pieces that are polynomials in time.

A sliding ball feels friction mu g against its slip u (the velocity of the point that touches the cloth), which also
turns it: u' = -7/2 mu g u/|u|, a constant direction, so the path is a parabola (Marlow 1995, The Physics of Pocket
Billiards). When the slip is gone the ball rolls straight on, slowed at mu_r g, and stops. Side spin decays at a
constant rate whatever else the ball does, and does not act on its path. All that is in closed form.

Three more effects act on the centre of a moving ball, and their paths are integrated (`curves`). Slope: g s, of which
a rolling ball has to spend 2/7 on turning; a ball at rest stays while rolling resistance holds it. Drag: -k v v and
-k v. Nap, the lie of the cloth's fibres towards +x, needs no integration: a ball that rolls at an angle a to it is
slowed at (mu_r - nap cos a) g. Without sliding friction the cloth does not know slip: every ball then moves as one
that rolls, and the spin it started with stays.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards.cloth.curved_paths import march
from models.physics.billiards.cloth.forces import ROLLED, accelerate, curved, heading, resistance, slip
from models.physics.billiards.cloth.motion_pieces import CLOCK, FOREVER, GLIDE, REST, ROLL, SLIDE, straight
from models.physics.billiards.parameters import GRAVITY, ROLLING_MU, SLIDING_MU, SLOPE_X, SLOPE_Y

NO_SLIP = 1e-10
"""m/s: less than rounding leaves of the slip of a ball that rolls."""
NUDGE = 1e-4
"""s for which a ball that a slope sets in motion goes straight."""


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
    hx, hy, speed = heading(s[2], s[3])
    slow = resistance(hx, p) - ROLLED * GRAVITY * 1e-3 * (p[SLOPE_X] * hx + p[SLOPE_Y] * hy)
    if slow.real * FOREVER <= speed.real:
        return 0.0 * speed + FOREVER
    return speed / slow


@compiled
def finish(s, radius, p, phase, curves, horizon, rows, phases, count):  # type: ignore[no-untyped-def]
    """The whole of one phase, integrated where it `curves`; the number of pieces."""
    if curves:
        count = march(s, radius, p, phase, horizon, rows, phases, count)
    if s[CLOCK].real < horizon and not (curves and phase == SLIDE):
        rate = np.zeros(6, rows.dtype)
        accelerate(s, radius, p, phase, rate)
        straight(s, rate, time_left(s, radius, p, phase), phase, rows, phases, count)
        count += 1
    return count


@compiled
def set_off(s, radius, p, phase, rows, phases, count):  # type: ignore[no-untyped-def]
    """A slope that rolling resistance does not hold moves a ball from rest; the number of pieces."""
    steep = np.sqrt(p[SLOPE_X] * p[SLOPE_X] + p[SLOPE_Y] * p[SLOPE_Y])
    pull = (ROLLED * 1e-3 * steep - p[ROLLING_MU]) * GRAVITY / steep
    rate = np.zeros(6, rows.dtype)
    rate[2], rate[3] = pull * p[SLOPE_X], pull * p[SLOPE_Y]
    if phase == ROLL:
        rate[4], rate[5] = -rate[3] / radius, rate[2] / radius
    straight(s, rate, 0.0 * s[CLOCK] + NUDGE, phase, rows, phases, count)
    return count + 1


@compiled
def plan(state, radius, p, horizon, rows, phases):  # type: ignore[no-untyped-def]
    """Fill rows (K, WIDTH) and phases (K,) with the motion from `state` (7,) up to `horizon` (s); the number of pieces.

    The last piece lasts beyond the horizon. Everything has the dtype of `rows`, real or complex.
    """
    s = np.zeros(7, rows.dtype)
    s[:6] = state[:6]
    curves, count, phase = curved(p), 0, ROLL
    size = slip(s, radius)[2]
    if size.real > NO_SLIP:
        phase = SLIDE if p[SLIDING_MU].real > 0.0 else GLIDE
    if phase == SLIDE:
        count = finish(s, radius, p, SLIDE, curves, horizon, rows, phases, count)
        phase = ROLL
    if p[SLIDING_MU].real > 0.0 and s[CLOCK].real < horizon:
        catch(s, radius)
    held = ROLLED * 1e-3 * np.hypot(p[SLOPE_X].real, p[SLOPE_Y].real) <= p[ROLLING_MU].real
    while s[CLOCK].real < horizon and count < len(rows) - 2:
        if heading(s[2], s[3])[2].real > 0.0:
            count = finish(s, radius, p, phase, curves, horizon, rows, phases, count)
            s[2:4] = 0.0
        elif p[ROLLING_MU].real > 0.0:
            s[2:4] = 0.0
        if held or s[CLOCK].real >= horizon:
            break
        count = set_off(s, radius, p, phase, rows, phases, count)
    if s[CLOCK].real < horizon:
        if phase == ROLL:
            s[4], s[5] = -s[3] / radius, s[2] / radius
        straight(s, np.zeros(6, rows.dtype), 0.0 * s[CLOCK] + FOREVER, REST, rows, phases, count)
        count += 1
    return count
