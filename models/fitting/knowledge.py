"""What is known of billiards before anything is seen, as pseudo-observations with honest standard deviations.

Real cushions and cloths obey no single law: paths are continuous, balls touch at two radii, cushions at one, equal
masses share momentum, spin survives a contact with another ball, and coefficients are about what tables have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.billiards.motion import STATE, kinematics_jacobian
from models.effects.catalogue import prior_of
from models.fitting.contacts import INWARD, cushion_distances
from models.fitting.solution import SHARED, Layout, Solution
from models.fitting.story import Contact, Span
from models.scene import CUSHIONS, Table

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

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
DIAMETER_SIGMA = 0.02
"""relative: one factor per clip on the distance of touching balls, for what the calibration misses."""
NOSE_SIGMA = 0.004
"""m: one offset per cushion, for what the calibration misses and the rubber gives."""
EXTRA_SIGMA = 0.02
"""m/s^2 per axis: slope, nap and drag, per span."""
SLIP_SIGMA = 0.7
"""slip after a strike, over the speed."""
CONTINUITY_SIGMA = 2e-4
"""m: paths do not jump at contacts."""
TOUCH_SIGMA = 8e-4
"""m: scatter of the distance of touching balls."""
RUBBER = np.array([CUSHION_RESTITUTION[0], 0.0, 0.5])
RUBBER_SIGMA = np.array([CUSHION_RESTITUTION[1], 0.04, 0.5])
"""Restitution, its change with speed (s/m), grip: between a nose that slips and one that sticks. Mathavan 2010 has the
nose stick, so that a ball leaves with a slip of its speed of arrival, however it span; a mirror has it slip."""
RESTITUTION_SCATTER, SPIN_SCATTER = 0.03, 0.12
"""Of the speed into the cushion: what laws with these three numbers miss of each other."""
NOSE_SCATTER = 1.5e-3
"""m: scatter of where balls meet a nose."""
_LONE = 5.0
"""m/s: prior standard deviation of a velocity."""


@dataclass(frozen=True, slots=True)
class Rows:
    """M pseudo-observations in standard deviations, and their derivatives by few of P numbers each, row by row."""

    residual: Floats
    """(M,)"""
    slope: Floats
    """(E,) derivatives of all rows, one after the other."""
    column: Ints
    """(E,) which number each is of."""
    first: Ints
    """(M + 1,) where each row begins."""


@dataclass(frozen=True, slots=True)
class _Around:
    """Where the L numbers that a law speaks of stand among the P of a fit, and in its own rows."""

    columns: Ints
    """(L,)"""
    span: dict[int, int]
    """First row entry of a span; contacts, globals: the same."""
    contact: dict[int, int]
    globals: int


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A vector (d,) and its derivatives (d, L)."""

    value: Floats
    slope: Floats

    def __add__(self, other: _Quantity) -> _Quantity:
        return _Quantity(self.value + other.value, self.slope + other.slope)

    def __sub__(self, other: _Quantity) -> _Quantity:
        return _Quantity(self.value - other.value, self.slope - other.slope)

    def times(self, matrix: Floats) -> _Quantity:
        """Left-multiplied by a constant matrix (m, d)."""
        return _Quantity(matrix @ self.value, matrix @ self.slope)


class Knowledge:
    """Rows of pseudo-observations, collected one law at a time."""

    def __init__(self, now: Solution, frame: Solution, plan: Layout, table: Table) -> None:
        self.now, self.frame, self.plan, self.table = now, frame, plan, table
        self._value: list[Floats] = []
        self._slope: list[Floats] = []
        self._column: list[Ints] = []
        self._length: list[int] = []
        self._ends = self._at_ends(now)
        self._frame_ends = self._at_ends(frame)[0] if frame is not now else self._ends[0]
        self._around = self._looking_at((), ())

    def rows(self) -> Rows:
        """All that was said."""
        first = np.concatenate([[0], np.cumsum(self._length)]).astype(np.int64)
        return Rows(
            np.concatenate(self._value), np.concatenate(self._slope), np.concatenate(self._column), first
        )  # fmt: skip

    def contact(self, number: int) -> None:
        """What is known about one contact."""
        contact, spans = self.now.story.contacts[number], self.now.story.spans
        starts = [start for k in contact.before if (start := spans[k].start) is not None]
        self._around = self._looking_at((*contact.before, *contact.after), (number, *starts))
        before = [self._end(k) for k in contact.before]
        after = [self._start(k) for k in contact.after]
        if contact.kind == "jump":
            self._say(self._time(number), np.array([0.01]))
            return
        for one, two in zip(before, after, strict=True):
            self._say(one.times(_X) - two.times(_X), np.full(2, CONTINUITY_SIGMA))
        if contact.kind == "ball":
            self._touch(contact, before, after)
        elif contact.kind == "cushion":
            self._bounce(contact, before[0], after[0])
        elif contact.pushed:
            self._spin_survives(after[0] - before[0], float(np.hypot(*self._state(contact.after[0])[2:4])))

    def span(self, number: int) -> None:
        """Slip, extra acceleration and velocity have priors; the slip after a ball contact is told there."""
        span = self.now.story.spans[number]
        if span.static:
            return
        self._around = self._looking_at((number,), ())
        start = self._start(number)
        speed = float(np.hypot(*self.frame.story.spans[number].state[2:4]))
        self._say(start.times(_V), np.full(2, _LONE))
        self._say(start.times(_C), np.full(2, EXTRA_SIGMA))
        begun = None if span.start is None else self.now.story.contacts[span.start]
        if begun is None or begun.kind in ("free", "jump") or (begun.kind == "strike" and not begun.pushed):
            self._say(start.times(_U), np.full(2, SLIP_SIGMA * speed + 0.2))

    def coefficients(self) -> None:
        """Priors of what all spans share."""
        self._around = self._looking_at((), ())
        identity = np.eye(SHARED)
        friction = self.now.friction
        value = np.concatenate(
            [[np.log(friction.sliding / SLIDING_PRIOR[0]), np.log(friction.rolling / ROLLING_PRIOR[0])],
             [self.now.diameter - 1], self.now.nose, self.now.rubber - RUBBER]
        )  # fmt: skip
        sigma = np.array([SLIDING_PRIOR[1], ROLLING_PRIOR[1], DIAMETER_SIGMA, *[NOSE_SIGMA] * 4, *RUBBER_SIGMA])
        self._say(_Quantity(value, identity), sigma)

    def _touch(self, contact: Contact, before: list[_Quantity], after: list[_Quantity]) -> None:
        """Two balls: distance, momentum, restitution, little friction, spin that survives."""
        apart = after[1].times(_X) - after[0].times(_X)
        distance = float(np.hypot(*apart.value))
        normal = apart.value / max(distance, 1e-9)
        frame_apart = self._state(contact.after[1])[:2] - self._state(contact.after[0])[:2]
        n = frame_apart / max(float(np.hypot(*frame_apart)), 1e-9)
        reach = 2 * self.table.ball_radius
        slope = normal @ apart.slope
        slope[self._around.globals + 2] -= reach
        self._say(_Quantity(np.array([distance - reach * self.now.diameter]), slope[None]), np.array([TOUCH_SIGMA]))
        if contact.driven:
            return
        tangent = np.array([[-n[1], n[0]]])
        changes = [two - one for one, two in zip(before, after, strict=True)]
        closing = float((self._frame_ends[contact.before[0]][2:4] - self._frame_ends[contact.before[1]][2:4]) @ n)
        hit = max(abs(closing), 0.02)
        momentum = changes[0].times(_V) + changes[1].times(_V)
        self._say(momentum, np.full(2, 0.03 * hit + 0.01))
        back = (after[1] - after[0]).times(_V).times(n[None]) + (before[1] - before[0]).times(_V).times(
            n[None] * BALL_RESTITUTION[0]
        )
        self._say(back, np.array([BALL_RESTITUTION[1] * hit + 0.01]))
        for change in changes:
            self._say(change.times(_V).times(tangent), np.array([0.06 * hit + 0.01]))
            self._spin_survives(change, hit)

    def _spin_survives(self, change: _Quantity, hit: float) -> None:
        """A ball that another one hits at `hit` m/s keeps its spin: its slip changes as its velocity does."""
        self._say(change.times(_U) - change.times(_V), np.full(2, 0.12 * hit + 0.03))

    def _bounce(self, contact: Contact, before: _Quantity, after: _Quantity) -> None:
        """A cushion: distance, restitution, some friction, spin that partly survives."""
        side = CUSHIONS.index(contact.cushion)
        n = INWARD[side][None]
        tangent = np.array([[-n[0, 1], n[0, 0]]])
        distance = cushion_distances(after.value[:2], self.table)[side] - self.table.ball_radius - self.now.nose[side]
        slope = n @ after.times(_X).slope
        slope[0, self._around.globals + 3 + side] -= 1
        self._say(_Quantity(np.array([distance]), slope), np.array([NOSE_SCATTER]))
        velocity = self._frame_ends[contact.before[0]][2:4]
        hit, pace = max(float(-(n @ velocity)[0]), 0.02), float(np.hypot(*velocity))
        e, slower, grip = self.now.rubber
        column = self._around.globals + 7
        coming, leaving = before.times(_V).times(n), after.times(_V).times(n)
        back = leaving + coming.times(np.array([[e + slower * hit]]))
        back.slope[0, column : column + 2] += coming.value * [1.0, hit]
        self._say(back, np.array([RESTITUTION_SCATTER * hit + 0.02]))
        change = after - before
        self._say(change.times(_V).times(tangent), np.array([0.25 * pace + 0.02]))
        turned = change.times(_U) - change.times(_V)
        # what a nose that sticks would stop
        stopped = before.times(_U).times(n) - coming.times(np.array([[self.frame.rubber[0]]]))
        along = turned.times(n) + stopped.times(np.array([[grip]]))
        along.slope[0, column + 2] += stopped.value[0]
        self._say(along, np.array([SPIN_SCATTER * hit + 0.05 * pace + 0.03]))
        self._say(turned.times(tangent), np.array([0.2 * hit + 0.05 * pace + 0.05]))

    def _time(self, number: int) -> _Quantity:
        """Of a contact, relative to where it stands: nothing else holds the time of a jump."""
        slope = np.zeros((1, len(self._around.columns)))
        slope[0, self._around.contact[number]] = 1.0
        moved = self.now.story.contacts[number].t - self.frame.story.contacts[number].t
        return _Quantity(np.array([moved]), slope)

    def _say(self, quantity: _Quantity, sigma: Floats) -> None:
        slope = quantity.slope / sigma[:, None]
        row, entry = np.nonzero(slope)
        self._value.append(quantity.value / sigma)
        self._slope.append(slope[row, entry])
        self._column.append(self._around.columns[entry])
        self._length.extend(np.bincount(row, minlength=len(sigma)).tolist())

    def _looking_at(self, spans: tuple[int, ...], contacts: tuple[int, ...]) -> _Around:
        """The numbers of some spans and contacts, and those that all share."""
        columns: list[int] = []
        of_span, of_contact = {}, {}
        for k in dict.fromkeys(spans):
            of_span[k] = len(columns)
            columns += range(self.plan.span[k], self.plan.span[k] + _size(self.now.story.spans[k]))
        for k in dict.fromkeys(contacts):
            of_contact[k] = len(columns)
            columns.append(self.plan.contact + k)
        shared = len(columns)
        columns += range(self.plan.globals, self.plan.globals + SHARED)
        return _Around(np.array(columns, dtype=np.int64), of_span, of_contact, shared)

    def _state(self, span: int) -> Floats:
        return self.frame.story.spans[span].state

    def _start(self, span: int) -> _Quantity:
        """State at the start (8,)."""
        described = self.now.story.spans[span]
        slope = np.zeros((STATE, len(self._around.columns)))
        size, first = _size(described), self._around.span[span]
        slope[np.arange(size), first + np.arange(size)] = 1.0
        return _Quantity(described.state, slope)

    def _end(self, span: int) -> _Quantity:
        """State at the end (8,); the extra acceleration is of no interest there and zero."""
        described, around = self.now.story.spans[span], self._around
        value, slope = np.zeros(STATE), np.zeros((STATE, len(around.columns)))
        first = around.span[span]
        if described.static:
            value[:2] = described.state[:2]
            slope[[0, 1], [first, first + 1]] = 1.0
            return _Quantity(value, slope)
        ends, slopes, index = self._ends
        value[:6] = ends[span]
        local = slopes[index[span]]  # (6, 11)
        slope[:6, first : first + STATE] = local[:, :STATE]
        slope[:6, around.globals : around.globals + 2] = local[:, STATE + 1 :]
        if described.end is not None:
            slope[:6, around.contact[described.end]] += local[:, STATE]
        if described.start is not None:
            slope[:6, around.contact[described.start]] -= local[:, STATE]
        return _Quantity(value, slope)

    @staticmethod
    def _at_ends(solution: Solution) -> tuple[Floats, Floats, dict[int, int]]:
        """Position, velocity, slip (S, 6) of all spans at their ends, with Jacobians of the moving ones."""
        story = solution.story
        moving = [k for k, span in enumerate(story.spans) if not span.static and span.end is not None]
        ends = np.zeros((len(story.spans), 6))
        for k, span in enumerate(story.spans):
            ends[k, :2] = span.state[:2]
        if not moving:
            return ends, np.empty((0, 6, STATE + 3)), {}
        states = np.array([story.spans[k].state for k in moving])
        tau = np.array([story.finish(k) - story.begin(k) for k in moving])
        ends[moving], slopes = kinematics_jacobian(states, tau, solution.friction)
        return ends, slopes, {k: row for row, k in enumerate(moving)}


def _size(span: Span) -> int:
    """How many numbers of a span are sought."""
    return 2 if span.static else STATE


_X, _V, _U, _C = (np.eye(STATE)[k : k + 2] for k in (0, 2, 4, 6))
