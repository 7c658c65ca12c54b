"""Foreign truth for the tests of the fit: balls on a table, moved in small fixed steps, contacts resolved on overlap.

Shares no code with models/. Sliding and rolling friction by Euler steps of 50 us, ball contacts with restitution and
Coulomb friction, and three cushion laws.
"""

from __future__ import annotations

import math

import numba
import numpy as np

STEP = 5e-5
G = 9.81
MIRROR, SPEED_DEPENDENT, GRIPPING = 0, 1, 2


@numba.njit(cache=True)
def _note(log, count, t, kind, ball, other, speed):  # type: ignore[no-untyped-def]
    if count < len(log):
        log[count, 0] = t
        log[count, 1] = kind
        log[count, 2] = ball
        log[count, 3] = other
        log[count, 4] = speed
        count += 1
    return count


@numba.njit(cache=True)
def _run(x, v, w, radius, length, width, mu_s, mu_r, e_ball, mu_ball, law, steps, every, log, pocket):  # type: ignore[no-untyped-def]
    n = len(x)
    count = 0
    frames = (steps + every - 1) // every
    path = np.empty((frames, n, 2))
    touching = np.zeros((n, n), np.bool_)
    gone = np.zeros(n, np.bool_)
    for step in range(steps):
        if step % every == 0:
            path[step // every] = x
        t = step * STEP
        for i in range(n):
            if gone[i]:
                continue
            ux = v[i, 0] - radius * w[i, 1]
            uy = v[i, 1] + radius * w[i, 0]
            slip = math.hypot(ux, uy)
            speed = math.hypot(v[i, 0], v[i, 1])
            if slip > 3.5 * mu_s * G * STEP:
                ax, ay = -mu_s * G * ux / slip, -mu_s * G * uy / slip
                v[i, 0] += ax * STEP
                v[i, 1] += ay * STEP
                w[i, 1] -= 2.5 * ax / radius * STEP
                w[i, 0] += 2.5 * ay / radius * STEP
            elif speed > mu_r * G * STEP:
                v[i, 0] -= mu_r * G * v[i, 0] / speed * STEP
                v[i, 1] -= mu_r * G * v[i, 1] / speed * STEP
                w[i, 0], w[i, 1] = -v[i, 1] / radius, v[i, 0] / radius
            else:
                v[i, 0] = v[i, 1] = w[i, 0] = w[i, 1] = 0.0
            if abs(w[i, 2]) > 10 * STEP:
                w[i, 2] -= math.copysign(10 * STEP, w[i, 2])
            x[i, 0] += v[i, 0] * STEP
            x[i, 1] += v[i, 1] * STEP
            if pocket > 0:
                for px in (0.0, length / 2, length):
                    for py in (0.0, width):
                        if not gone[i] and math.hypot(x[i, 0] - px, x[i, 1] - py) < pocket:
                            gone[i] = True
                            count = _note(log, count, t, 3, i, 0, speed)
                            x[i] = np.nan
            if gone[i]:
                continue
            for side in range(4):
                axis = side // 2
                sign = 1.0 if side % 2 == 0 else -1.0
                wall = (length, width)[axis]
                depth = x[i, axis] - radius if sign > 0 else wall - radius - x[i, axis]
                vn = v[i, axis] * sign
                if depth < 0 and vn < 0:
                    tang = 1 - axis
                    e = 0.85
                    if law == SPEED_DEPENDENT:
                        e = max(0.88 + 0.08 * vn, 0.5)
                    elif law == GRIPPING:
                        e = max(0.80 + 0.05 * vn, 0.5)
                    jn = -(1 + e) * vn
                    v[i, axis] += jn * sign
                    if law != MIRROR:
                        # Coulomb friction at the height of the centre: side spin grips the rubber
                        nx, ny = (sign, 0.0) if axis == 0 else (0.0, sign)
                        surface = v[i, tang] + (w[i, 2] * -radius * (nx if axis == 0 else -ny))
                        grip = (0.15 if law == SPEED_DEPENDENT else 0.3) * jn
                        j = min(grip, abs(surface) * 2 / 7) * (-1.0 if surface > 0 else 1.0)
                        v[i, tang] += j
                        w[i, 2] += 2.5 / radius * j * (-(nx if axis == 0 else -ny))
                    if law == GRIPPING:
                        # the nose above the centre takes a part of the top spin
                        w[i, 0] *= 0.6
                        w[i, 1] *= 0.6
                    count = _note(log, count, t, 1, i, side, -vn)
        for i in range(n):
            for j in range(i + 1, n):
                if gone[i] or gone[j]:
                    continue
                dx, dy = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1]
                d = math.hypot(dx, dy)
                if d >= 2 * radius:
                    touching[i, j] = False
                    continue
                nx, ny = dx / d, dy / d
                closing = (v[i, 0] - v[j, 0]) * nx + (v[i, 1] - v[j, 1]) * ny
                if closing <= 0:
                    continue
                jn = (1 + e_ball) / 2 * closing
                tx, ty = -ny, nx
                sx = (v[i, 0] - v[j, 0]) * tx + (v[i, 1] - v[j, 1]) * ty + radius * (w[i, 2] + w[j, 2])
                jt = min(mu_ball * jn, abs(sx) / 7) * (1.0 if sx > 0 else -1.0)
                for k, s in ((i, -1.0), (j, 1.0)):
                    v[k, 0] += s * (jn * nx + jt * tx)
                    v[k, 1] += s * (jn * ny + jt * ty)
                    w[k, 2] -= 2.5 / radius * jt
                if not touching[i, j]:
                    count = _note(log, count, t, 2, i, j, closing)
                touching[i, j] = True
    return path, log[:count]


def play(
    x, v, w, *, seconds, fps, radius=0.028575, length=2.54, width=1.27, mu_s=0.2, mu_r=0.01, e_ball=0.95, mu_ball=0.06,
    law=MIRROR, pocket=0.0,
):  # type: ignore[no-untyped-def]  # fmt: skip
    """Positions (T, N, 2) at `fps`, and contacts (E, 5): t, kind (1 cushion, 2 ball, 3 pocket), ball, other, speed.

    Starts are x, v (N, 2) m, m/s and w (N, 3) rad/s; balls start to move at t = 0.
    """
    every = round(1 / (fps * STEP))
    steps = int(seconds / STEP)
    start = [np.array(a, dtype=float) for a in (x, v, w)]
    path, log = _run(
        *start, radius, length, width, mu_s, mu_r, e_ball, mu_ball, law, steps, every, np.zeros((2000, 5)), pocket
    )
    return np.arange(len(path)) * every * STEP, path, log
