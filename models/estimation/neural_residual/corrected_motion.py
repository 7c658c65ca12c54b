"""A small network that corrects the billiards models of the cloth and of a cushion.

Where the network output is zero, the physics is unchanged; whatever its weights, the result stays physical:

- Friction of the cloth, sliding or rolling, is multiplied by exp(b), so that it never accelerates; and the path curves
  sideways by c times rolling resistance, which does no work. Both vanish as the ball stops and the slip ends.
- A cushion's rebound is multiplied by exp(b), and impulses along it and upwards, in proportion to the normal speed,
  turn the ball as a force at its surface does. A ball never leaves with more energy than it came with.

The correction acts in the middle of short intervals between which the ball moves in closed form (Strang 1968,
doi:10.1137/0705041): exact where the correction is zero, else with an error of the interval times the square of the
correction. It is Chen 2022's network that learns what the equations lack (section 2.2), restricted to what a cloth and
a cushion can do.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.cloth_motion import SLIP_THRESHOLD, plan_motion
from models.physics.billiards.cloth.forces import contact_slip
from models.physics.billiards.cloth.motion_pieces import evaluate_pieces
from models.physics.billiards.parameter_vector import GRAVITY, ROLLING_MU, SLIDING_MU
from models.physics.billiards.simulation.contact_resolution import resolve_cushion_contact

CLOTH_INPUTS, CLOTH_HIDDEN, CLOTH_OUTPUTS = 6, 5, 2
"""Inputs: direction of travel (2), speed, position (2), share of slip; outputs: b and c."""
CUSHION_INPUTS, CUSHION_HIDDEN, CUSHION_OUTPUTS = 4, 4, 3
"""Inputs: normal speed, obliqueness, side spin, roll; outputs: b, impulse along and upwards."""
CLOTH_WEIGHTS = CLOTH_HIDDEN * (CLOTH_INPUTS + 1 + CLOTH_OUTPUTS)
CUSHION_WEIGHTS = CUSHION_HIDDEN * (CUSHION_INPUTS + 1 + CUSHION_OUTPUTS)
WEIGHTS = CLOTH_WEIGHTS + CUSHION_WEIGHTS
"""Number of weights: per hidden unit its inputs and bias; then per output its hidden units. The cloth comes first."""
CORRECTION_INTERVAL = 0.04
"""s, longest interval between two corrections."""
MAX_OUTPUT = 1.5
"""Bound on every output: friction changes at most by a factor of exp(1.5)."""
FADING_SPEED, FADING_SLIP = 0.05, 0.5
"""m/s: below them the corrections vanish, so that they end where motion ends and sliding does."""
MAX_PIECES = 4
"""Pieces of closed-form motion that an interval needs."""
_NEWTON_ITERATIONS = 12
_CONTACT_TOLERANCE = 1e-13
"""m"""
_EXTRA_INTERVALS = 10
"""Intervals by which a ball may be late for a cushion."""


@compile_kernel
def evaluate_network(w, inputs, hidden, outputs, out):  # type: ignore[no-untyped-def]
    """Fill out (outputs,) from inputs (I,): one hidden layer of tanh, bounded outputs; 0 without weights."""
    out[:] = 0.0
    if len(w) == 0:
        return
    wide = len(inputs) + 1
    for k in range(hidden):
        total = w[k * wide + wide - 1]
        for i in range(wide - 1):
            total = total + w[k * wide + i] * inputs[i]
        active = np.tanh(total)
        for o in range(outputs):
            out[o] += w[hidden * wide + o * hidden + k] * active
    for o in range(outputs):
        out[o] = MAX_OUTPUT * np.tanh(out[o] / MAX_OUTPUT)


@compile_kernel
def rolling_share(s, h, radius, p):  # type: ignore[no-untyped-def]
    """Compute the share of the time h (s) from the state s (7,) in which the ball rolls."""
    sliding = contact_slip(s, radius)[2]
    if sliding.real <= SLIP_THRESHOLD:
        return 0.0 * sliding + 1.0
    share = 1.0 - 2.0 / 7.0 * sliding / (p[SLIDING_MU] * GRAVITY * h)
    return share if share.real > 0.0 and h.real > 0.0 else 0.0 * sliding


@compile_kernel
def correct_cloth(s, h, share, radius, p, w, size):  # type: ignore[no-untyped-def]
    """Change the state s (7,) by the cloth correction of the network during h (s).

    `size` is the table's (2,) m. `share` of the preceding interval was rolled: the correction of rolling friction must
    not exceed the friction that it corrects.
    """
    speed = np.sqrt(s[2] * s[2] + s[3] * s[3])
    if len(w) == 0 or speed.real <= SLIP_THRESHOLD:
        return
    ux, uy, sliding = contact_slip(s, radius)
    inputs, outputs = np.empty(CLOTH_INPUTS, s.dtype), np.empty(CLOTH_OUTPUTS, s.dtype)
    fading = np.sqrt(speed * speed + FADING_SPEED * FADING_SPEED)
    inputs[0], inputs[1], inputs[2] = s[2] / fading, s[3] / fading, 2.0 * speed / (1.0 + speed) - 1.0
    inputs[3], inputs[4] = 2.0 * s[0] / size[0] - 1.0, 2.0 * s[1] / size[1] - 1.0
    slides = sliding.real > SLIP_THRESHOLD
    inputs[5] = 0.0 * speed
    if slides:
        inputs[5] = sliding / np.sqrt(sliding * sliding + FADING_SLIP * FADING_SLIP)
    evaluate_network(w[:CLOTH_WEIGHTS], inputs, CLOTH_HIDDEN, CLOTH_OUTPUTS, outputs)
    more, rolling = np.exp(outputs[0]) - 1.0, p[ROLLING_MU] * GRAVITY * h / fading
    angle = outputs[1] * rolling
    cos, sin = np.cos(angle), np.sin(angle)
    vx, vy = s[2] * cos - s[3] * sin, s[3] * cos + s[2] * sin
    if slides:
        rub = -more * p[SLIDING_MU] * GRAVITY * h * inputs[5] / sliding
        s[2], s[3] = vx + rub * ux, vy + rub * uy
        s[4], s[5] = s[4] + 2.5 / radius * rub * uy, s[5] - 2.5 / radius * rub * ux
        return
    slow = more * rolling * share
    s[2], s[3] = vx * (1.0 - slow), vy * (1.0 - slow)
    s[4], s[5] = -s[3] / radius, s[2] / radius


@compile_kernel
def twice_specific_energy(s, radius):  # type: ignore[no-untyped-def]
    """Compute twice the kinetic energy per mass of a solid sphere."""
    return s[2] * s[2] + s[3] * s[3] + 0.4 * radius * radius * (s[4] * s[4] + s[5] * s[5] + s[6] * s[6])


@compile_kernel
def apply_cushion(s, nx, ny, radius, mass, p, law, w):  # type: ignore[no-untyped-def]
    """Change the state s (7,) by a cushion with the normal (nx, ny) into it: contact model and network correction."""
    out, before = np.empty(7, s.dtype), twice_specific_energy(s, radius)
    resolve_cushion_contact(s, nx, ny, radius, mass, p, law, False, out)
    vn, vt = nx * s[2] + ny * s[3], nx * s[3] - ny * s[2]
    if len(w) > 0:
        inputs, outputs = np.empty(CUSHION_INPUTS, s.dtype), np.empty(CUSHION_OUTPUTS, s.dtype)
        speed = np.sqrt(s[2] * s[2] + s[3] * s[3])
        inputs[0], inputs[1] = 2.0 * vn / (1.0 + vn) - 1.0, vt / speed
        inputs[2] = radius * s[6] / (speed + 1.0)
        inputs[3] = radius * (nx * s[5] - ny * s[4]) / (speed + 1.0)
        evaluate_network(w[CLOTH_WEIGHTS:], inputs, CUSHION_HIDDEN, CUSHION_OUTPUTS, outputs)
        back, along, up = nx * out[2] + ny * out[3], vn * outputs[1], vn * outputs[2]
        more = back * (np.exp(outputs[0]) - 1.0)
        out[2], out[3] = out[2] + nx * more - ny * along, out[3] + ny * more + nx * along
        turn = 2.5 / radius
        out[4], out[5], out[6] = out[4] + ny * turn * up, out[5] - nx * turn * up, out[6] + turn * along
        after = twice_specific_energy(out, radius)
        if after.real > before.real:
            out[2:] *= np.sqrt(before / after)
    s[:] = out


@compile_kernel
def advance_closed_form(s, h, radius, p, rows, phases):  # type: ignore[no-untyped-def]
    """Advance the state s (7,) by h (s, also backwards) in closed form."""
    out, rate = np.empty(7, s.dtype), np.empty(7, s.dtype)
    count = plan_motion(s, radius, p, max(h.real, 1e-3), rows, phases)
    evaluate_pieces(rows, count, s[6], p, h, out, rate)
    s[:] = out


@compile_kernel
def advance_corrected(s, h, radius, p, w, size, rows, phases):  # type: ignore[no-untyped-def]
    """Advance the state s (7,) by h (s) with the cloth and its correction."""
    if len(w) == 0:
        advance_closed_form(s, h, radius, p, rows, phases)
        return
    share = rolling_share(s, 0.5 * h, radius, p)
    advance_closed_form(s, 0.5 * h, radius, p, rows, phases)
    correct_cloth(s, h, share, radius, p, w, size)
    advance_closed_form(s, 0.5 * h, radius, p, rows, phases)


@compile_kernel
def advance_through_times(s, times, radius, p, w, size, rows, phases, out):  # type: ignore[no-untyped-def]
    """Advance the state s (7,) to the times (T,) s one after another; fill out (T, 7)."""
    now = 0.0
    for k in range(len(times)):
        whole = times[k] - now
        steps = max(1, int(np.ceil(abs(whole) / CORRECTION_INTERVAL - 1e-9)))
        for _ in range(steps):
            advance_corrected(s, 0.0 * s[0] + whole / steps, radius, p, w, size, rows, phases)
        now = times[k]
        out[k] = s


@compile_kernel
def advance_to_cushion(s, nx, ny, wall, latest, radius, p, w, size, rows, phases):  # type: ignore[no-untyped-def]
    """Advance the state s (7,) until n . x = wall (m).

    A ball that is already beyond is moved back. Newton's iteration also yields the derivative of the time. Return the
    elapsed time, and whether the ball reached the cushion within `latest` s.
    """
    took = 0.0 * s[0]
    for _ in range(max(1, int(latest / CORRECTION_INTERVAL)) + _EXTRA_INTERVALS):
        gap, speed = wall - nx * s[0] - ny * s[1], nx * s[2] + ny * s[3]
        if speed.real < 1e-6:
            return took, False
        if gap.real <= CORRECTION_INTERVAL * speed.real:
            break
        advance_corrected(s, 0.0 * s[0] + CORRECTION_INTERVAL, radius, p, w, size, rows, phases)
        took = took + CORRECTION_INTERVAL
    origin, h, last = s.copy(), 0.0 * s[0], False
    for _ in range(_NEWTON_ITERATIONS):
        gap, speed = wall - nx * s[0] - ny * s[1], nx * s[2] + ny * s[3]
        if speed.real < 1e-6:
            return took + h, False
        h = h + gap / speed
        s[:] = origin
        advance_corrected(s, h, radius, p, w, size, rows, phases)
        if last:
            return took + h, True
        last = abs(gap.real) < _CONTACT_TOLERANCE
    return took + h, abs(gap.real) < 1e-6


@compile_kernel
def advance_past_cushion(s, until, nx, ny, wall, radius, mass, p, law, w, size, rows, phases):  # type: ignore[no-untyped-def]
    """Advance the state s (7,) by `until` (s) in all, through the cushion; return whether it reached the cushion."""
    took, met = advance_to_cushion(s, nx, ny, wall, until, radius, p, w, size, rows, phases)
    if met:
        apply_cushion(s, nx, ny, radius, mass, p, law, w)
    left = until - took
    steps = max(1, int(np.ceil(abs(left.real) / CORRECTION_INTERVAL - 1e-9)))
    for _ in range(steps):
        advance_corrected(s, left / steps, radius, p, w, size, rows, phases)
    return met
