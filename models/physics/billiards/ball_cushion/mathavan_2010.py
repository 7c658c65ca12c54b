"""Rigid nose and rigid table with friction at both: Mathavan, Jackson and Parkin 2010.

S. Mathavan, M. R. Jackson, R. M. Parkin, "A theoretical analysis of billiard ball dynamics under cushion impacts",
Proc. IMechE Part C 224 (2010) 1863-1873, doi:10.1243/09544062JMES1964. The nose pushes against the contact normal and
so presses the ball on the cloth, which pushes back just enough to keep the ball's height; both contacts slide with
Coulomb friction. The equations of motion (those of velocity and spin per normal impulse P of the nose) are integrated
over P until the ball has stopped (compression) and then until the nose has returned e^2 of the work it took
(restitution: Stronge's energetic coefficient).

Three things differ from the paper. The friction of the cloth under a ball that the nose presses down is that of the
free cloth times `cushion_cloth.factor`. The friction of a slip s is mu s / sqrt(s^2 + (CREEP vn)^2): Coulomb's friction
jumps at rest, this one is smooth, so that a contact sticks when its slip dies away and the outcome has a derivative
everywhere; it differs from Coulomb's by up to about 10 CREEP of the speed. The equations are stiff, so the steps are
those of a linearly implicit Runge-Kutta method of order 4 with an error estimate (Shampine, ACM TOMS 8 (1982) 93-113,
doi:10.1145/355993.355994), and both ends of the phases are located exactly. With complex inputs the step length
follows the inputs too: with fixed lengths, the error of a derivative would be that of a step over CREEP.

Internally, speeds and impulses per mass are in units of vn, so the model is the same at every speed.
The functions share these arguments: y (6,) the integrated vector with the rows below, `contact` (8,) the slips at
P = 0, the friction of nose and cloth, and the inclination of the contact, `work` (11, 6) workspace. A nose below the
centre would lift the ball; in this model the cloth then carries nothing, and the ball still keeps its height.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel, copy_numbers
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import (
    CUSHION_PARAMETERS,
    NOSE_HEIGHT,
    NOSE_HEIGHT_PARAMETER,
    ContactModel,
    contact_inclination,
    restitution_at_speed,
)

# Slip over vn at which friction reaches 70 % of mu.
CREEP = 1e-5
# Error of one step, in units of vn.
TOLERANCE = 1e-8

_MU = parameter_vector.CUSHION_MU
_CLOTH = parameter_vector.SLIDING_MU
_PRESSED = parameter_vector.CUSHION_CLOTH_FACTOR

# Rows of the integrated vector: friction of the nose along t and k, of the cloth along n and t, P, work of the nose.
_NT, _NK, _CN, _CT, _P, _W = range(6)
_SIZE = 6
_MOST_STEPS = 2000
# Entries of `contact`: slip at P = 0 at the nose along t and k, at the cloth along n and t; friction; theta.
_START_NT, _START_NK, _START_CN, _START_CT, _NOSE_MU, _CLOTH_MU, _SINE, _COSINE = range(8)

# Shampine's method in the form with (1 / (h / 2) - J) on the left.
_A21, _A31, _A32 = 2.0, 48.0 / 25.0, 6.0 / 25.0
_C21, _C31, _C32 = -8.0, 372.0 / 25.0, 12.0 / 5.0
_C41, _C42, _C43 = -112.0 / 125.0, -54.0 / 125.0, -2.0 / 5.0
_B1, _B2, _B3, _B4 = 19.0 / 9.0, 0.5, 25.0 / 108.0, 125.0 / 108.0
_E1, _E2, _E4 = 17.0 / 54.0, 7.0 / 36.0, 125.0 / 108.0


@compile_kernel
def contact_slips(y, contact):  # type: ignore[no-untyped-def]
    """Return the slip at the nose along t and k, and at the cloth along n and t."""
    sine, cosine = contact[_SINE], contact[_COSINE]
    nose_t = contact[_START_NT] + 3.5 * y[_NT] + (1.0 - 2.5 * sine) * y[_CT]
    nose_k = contact[_START_NK] + sine * cosine * y[_P] + (2.5 + sine * sine) * y[_NK] + (2.5 - sine) * y[_CN]
    cloth_n = contact[_START_CN] - cosine * y[_P] + (2.5 - sine) * y[_NK] + 3.5 * y[_CN]
    cloth_t = contact[_START_CT] + (1.0 - 2.5 * sine) * y[_NT] + 3.5 * y[_CT]
    return nose_t, nose_k, cloth_n, cloth_t


@compile_kernel
def normal_speed(y, contact):  # type: ignore[no-untyped-def]
    """Return the normal speed of the centre."""
    return 1.0 - contact[_COSINE] * y[_P] - contact[_SINE] * y[_NK] + y[_CN]


@compile_kernel
def evaluate_rates(y, contact, out):  # type: ignore[no-untyped-def]
    """Write dy/dP to `out` (6,); return the normal acceleration d(vn)/dP."""
    sine, cosine = contact[_SINE], contact[_COSINE]
    st, sk, un, ut = contact_slips(y, contact)
    nose = contact[_NOSE_MU] / np.sqrt(st * st + sk * sk + CREEP * CREEP)
    out[_NT], out[_NK] = -nose * st, -nose * sk
    load = sine - cosine * out[_NK]  # of the cloth, which cannot pull
    if load.real < 0.0:
        load = 0.0 * load
    cloth = contact[_CLOTH_MU] * load / np.sqrt(un * un + ut * ut + CREEP * CREEP)
    out[_CN], out[_CT] = -cloth * un, -cloth * ut
    out[_P] = 1.0
    out[_W] = cosine * normal_speed(y, contact)
    return -cosine - sine * out[_NK] + out[_CN]


@compile_kernel
def evaluate_jacobian(y, contact, out):  # type: ignore[no-untyped-def]
    """Write the derivative of `evaluate_rates` by y to `out` (6, 6)."""
    nose_mu, cloth_mu, sine, cosine = contact[_NOSE_MU], contact[_CLOTH_MU], contact[_SINE], contact[_COSINE]
    st, sk, un, ut = contact_slips(y, contact)
    s, u = np.sqrt(st * st + sk * sk + CREEP * CREEP), np.sqrt(un * un + ut * ut + CREEP * CREEP)
    st, sk, un, ut = st / s, sk / s, un / u, ut / u
    load = sine + cosine * nose_mu * sk
    pull = cloth_mu * cosine if load.real > 0.0 else 0.0 * cloth_mu
    load = cloth_mu * load / u if load.real > 0.0 else 0.0 * load
    for j in range(_SIZE):
        dt = 3.5 if j == _NT else (1.0 - 2.5 * sine if j == _CT else 0.0)
        vt = 1.0 - 2.5 * sine if j == _NT else (3.5 if j == _CT else 0.0)
        dk, vn, dw = 0.0, 0.0, 0.0
        if j == _NK:
            dk, vn, dw = 2.5 + sine * sine, 2.5 - sine, -sine
        elif j == _CN:
            dk, vn, dw = 2.5 - sine, 3.5, 1.0
        elif j == _P:
            dk, vn, dw = sine * cosine, -cosine, -cosine
        along = st * dt + sk * dk
        out[_NT, j], out[_NK, j] = -nose_mu / s * (dt - st * along), -nose_mu / s * (dk - sk * along)
        along = un * vn + ut * vt
        more = pull * out[_NK, j]
        out[_CN, j], out[_CT, j] = more * un - load * (vn - un * along), more * ut - load * (vt - ut * along)
        out[_P, j], out[_W, j] = 0.0, cosine * dw


@compile_kernel
def factor_lu(matrix):  # type: ignore[no-untyped-def]
    """Factor a matrix (6, 6) in place: LU without pivots, because friction dissipates and the diagonal dominates."""
    for k in range(_SIZE):
        for i in range(k + 1, _SIZE):
            matrix[i, k] /= matrix[k, k]
            for j in range(k + 1, _SIZE):
                matrix[i, j] -= matrix[i, k] * matrix[k, j]


@compile_kernel
def solve_lu(matrix, b):  # type: ignore[no-untyped-def]
    """Replace `b` (6,) by the solution of the system that `factor_lu` factored."""
    for i in range(_SIZE):
        for j in range(i):
            b[i] -= matrix[i, j] * b[j]
    for i in range(_SIZE - 1, -1, -1):
        for j in range(i + 1, _SIZE):
            b[i] -= matrix[i, j] * b[j]
        b[i] /= matrix[i, i]


@compile_kernel
def take_step(y, h, contact, work, after):  # type: ignore[no-untyped-def]
    """Take one step h of P from `y` to `after` (6,); return the estimated error over TOLERANCE."""
    matrix, g1, g2, g3, g4, rate = work[:_SIZE], work[6], work[7], work[8], work[9], work[10]
    evaluate_jacobian(y, contact, matrix)
    for i in range(_SIZE):
        for j in range(_SIZE):
            matrix[i, j] = -matrix[i, j]
        matrix[i, i] += 2.0 / h
    factor_lu(matrix)
    evaluate_rates(y, contact, g1)
    solve_lu(matrix, g1)
    for i in range(_SIZE):
        after[i] = y[i] + _A21 * g1[i]
    evaluate_rates(after, contact, rate)
    for i in range(_SIZE):
        g2[i] = rate[i] + _C21 * g1[i] / h
    solve_lu(matrix, g2)
    for i in range(_SIZE):
        after[i] = y[i] + _A31 * g1[i] + _A32 * g2[i]
    evaluate_rates(after, contact, rate)
    for i in range(_SIZE):
        g3[i] = rate[i] + (_C31 * g1[i] + _C32 * g2[i]) / h
    solve_lu(matrix, g3)
    for i in range(_SIZE):
        g4[i] = rate[i] + (_C41 * g1[i] + _C42 * g2[i] + _C43 * g3[i]) / h
    solve_lu(matrix, g4)
    error = 0.0 * h
    for i in range(_SIZE):
        after[i] = y[i] + _B1 * g1[i] + _B2 * g2[i] + _B3 * g3[i] + _B4 * g4[i]
        part = _E1 * g1[i] + _E2 * g2[i] + _E4 * g4[i]
        if abs(part.real) > error.real:
            error = part if part.real > 0.0 else -part
    return error / TOLERANCE


@compile_kernel
def remaining_until_end(y, contact, restoring, work_left):  # type: ignore[no-untyped-def]
    """Return the distance to the end of the phase, > 0 before it: speed into the cushion, or work to be returned."""
    return y[_W] - work_left if restoring else normal_speed(y, contact)


@compile_kernel
def integrate_phase(y, contact, restoring, work_left, h, work, after):  # type: ignore[no-untyped-def]
    """Integrate `y` to the end of a phase, compression or restitution; return the last full step."""
    for _ in range(_MOST_STEPS):
        error = take_step(y, h, contact, work, after)
        if error.real > 1.0:
            h *= max(0.2, 0.9 * error.real ** (-1.0 / 3.0))
            continue
        if remaining_until_end(after, contact, restoring, work_left).real <= 0.0:
            finish_phase(y, h, contact, restoring, work_left, work, after)
            return h
        copy_numbers(after, y)
        h *= 0.9 / (error + 2e-3) ** 0.25
    return h


@compile_kernel
def finish_phase(y, whole, contact, restoring, work_left, work, after):  # type: ignore[no-untyped-def]
    """Integrate `y` by the part of the step `whole` that ends the phase; Newton's method finds its length."""
    before, past = (
        remaining_until_end(y, contact, restoring, work_left).real,
        remaining_until_end(after, contact, restoring, work_left).real,
    )
    normal = evaluate_rates(y, contact, work[10])
    slope = (work[10][_W] if restoring else normal).real * whole.real
    # The parabola through both ends of the step: the work starts with no slope at all.
    h = whole * (2.0 * before / (np.sqrt(slope * slope - 4.0 * (past - before - slope) * before) - slope))
    for newton in range(9):
        take_step(y, h, contact, work, after)
        if newton < 8:
            normal = evaluate_rates(after, contact, work[10])
            h -= remaining_until_end(after, contact, restoring, work_left) / (work[10][_W] if restoring else normal)
    copy_numbers(after, y)


@compile_kernel
def rebound(vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """Return velocity and spin after the contact; arguments and result as in `contact_model`."""
    e = restitution_at_speed(vn, p)
    sine, cosine = contact_inclination(p, NOSE_HEIGHT)
    y, after, work = np.zeros(_SIZE, p.dtype), np.empty(_SIZE, p.dtype), np.empty((11, _SIZE), p.dtype)
    contact = np.empty(8, p.dtype)
    contact[_START_NT] = (vt + radius * (cosine * wz - sine * wn)) / vn
    contact[_START_NK] = -sine - radius * wt / vn
    contact[_START_CN], contact[_START_CT] = 1.0 - radius * wt / vn, (vt + radius * wn) / vn
    contact[_NOSE_MU], contact[_CLOTH_MU] = p[_MU], p[_CLOTH] * p[_PRESSED]
    contact[_SINE], contact[_COSINE] = sine, cosine
    h = 0.0 * vn + 0.01
    for restoring in (False, True):
        if not restoring or e.real > 0.0:
            work_left = (1.0 - e * e) * y[_W] if restoring else 0.0 * e
            h = integrate_phase(y, contact, restoring, work_left, h, work, after)
    spin = 2.5 * vn / radius
    vn_after = vn * normal_speed(y, contact)
    if vn_after.real > 0.0:
        vn_after = 0.0 * vn_after
    return (
        vn_after,
        vt + vn * (y[_NT] + y[_CT]),
        wn + spin * (y[_CT] - sine * y[_NT]),
        wt - spin * (y[_NK] + y[_CN]),
        wz + spin * cosine * y[_NT],
    )


MODEL = ContactModel(
    name="mathavan_2010",
    parameters=(*CUSHION_PARAMETERS, "sliding_friction.mu", "cushion_cloth.factor"),
    summary="Rigid nose and rigid table, both with Coulomb friction, integrated over the normal impulse",
    reference="Mathavan, Jackson, Parkin, Proc. IMechE Part C 224 (2010) 1863-1873, doi:10.1243/09544062JMES1964",
    resolve=rebound,
    standard_values=((NOSE_HEIGHT_PARAMETER, NOSE_HEIGHT),),
    rank=2,
)
