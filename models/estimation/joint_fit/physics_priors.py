"""What is known of billiards before anything is seen, as pseudo-observations with honest standard deviations.

Real cushions and cloths obey no single law: paths are continuous, balls touch at two radii, cushions at one, equal
masses share momentum, spin survives a contact with another ball, and coefficients are about what tables have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_arrays import (
    BALL,
    BURST,
    CUSHION,
    DIAMETER,
    JUMP,
    NONE,
    NOSE,
    ROLLING,
    SLIDING,
    Numbers,
    Skeleton,
    begins,
    finishes,
)
from models.estimation.joint_fit.fit_arrays import RUBBER as RUBBER_COLUMN
from models.estimation.joint_fit.fit_solution import SHARED
from models.estimation.joint_fit.segment_priors import enter, say_of_span, say_one
from models.numerics.jit import compiled
from models.physics.billiards.cloth.closed_form_motion import STATE, differentiate_one
from models.physics.effects.catalogue import prior_of

_PRIORS = {
    name: prior_of(name, parameter)
    for name, parameter in (
        ("sliding_friction", "mu"),
        ("rolling_resistance", "mu"),
        ("ball_restitution", "e"),
        ("cushion_restitution", "e"),
    )
}
SLIDING_PRIOR, ROLLING_PRIOR, BALL_RESTITUTION, CUSHION_RESTITUTION = ((p.value, p.sigma) for p in _PRIORS.values())
"""Usual value and standard deviation: of the logarithm for friction, of the number itself for restitution."""
E_BALL, E_BALL_SIGMA = BALL_RESTITUTION
DIAMETER_SIGMA = 0.02
"""relative: one factor per clip on the distance of touching balls, for what the calibration misses."""
NOSE_SIGMA = 0.004
"""m: one offset per cushion, for what the calibration misses and the rubber gives."""
CONTINUITY_SIGMA = 2e-4
"""m: paths do not jump at contacts."""
JUMP_SIGMA, BURST_SIGMA = 0.01, 1e-6
"""s: how far a jump may move in one step; when a ball leaves a burst stands."""
SLOWEST_HIT = 0.02
"""m/s: errors are not smaller for slower contacts."""
TOUCH_SIGMA = 8e-4
"""m: scatter of the distance of touching balls."""
RACK_GAP = 2e-3
"""m: balls that lie beside each other are driven apart across what is between them, which says little of their size."""
ODD_TOUCH, ODDEST_TOUCH = 2.5, 2.0
"""standard deviations beyond which a touch counts less, and by how much its own one grows at most: a pair that never
met must not resize all balls, nor be believed where it lies far apart."""
RUBBER = np.array([CUSHION_RESTITUTION[0], 0.0, 0.5])
RUBBER_SIGMA = np.array([CUSHION_RESTITUTION[1], 0.04, 0.5])
"""Restitution, its change with speed (s/m), grip: between a nose that slips and one that sticks. Mathavan 2010 has the
nose stick, so that a ball leaves with a slip of its speed of arrival, however it span; a mirror has it slip."""
RESTITUTION_SCATTER, SPIN_SCATTER = 0.03, 0.12
"""Of the speed into the cushion: what laws with these three numbers miss of each other."""
NOSE_SCATTER = 1.5e-3
"""m: scatter of where balls meet a nose."""

_SHARED_SIGMA = np.array([SLIDING_PRIOR[1], ROLLING_PRIOR[1], DIAMETER_SIGMA, *[NOSE_SIGMA] * 4, *RUBBER_SIGMA])
"""Of the numbers that all spans share, in their order."""
MOST_ROWS = 15
"""What one contact says at most."""
MOST_NUMBERS = 48
"""On which one of these rows depends at most: four spans, three contacts and what all share."""


@dataclass(frozen=True, slots=True)
class Rows:
    """M pseudo-observations in standard deviations, and their derivatives by few of P numbers each, row by row."""

    residual: FloatArray
    """(M,)"""
    slope: FloatArray
    """(E,) derivatives of all rows, one after the other."""
    column: IntArray
    """(E,) which number each is of."""
    first: IntArray
    """(M + 1,) where each row begins."""


def known(bones: Skeleton, now: Numbers, frame: Numbers, table: Table) -> Rows:
    """What physics and priors say of the numbers `now`; standard deviations that depend on speeds are of `frame`."""
    shared = now.shared
    usual = np.array([np.log(shared[SLIDING] / SLIDING_PRIOR[0]), np.log(shared[ROLLING] / ROLLING_PRIOR[0])])
    usual = np.concatenate([usual, [shared[DIAMETER] - 1], shared[NOSE:RUBBER_COLUMN], shared[RUBBER_COLUMN:] - RUBBER])
    size = np.array([table.length, table.width, table.ball_radius])
    return Rows(*_known(bones, now, frame, size, usual / _SHARED_SIGMA))


@compiled
def _known(bones, now, frame, table, usual):  # type: ignore[no-untyped-def]
    """The fields of `Rows`; `table` is its length, width and ball radius, `usual` (10,) what priors say of the shared
    numbers."""
    spans, contacts = len(bones.ball), len(bones.kind)
    most = MOST_ROWS * contacts + 6 * spans + SHARED
    room = MOST_ROWS * contacts * MOST_NUMBERS + 12 * spans + SHARED
    told = (np.empty(most), np.empty(room), np.empty(room, np.int64), np.zeros(most + 1, np.int64))
    end, slope = ends(bones, now)
    frame_end, _ = ends(bones, frame)
    count = 0
    law = (
        np.empty(MOST_ROWS), np.empty(MOST_ROWS), np.zeros((MOST_ROWS, 2, 6)), np.zeros((MOST_ROWS, 2, STATE)),
        np.zeros((MOST_ROWS, SHARED)),
    )  # fmt: skip
    for contact in range(contacts):
        rows = _contact(bones, contact, now, end, frame, frame_end, table, law)
        count = _say_of_contact(bones, contact, rows, law, slope, told, count)
    for span in range(spans):
        if not bones.static[span]:
            count = say_of_span(bones, span, now.state[span], frame.state[span], told, count)
    for k in range(SHARED):
        count = say_one(told, count, usual[k], bones.first_shared + k, 1 / _SHARED_SIGMA[k])
    entries = told[3][count]
    return told[0][:count].copy(), told[1][:entries].copy(), told[2][:entries].copy(), told[3][: count + 1].copy()


@compiled
def ends(bones, numbers):  # type: ignore[no-untyped-def]
    """Position, velocity, slip (S, 6) of spans at their ends, and the derivatives (S, 6, 11) of the moving ones."""
    begin, finish = begins(bones, numbers.t), finishes(bones, numbers.t)
    end, slope = np.zeros((len(begin), 6)), np.zeros((len(begin), 6, STATE + 3))
    slid, ds = np.empty(7), np.empty((7, STATE + 3))
    sliding, rolling = numbers.shared[SLIDING], numbers.shared[ROLLING]
    for k in range(len(begin)):
        if bones.static[k] or bones.end[k] == NONE:
            end[k, :2] = numbers.state[k, :2]
        else:
            differentiate_one(numbers.state[k], finish[k] - begin[k], sliding, rolling, slid, ds, end[k], slope[k])
    return end, slope


@compiled
def _contact(bones, c, now, end, frame, frame_end, table, law):  # type: ignore[no-untyped-def]
    """What is known about one contact, as rows of `law`: values, standard deviations, and their derivatives by the
    ends (rows, 2, 6) and starts (rows, 2, 8) of the spans of its balls and by the shared numbers (rows, 10)."""
    value, sigma, by_end, by_start, by_shared = law
    by_end.fill(0.0)
    by_start.fill(0.0)
    by_shared.fill(0.0)
    if bones.kind[c] == JUMP or bones.kind[c] == BURST:  # nothing else holds the time of a jump
        value[0], sigma[0] = now.t[c] - frame.t[c], JUMP_SIGMA if bones.kind[c] == JUMP else BURST_SIGMA
        return _leave(bones, c, now, law) if bones.kind[c] == BURST else 1
    rows = 0
    for ball in range(2):
        if bones.before[c, ball] != NONE:
            for axis in range(2):
                by_end[rows, ball, axis], by_start[rows, ball, axis] = 1.0, -1.0
                sigma[rows] = CONTINUITY_SIGMA
                rows += 1
    offset = np.zeros(MOST_ROWS)
    if bones.kind[c] == BALL:
        rows = _touch(bones, c, now, frame, frame_end, table, law, offset, rows)
    elif bones.kind[c] == CUSHION:
        rows = _bounce(bones, c, now, end, frame, frame_end, table, law, offset, rows)
    elif bones.pushed[c]:
        hit = np.hypot(frame.state[bones.after[c, 0], 2], frame.state[bones.after[c, 0], 3])
        rows = _spin_survives(law, rows, 0, hit)
    for row in range(rows):
        value[row] = offset[row]
        for ball in range(2):
            if bones.before[c, ball] != NONE:
                for k in range(6):
                    value[row] += by_end[row, ball, k] * end[bones.before[c, ball], k]
                for k in range(STATE):
                    value[row] += by_start[row, ball, k] * now.state[bones.after[c, ball], k]
    return rows


@compiled
def _leave(bones, c, now, law):  # type: ignore[no-untyped-def]
    """A ball that was in a burst is where the play has it."""
    value, sigma, _, by_start, _ = law
    state = now.state[bones.after[c, 0]]
    for row in range(6):
        value[row + 1], sigma[row + 1] = 0.0, 1.0
        for k in range(6):
            by_start[row + 1, 0, k] = bones.whiten[c, row, k]
            value[row + 1] += bones.whiten[c, row, k] * (state[k] - bones.leaves[c, k])
    return 7


@compiled
def _touch(bones, c, now, frame, frame_end, table, law, offset, row):  # type: ignore[no-untyped-def]
    """Two balls: distance, momentum, restitution, little friction, spin that survives."""
    _, sigma, by_end, by_start, by_shared = law
    line, reach = _line_of_centres(bones, c, now.state), 2 * table[2]
    for axis in range(2):
        by_start[row, 1, axis], by_start[row, 0, axis] = line[axis], -line[axis]
    by_shared[row, DIAMETER] = -reach
    offset[row] = -reach * now.shared[DIAMETER]
    sigma[row] = RACK_GAP if bones.driven[c] else _touch_sigma(bones, c, frame, reach)
    row += 1
    if bones.driven[c]:
        return row
    n, one, two = _line_of_centres(bones, c, frame.state), bones.before[c, 0], bones.before[c, 1]
    closing = (frame_end[one, 2] - frame_end[two, 2]) * n[0] + (frame_end[one, 3] - frame_end[two, 3]) * n[1]
    hit = max(abs(closing), SLOWEST_HIT)
    for axis in range(2):  # momentum
        for ball in range(2):
            by_start[row, ball, 2 + axis], by_end[row, ball, 2 + axis] = 1.0, -1.0
        sigma[row] = 0.03 * hit + 0.01
        row += 1
    for axis in range(2):  # restitution
        by_start[row, 1, 2 + axis], by_start[row, 0, 2 + axis] = n[axis], -n[axis]
        by_end[row, 1, 2 + axis], by_end[row, 0, 2 + axis] = E_BALL * n[axis], -E_BALL * n[axis]
    sigma[row] = E_BALL_SIGMA * hit + 0.01
    row += 1
    for ball in range(2):
        _change(law, row, ball, 2, (-n[1], n[0]))
        sigma[row] = 0.06 * hit + 0.01
        row = _spin_survives(law, row + 1, ball, hit)
    return row


@compiled
def _touch_sigma(bones, c, frame, reach):  # type: ignore[no-untyped-def]
    """Standard deviation of the distance of two balls at a contact, m: as a linear loss has it where it is off."""
    x = frame.state[bones.after[c, 1], 0] - frame.state[bones.after[c, 0], 0]
    y = frame.state[bones.after[c, 1], 1] - frame.state[bones.after[c, 0], 1]
    off = abs(np.hypot(x, y) - reach * frame.shared[DIAMETER]) / (ODD_TOUCH * TOUCH_SIGMA)
    return TOUCH_SIGMA * min(np.sqrt(max(off, 1.0)), ODDEST_TOUCH)


@compiled
def _spin_survives(law, row, ball, hit):  # type: ignore[no-untyped-def]
    """A ball that another one hits at `hit` m/s keeps its spin: its slip changes as its velocity does."""
    for axis in range(2):
        _turn(law, row, ball, (1.0 - axis, 0.0 + axis))
        law[1][row] = 0.12 * hit + 0.03
        row += 1
    return row


@compiled
def _turn(law, row, ball, along):  # type: ignore[no-untyped-def]
    """By how much the slip of a ball changes more than its velocity does, along a direction: its spin."""
    _change(law, row, ball, 4, along)
    _change(law, row, ball, 2, (-along[0], -along[1]))


@compiled
def _change(law, row, ball, part, along):  # type: ignore[no-untyped-def]
    """Of velocity (part 2) or slip (4) through a contact, along a direction."""
    for axis in range(2):
        law[3][row, ball, part + axis] += along[axis]
        law[2][row, ball, part + axis] -= along[axis]


@compiled
def _bounce(bones, c, now, end, frame, frame_end, table, law, offset, row):  # type: ignore[no-untyped-def]
    """A cushion: distance, restitution, some friction, spin that partly survives."""
    _, sigma, by_end, by_start, by_shared = law
    side, before = bones.side[c], bones.before[c, 0]
    axis, inward = side // 2, 1.0 - 2.0 * (side % 2)
    n = (inward, 0.0) if axis == 0 else (0.0, inward)
    tangent = (-n[1], n[0])
    by_start[row, 0, axis], by_shared[row, NOSE + side] = inward, -1.0
    offset[row] = (table[axis] if side % 2 else 0.0) - table[2] - now.shared[NOSE + side]
    sigma[row] = NOSE_SCATTER
    row += 1
    hit = max(-inward * frame_end[before, 2 + axis], SLOWEST_HIT)
    pace = np.hypot(frame_end[before, 2], frame_end[before, 3])
    e, slower, grip = now.shared[RUBBER_COLUMN], now.shared[RUBBER_COLUMN + 1], now.shared[RUBBER_COLUMN + 2]
    coming = inward * end[before, 2 + axis]
    by_start[row, 0, 2 + axis], by_end[row, 0, 2 + axis] = inward, (e + slower * hit) * inward
    by_shared[row, RUBBER_COLUMN], by_shared[row, RUBBER_COLUMN + 1] = coming, coming * hit
    sigma[row] = RESTITUTION_SCATTER * hit + 0.02
    row += 1
    _change(law, row, 0, 2, tangent)
    sigma[row] = 0.25 * pace + 0.02
    row += 1
    _turn(law, row, 0, n)
    kept = frame.shared[RUBBER_COLUMN]
    stopped = inward * (end[before, 4 + axis] - kept * end[before, 2 + axis])  # what a nose that sticks would stop
    by_end[row, 0, 4 + axis] += grip * inward
    by_end[row, 0, 2 + axis] -= grip * kept * inward
    by_shared[row, RUBBER_COLUMN + 2] = stopped
    sigma[row] = SPIN_SCATTER * hit + 0.05 * pace + 0.03
    row += 1
    _turn(law, row, 0, tangent)
    sigma[row] = 0.2 * hit + 0.05 * pace + 0.05
    return row + 1


@compiled
def _line_of_centres(bones, c, state):  # type: ignore[no-untyped-def]
    """Direction from the first ball to the second at a contact."""
    x = state[bones.after[c, 1], 0] - state[bones.after[c, 0], 0]
    y = state[bones.after[c, 1], 1] - state[bones.after[c, 0], 1]
    apart = max(np.hypot(x, y), 1e-9)
    return x / apart, y / apart


@compiled
def _say_of_contact(bones, c, rows, law, slope, told, count):  # type: ignore[no-untyped-def]
    """Write down what is known of a contact, by the numbers sought; returns how many rows are told."""
    value, sigma, by_end, by_start, by_shared = law
    for row in range(rows):
        told[0][count] = value[row] / sigma[row]
        at = told[3][count]
        shared, through = by_shared[row], 0.0
        for ball in range(2):
            before, after = bones.before[c, ball], bones.after[c, ball]
            if before == NONE:
                continue
            if bones.static[before]:
                for k in range(2):
                    at = enter(told, at, bones.column[before] + k, by_end[row, ball, k] / sigma[row])
            else:
                for k in range(STATE + 3):
                    d = 0.0
                    for j in range(6):
                        d += by_end[row, ball, j] * slope[before, j, k]
                    if k < STATE:
                        at = enter(told, at, bones.column[before] + k, d / sigma[row])
                    elif k > STATE:
                        shared[k - STATE - 1] += d
                    else:  # a later contact is a longer span, a later start of it a shorter one
                        through += d
                        if bones.start[before] != NONE:
                            at = enter(told, at, bones.first_contact + bones.start[before], -d / sigma[row])
            for k in range(2 if bones.static[after] else STATE):
                at = enter(told, at, bones.column[after] + k, by_start[row, ball, k] / sigma[row])
        if row == 0 and (bones.kind[c] == JUMP or bones.kind[c] == BURST):
            through = 1.0
        at = enter(told, at, bones.first_contact + c, through / sigma[row])
        for k in range(SHARED):
            at = enter(told, at, bones.first_shared + k, shared[k] / sigma[row])
        count += 1
        told[3][count] = at
    return count
