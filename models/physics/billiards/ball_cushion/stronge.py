"""Cushion with springs along and across the contact: Stronge's compliant impact with Coulomb friction.

W. J. Stronge, Impact Mechanics (Cambridge University Press 2000, doi:10.1017/CBO9780511626432), ch. 5: a point at the
nose carries a normal spring (stiffness k; k / e^2 while it returns, so that it returns e^2 of its energy) and a
tangential spring (k / eta^2, the ratio of half-spaces: eta^2 = (2 - nu) / (2 (1 - nu))). The tip sticks while the
tangential force is below mu times the normal force, else it slides. For a sphere the two directions do not act on each
other and the slip stays in its plane, so the ball's surface obeys, with time in units of the normal
frequency, q the slip speed over (mu times the closing speed), phi the tangential force over (mu times the greatest
normal force):

    normal force     F = sin(tau) until pi/2, then cos(x), x = (tau - pi/2) / e, until x = pi/2
    sliding          phi = s F,              q' = -7/2 phi,     while s (q - s eta^2 F') > 0
    sticking         phi' = q / eta^2,       q' = -7/2 phi,     while |phi| < F

Unlike with a rigid nose, the slip can change its sign: the rubber returns tangential energy.
"""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import (
    CUSHION_PARAMETERS,
    NOSE_HEIGHT,
    NOSE_HEIGHT_PARAMETER,
    ContactModel,
    apply_cushion_impulse,
    contact_inclination,
    contact_velocities,
    restitution_at_speed,
)

# Poisson's ratio of the nose as a half-space. 0.3 makes the tangential frequency 1.70 times the normal one, 0.5 makes
# it 1.53.
POISSON_RATIO = 0.3
# Normal over tangential stiffness of the nose.
ETA_SQUARED = (2.0 - POISSON_RATIO) / (2.0 * (1.0 - POISSON_RATIO))
# Inverse tangential inertia of a solid sphere over the normal one.
BETA = 3.5
# Tangential over normal frequency.
FREQUENCY_RATIO = (BETA / ETA_SQUARED) ** 0.5

_MU = parameter_vector.CUSHION_MU
_HALF_PI = 0.5 * np.pi
# Number of times at which the end of sticking is searched: a tenth of the shortest half period apart.
_SCAN = 32


@compile_kernel
def normal_force(tau, e):  # type: ignore[no-untyped-def]
    """Return F, F' and the impulse so far (in units of the closing speed) at the time tau."""
    if tau.real <= _HALF_PI:
        return np.sin(tau), np.cos(tau), 2.0 * np.sin(0.5 * tau) ** 2
    x = (tau - _HALF_PI) / e
    return np.cos(x), -np.sin(x) / e, 1.0 + e * np.sin(x)


@compile_kernel
def sticking_state(tau, start, q, phi):  # type: ignore[no-untyped-def]
    """Return q, phi and phi' at tau of a tip that sticks since `start`, where it had q and phi."""
    sine, cosine = np.sin(FREQUENCY_RATIO * (tau - start)), np.cos(FREQUENCY_RATIO * (tau - start))
    slip = q * cosine - ETA_SQUARED * FREQUENCY_RATIO * phi * sine
    return slip, phi * cosine + q / (ETA_SQUARED * FREQUENCY_RATIO) * sine, slip / ETA_SQUARED


@compile_kernel
def sticking_margin(tau, start, q, phi, e):  # type: ignore[no-untyped-def]
    """Return F - |phi| of a sticking tip, and its derivative by tau."""
    force, rate, _ = normal_force(tau, e)
    _, tangential, tangential_rate = sticking_state(tau, start, q, phi)
    if tangential.real < 0.0:
        return force + tangential, rate + tangential_rate
    return force - tangential, rate - tangential_rate


@compile_kernel
def sticking_end_time(start, q, phi, e):  # type: ignore[no-untyped-def]
    """Find the first time after `start` when the tip starts to slide; at the end of the contact it always does."""
    first, last = start.real, _HALF_PI * (1.0 + e.real)
    low, high = first, last
    for i in range(1, _SCAN + 1):
        high = first + (last - first) * i / _SCAN
        if i == _SCAN or sticking_margin(0.0 * start + high, start, q, phi, e)[0].real < 0.0:
            break
        low = high
    for _ in range(60):
        middle = 0.5 * (low + high)
        if sticking_margin(0.0 * start + middle, start, q, phi, e)[0].real < 0.0:
            high = middle
        else:
            low = middle
    tau = 0.0 * start + 0.5 * (low + high)
    value, rate = sticking_margin(tau, start, q, phi, e)
    # One step of Newton carries the derivative: the real part has converged.
    return tau - value / rate


@compile_kernel
def sliding_end_time(start, a, e):  # type: ignore[no-untyped-def]
    """Find the time when a tip stops sliding with s q + 7/2 (impulse so far) = a; negative if it slides to the end."""
    cosine = (BETA - a) / (BETA - ETA_SQUARED)
    if 0.0 <= cosine.real < 1.0 and np.arccos(cosine.real) > start.real + 1e-12:
        angle = np.arccos(cosine.real)
        return angle - (cosine - cosine.real) / np.sin(angle)
    fall = BETA * e - ETA_SQUARED / e
    sine = (a - BETA) / fall
    if 0.0 < sine.real < 1.0:
        x = np.arcsin(sine.real)
        tau = _HALF_PI + e * (x + (sine - sine.real) / np.cos(x))
        if tau.real > start.real + 1e-12:
            return tau
    return 0.0 * a - 1.0


@compile_kernel
def evaluate_final_slip(q, e):  # type: ignore[no-untyped-def]
    """Return the slip speed after the contact from q > 0 before it, both over (mu times the closing speed)."""
    tau, phi, sign, impulse = 0.0 * q, 0.0 * q, 1.0, 0.0 * q
    sliding = q.real >= ETA_SQUARED
    for _ in range(8):
        if not sliding:
            end = sticking_end_time(tau, q, phi, e)
            q, phi, _ = sticking_state(end, tau, q, phi)
            tau = end
            impulse = normal_force(tau, e)[2]
            sign = -1.0 if phi.real < 0.0 else 1.0
        end = sliding_end_time(tau, sign * q + BETA * impulse, e)
        if end.real < 0.0:
            break
        force, _, total = normal_force(end, e)
        q = q - BETA * sign * (total - impulse)
        phi, tau, impulse, sliding = sign * force, end, total, False
    return q - BETA * sign * (1.0 + e - impulse)


@compile_kernel
def rebound(vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    """Return velocity and spin after the contact; arguments and result as in `contact_model`."""
    sine, cosine = contact_inclination(p, NOSE_HEIGHT)
    closing, st, sk = contact_velocities(vn, vt, wn, wt, wz, radius, sine, cosine)
    e = restitution_at_speed(vn, p)
    normal = (1.0 + e) * closing
    slip = np.sqrt(st * st + sk * sk + 1e-300)
    e = e + 1e-9  # a spring that returns nothing has no frequency
    unit = p[_MU] * closing
    steady = BETA + np.maximum(BETA * e.real - ETA_SQUARED / e.real, 0.0)
    if slip.real >= steady * unit.real:
        share = p[_MU] * normal / slip
    elif slip.real < 1e-9 * unit.real:
        share = (1.0 - np.cos(FREQUENCY_RATIO * _HALF_PI * (1.0 + e))) / BETA
    else:
        q = slip / unit
        share = (q - evaluate_final_slip(q, e)) / (BETA * q)
    return apply_cushion_impulse(vn, vt, wn, wt, wz, radius, normal, -share * st, -share * sk, sine, cosine)


MODEL = ContactModel(
    name="stronge",
    parameters=CUSHION_PARAMETERS,
    summary="Compliant nose with springs along and across the contact, and Coulomb friction at the tip",
    reference="Stronge, Impact Mechanics, Cambridge University Press 2000, chapter 5, doi:10.1017/CBO9780511626432",
    resolve=rebound,
    standard_values=((NOSE_HEIGHT_PARAMETER, NOSE_HEIGHT),),
    rank=3,
)
