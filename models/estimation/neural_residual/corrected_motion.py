"""A small network that corrects the laws of billiards: what the cloth does to a ball, and what a cushion gives it.

Physics stays what it was wherever the network says nothing, and what it says is physical whatever its weights:

- Friction of the cloth, sliding or rolling, is multiplied by exp(b), so that it never pushes; and the path turns to the
  side by c times rolling resistance, which does no work. Both fade as the ball comes to rest and the slip ends.
- A cushion's rebound is multiplied by exp(b), and impulses along it and upwards, in proportion to the normal speed,
  turn the ball as a force at its surface does. A ball never leaves with more energy than it came with.

The correction acts in the middle of short steps between which the ball moves in closed form (Strang 1968,
doi:10.1137/0705041): exact where the network is silent, else with an error of the step times the square of the
correction. It is Chen 2022's network that learns what the equations lack (section 2.2), held to what a cloth and a
cushion can do.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compiled
from models.physics.billiards.cloth.cloth_motion import NO_SLIP, plan
from models.physics.billiards.cloth.forces import slip
from models.physics.billiards.cloth.motion_pieces import follow
from models.physics.billiards.parameters import GRAVITY, ROLLING_MU, SLIDING_MU
from models.physics.billiards.simulation.contact_resolution import meet_cushion

CLOTH_INPUTS, CLOTH_HIDDEN, CLOTH_OUTPUTS = 6, 5, 2
"""Direction of travel (2), speed, place (2), share of slip; b and c."""
CUSHION_INPUTS, CUSHION_HIDDEN, CUSHION_OUTPUTS = 4, 4, 3
"""Normal speed, obliqueness, side spin, roll; b, impulse along and upwards."""
CLOTH_WEIGHTS = CLOTH_HIDDEN * (CLOTH_INPUTS + 1 + CLOTH_OUTPUTS)
CUSHION_WEIGHTS = CUSHION_HIDDEN * (CUSHION_INPUTS + 1 + CUSHION_OUTPUTS)
WEIGHTS = CLOTH_WEIGHTS + CUSHION_WEIGHTS
"""Of a network: per hidden unit its inputs and bias; then per output its hidden units. The cloth comes first."""
STRIDE = 0.04
"""s, the longest step between two corrections."""
MOST = 1.5
"""Bound on every output: friction changes at most by a factor of exp(1.5)."""
FADING_SPEED, FADING_SLIP = 0.05, 0.5
"""m/s: below them the corrections die away, so that they end where motion ends and sliding does."""
ROOM = 4
"""Pieces that a stride needs."""
_NEWTON = 12
_TOUCHING = 1e-13
"""m"""
_LATE = 10
"""strides for which a ball may be late for a cushion."""


@compiled
def network(w, inputs, hidden, outputs, found):  # type: ignore[no-untyped-def]
    """Fill found (outputs,) from inputs (I,): one hidden layer of tanh, outputs bounded smoothly; without weights 0."""
    found[:] = 0.0
    if len(w) == 0:
        return
    wide = len(inputs) + 1
    for k in range(hidden):
        total = w[k * wide + wide - 1]
        for i in range(wide - 1):
            total = total + w[k * wide + i] * inputs[i]
        active = np.tanh(total)
        for o in range(outputs):
            found[o] += w[hidden * wide + o * hidden + k] * active
    for o in range(outputs):
        found[o] = MOST * np.tanh(found[o] / MOST)


@compiled
def rolled(s, h, radius, p):  # type: ignore[no-untyped-def]
    """Share of the time h (s) from the state s (7,) in which the ball rolls."""
    sliding = slip(s, radius)[2]
    if sliding.real <= NO_SLIP:
        return 0.0 * sliding + 1.0
    share = 1.0 - 2.0 / 7.0 * sliding / (p[SLIDING_MU] * GRAVITY * h)
    return share if share.real > 0.0 and h.real > 0.0 else 0.0 * sliding


@compiled
def correct_cloth(s, h, share, radius, p, w, size):  # type: ignore[no-untyped-def]
    """Change the state s (7,) by what the network adds to the cloth during h (s); size is the table's (2,) m.

    `share` of the time before was rolled: the correction of rolling friction must not outweigh what it corrects.
    """
    speed = np.sqrt(s[2] * s[2] + s[3] * s[3])
    if len(w) == 0 or speed.real <= NO_SLIP:
        return
    ux, uy, sliding = slip(s, radius)
    inputs, found = np.empty(CLOTH_INPUTS, s.dtype), np.empty(CLOTH_OUTPUTS, s.dtype)
    fading = np.sqrt(speed * speed + FADING_SPEED * FADING_SPEED)
    inputs[0], inputs[1], inputs[2] = s[2] / fading, s[3] / fading, 2.0 * speed / (1.0 + speed) - 1.0
    inputs[3], inputs[4] = 2.0 * s[0] / size[0] - 1.0, 2.0 * s[1] / size[1] - 1.0
    slides = sliding.real > NO_SLIP
    inputs[5] = 0.0 * speed
    if slides:
        inputs[5] = sliding / np.sqrt(sliding * sliding + FADING_SLIP * FADING_SLIP)
    network(w[:CLOTH_WEIGHTS], inputs, CLOTH_HIDDEN, CLOTH_OUTPUTS, found)
    more, rolling = np.exp(found[0]) - 1.0, p[ROLLING_MU] * GRAVITY * h / fading
    angle = found[1] * rolling
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


@compiled
def energy(s, radius):  # type: ignore[no-untyped-def]
    """Twice the energy per mass of a solid sphere."""
    return s[2] * s[2] + s[3] * s[3] + 0.4 * radius * radius * (s[4] * s[4] + s[5] * s[5] + s[6] * s[6])


@compiled
def bounce(s, nx, ny, radius, mass, p, law, w):  # type: ignore[no-untyped-def]
    """Change the state s (7,) by a cushion with the normal (nx, ny) into it: the law, and what the network adds."""
    out, before = np.empty(7, s.dtype), energy(s, radius)
    meet_cushion(s, nx, ny, radius, mass, p, law, False, out)
    vn, vt = nx * s[2] + ny * s[3], nx * s[3] - ny * s[2]
    if len(w) > 0:
        inputs, found = np.empty(CUSHION_INPUTS, s.dtype), np.empty(CUSHION_OUTPUTS, s.dtype)
        speed = np.sqrt(s[2] * s[2] + s[3] * s[3])
        inputs[0], inputs[1] = 2.0 * vn / (1.0 + vn) - 1.0, vt / speed
        inputs[2] = radius * s[6] / (speed + 1.0)
        inputs[3] = radius * (nx * s[5] - ny * s[4]) / (speed + 1.0)
        network(w[CLOTH_WEIGHTS:], inputs, CUSHION_HIDDEN, CUSHION_OUTPUTS, found)
        back, along, up = nx * out[2] + ny * out[3], vn * found[1], vn * found[2]
        more = back * (np.exp(found[0]) - 1.0)
        out[2], out[3] = out[2] + nx * more - ny * along, out[3] + ny * more + nx * along
        turn = 2.5 / radius
        out[4], out[5], out[6] = out[4] + ny * turn * up, out[5] - nx * turn * up, out[6] + turn * along
        after = energy(out, radius)
        if after.real > before.real:
            out[2:] *= np.sqrt(before / after)
    s[:] = out


@compiled
def drift(s, h, radius, p, rows, phases):  # type: ignore[no-untyped-def]
    """Move the state s (7,) by h (s, also backwards) in closed form."""
    out, rate = np.empty(7, s.dtype), np.empty(7, s.dtype)
    count = plan(s, radius, p, max(h.real, 1e-3), rows, phases)
    follow(rows, count, s[6], p, h, out, rate)
    s[:] = out


@compiled
def stride(s, h, radius, p, w, size, rows, phases):  # type: ignore[no-untyped-def]
    """Move the state s (7,) by h (s), cloth and network together."""
    if len(w) == 0:
        drift(s, h, radius, p, rows, phases)
        return
    share = rolled(s, 0.5 * h, radius, p)
    drift(s, 0.5 * h, radius, p, rows, phases)
    correct_cloth(s, h, share, radius, p, w, size)
    drift(s, 0.5 * h, radius, p, rows, phases)


@compiled
def travel(s, times, radius, p, w, size, rows, phases, out):  # type: ignore[no-untyped-def]
    """Move the state s (7,) to the times (T,) s one after another; fill out (T, 7)."""
    now = 0.0
    for k in range(len(times)):
        whole = times[k] - now
        steps = max(1, int(np.ceil(abs(whole) / STRIDE - 1e-9)))
        for _ in range(steps):
            stride(s, 0.0 * s[0] + whole / steps, radius, p, w, size, rows, phases)
        now = times[k]
        out[k] = s


@compiled
def meet(s, nx, ny, wall, latest, radius, p, w, size, rows, phases):  # type: ignore[no-untyped-def]
    """Move the state s (7,) until n . x = wall (m); the time that took, and whether the ball came there in `latest` s.

    A ball that is beyond already is moved back. Newton's iteration also finds the derivative of the time.
    """
    took = 0.0 * s[0]
    for _ in range(max(1, int(latest / STRIDE)) + _LATE):
        gap, speed = wall - nx * s[0] - ny * s[1], nx * s[2] + ny * s[3]
        if speed.real < 1e-6:
            return took, False
        if gap.real <= STRIDE * speed.real:
            break
        stride(s, 0.0 * s[0] + STRIDE, radius, p, w, size, rows, phases)
        took = took + STRIDE
    origin, h, last = s.copy(), 0.0 * s[0], False
    for _ in range(_NEWTON):
        gap, speed = wall - nx * s[0] - ny * s[1], nx * s[2] + ny * s[3]
        if speed.real < 1e-6:
            return took + h, False
        h = h + gap / speed
        s[:] = origin
        stride(s, h, radius, p, w, size, rows, phases)
        if last:
            return took + h, True
        last = abs(gap.real) < _TOUCHING
    return took + h, abs(gap.real) < 1e-6


@compiled
def hop(s, until, nx, ny, wall, radius, mass, p, law, w, size, rows, phases):  # type: ignore[no-untyped-def]
    """Move the state s (7,) by `until` (s) in all, through the cushion on its way; whether it came there."""
    took, met = meet(s, nx, ny, wall, until, radius, p, w, size, rows, phases)
    if met:
        bounce(s, nx, ny, radius, mass, p, law, w)
    left = until - took
    steps = max(1, int(np.ceil(abs(left.real) / STRIDE - 1e-9)))
    for _ in range(steps):
        stride(s, left / steps, radius, p, w, size, rows, phases)
    return met
