"""What is known of a span before anything is seen: how fast balls are, how they slip at first, what tilts their ways.

Rows of pseudo-observations are written into `told`: values (M,), derivatives and their columns one row after the
other, and where each row begins, as the fields of `models.estimation.joint_fit.physics_priors.Rows`.
"""

from __future__ import annotations

import numpy as np

from models.estimation.joint_fit.fit_arrays import BURST, FREE, JUMP, NONE, STRIKE
from models.numerics.jit import compiled

EXTRA_SIGMA = 0.02
"""m/s^2 per axis: slope, nap and drag, per span."""
LOOSE_SLIP = 0.7, 0.2
"""Slip of a ball that begins to move for an unknown cause, over its speed, and m/s."""
STRUCK_SLIP, SWERVE_SLIP, LEAST_SLIP = 0.5, 0.25, 0.1
"""Slip after a strike less that of a ball hit in its middle, over the speed, along the way and across it, and m/s. A
cue that hits the middle gives no spin, so that the ball slips with all its velocity; a fifth of a radius above or below
takes or adds half of that. Across the way only a raised cue makes a ball slip (Coriolis 1835)."""
_LONE = 5.0
"""m/s: prior standard deviation of a velocity."""


@compiled
def say_of_span(bones, span, state, frame_state, told, count):  # type: ignore[no-untyped-def]
    """Slip, extra acceleration and velocity have priors; the slip after a ball contact is told there."""
    start, column = bones.start[span], bones.column[span]
    speed = np.hypot(frame_state[2], frame_state[3])
    if start == NONE or bones.kind[start] in (FREE, JUMP, BURST):
        for k in (4, 5):
            sigma = LOOSE_SLIP[0] * speed + LOOSE_SLIP[1]
            count = say_one(told, count, state[k] / sigma, column + k, 1 / sigma)
    elif bones.kind[start] == STRIKE and not bones.pushed[start]:
        count = _say_of_strike(state, frame_state, column, told, count)
    for k in (2, 3, 6, 7):
        sigma = _LONE if k < 4 else EXTRA_SIGMA
        count = say_one(told, count, state[k] / sigma, column + k, 1 / sigma)
    return count


@compiled
def _say_of_strike(state, frame_state, column, told, count):  # type: ignore[no-untyped-def]
    """A ball that a cue struck slips with its velocity, more or less so along its way, hardly otherwise across it."""
    speed = np.hypot(frame_state[2], frame_state[3])
    ahead = (frame_state[2] / speed, frame_state[3] / speed) if speed > 0 else (1.0, 0.0)
    for share, (x, y) in ((STRUCK_SLIP, ahead), (SWERVE_SLIP, (-ahead[1], ahead[0]))):
        sigma = share * speed + LEAST_SLIP
        told[0][count] = ((state[4] - state[2]) * x + (state[5] - state[3]) * y) / sigma
        at = told[3][count]
        for k, way in ((4, x), (5, y), (2, -x), (3, -y)):
            at = enter(told, at, column + k, way / sigma)
        count += 1
        told[3][count] = at
    return count


@compiled
def say_one(told, count, value, column, slope):  # type: ignore[no-untyped-def]
    """A row that speaks of one number only."""
    told[0][count] = value
    told[3][count + 1] = enter(told, told[3][count], column, slope)
    return count + 1


@compiled
def enter(told, at, column, slope):  # type: ignore[no-untyped-def]
    """One derivative more, where it is not zero."""
    if slope != 0.0:
        told[1][at], told[2][at] = slope, column
        at += 1
    return at
