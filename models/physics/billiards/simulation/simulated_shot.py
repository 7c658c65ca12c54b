"""What a simulated shot gave: states at any time, events, a trajectory, and derivatives by all that went in."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from models.core.events import Events
from models.core.scene import CUSHIONS, POCKETS
from models.core.trajectory import State, Trajectory
from models.core.typing import FloatArray, IntArray
from models.numerics.jit import compiled
from models.physics.billiards.cloth.cloth_motion import plan
from models.physics.billiards.cloth.forces import curved
from models.physics.billiards.cloth.motion_pieces import (
    CURVED_ROWS,
    END,
    FOREVER,
    PHASE_NAMES,
    REST,
    START,
    STRAIGHT_ROWS,
    WIDTH,
    WX,
    WY,
    X,
    Y,
    follow,
)
from models.physics.billiards.cushion_geometry import NORMALS, Rails
from models.physics.billiards.parameters import NAMES, SPIN_DECAY, Physics
from models.physics.billiards.simulation.event_engine import (
    BALL,
    FIRST,
    HOLE,
    KIND,
    LEG_BALL,
    LEG_STATE,
    LEG_TIME,
    LINE,
    SECOND,
    SPEED,
    TIME,
)
from models.physics.billiards.simulation.shot_derivatives import BALL_COLUMNS, CURVING, differentiate

STATE = 7
"""Numbers of a ball: x, y, vx, vy, wx, wy, wz."""
_SMOOTH = 1e-8
"""m, by which a cubic of a trajectory may miss a path that is none."""


@dataclass(frozen=True, slots=True)
class Balls:
    """N balls at the beginning, in the frame of the table."""

    ids: tuple[str, ...]
    state: FloatArray
    """(N, 7) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s)."""
    radius: FloatArray
    """(N,) m."""
    mass: FloatArray
    """(N,) kg."""

    def __post_init__(self) -> None:
        n = len(self.ids)
        for name, shape in (("state", (n, 7)), ("radius", (n,)), ("mass", (n,))):
            values = getattr(self, name)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"Balls.{name} must be {shape} and finite; got {values.shape}")
        if (self.radius <= 0).any() or (self.mass <= 0).any():
            raise ValueError("balls have a radius and a mass above 0")


def energy(state: FloatArray, radius: FloatArray, mass: FloatArray) -> FloatArray:
    """Kinetic energy (..., N) in J of balls in states (..., N, 7); solid spheres."""
    v, w = np.sum(state[..., 2:4] ** 2, axis=-1), np.sum(state[..., 4:7] ** 2, axis=-1)
    total: FloatArray = 0.5 * mass * (v + 0.4 * radius**2 * w)
    return total


@dataclass(frozen=True, slots=True)
class Run:
    """A shot from 0 to `seconds`."""

    balls: Balls
    rails: Rails
    physics: Physics
    seconds: float
    contacts: FloatArray
    """(E, EVENT_WIDTH) as `engine.play` logs them."""
    legs: FloatArray
    """(L, LEG_WIDTH) sorted by ball, then by time."""
    gone: FloatArray = field(init=False, repr=False)
    """(N,) s, when each ball fell into a pocket; infinite where it did not."""

    def __post_init__(self) -> None:
        gone = np.full(len(self.balls.ids), np.inf)
        for hole in self.contacts[self.contacts[:, KIND] == HOLE]:
            gone[int(hole[FIRST])] = hole[TIME]
        object.__setattr__(self, "gone", gone)

    def at(self, t: float | FloatArray) -> FloatArray:
        """States (..., N, 7) at times t (...), s; NaN for a ball in a pocket."""
        times = np.asarray(t, dtype=np.float64)
        order = np.argsort(times.reshape(-1), kind="stable")
        found = np.full((times.size, len(self.balls.ids), 7), np.nan)
        sample(
            self.legs, self.gone, self.balls.radius, self.physics.values, self.seconds,
            times.reshape(-1)[order], self.rows, found,
        )  # fmt: skip
        back = np.empty_like(found)
        back[order] = found
        return back.reshape(*times.shape, *found.shape[1:])

    @property
    def columns(self) -> tuple[str, ...]:
        """(P,) all that a shot depends on, as `jacobian` names it."""
        of_balls = [f"{ball}.{name}" for ball in self.balls.ids for name in BALL_COLUMNS]
        return (*of_balls, *NAMES, *(f"nose.{side}" for side in CUSHIONS))

    def jacobian(self, t: float | FloatArray, wrt: tuple[str, ...] | None = None) -> FloatArray:
        """Derivatives (..., N, 7, P) of the states at t (...) by `wrt`, names among `columns`.

        The order of contacts is held fixed. Without `wrt`: by the states, radii and masses of all balls and the
        parameters of the physics that are present.
        """
        columns = self.columns
        if wrt is None:
            wrt = (*columns[: len(self.balls.ids) * len(BALL_COLUMNS)], *self.physics.present)
        if unknown := set(wrt) - set(columns):
            raise ValueError(f"derivatives are by {', '.join(columns)}; got {', '.join(sorted(unknown))}")
        directions = np.zeros((len(columns), len(wrt)))
        directions[[columns.index(name) for name in wrt], np.arange(len(wrt))] = 1.0
        times = np.asarray(t, dtype=np.float64)
        place = np.arange(times.size * len(self.balls.ids)).reshape(times.size, -1)
        found = self.along(times.reshape(-1), place, directions, STATE)
        return found.reshape(*times.shape, len(self.balls.ids), STATE, len(wrt))

    def along(self, t: FloatArray, place: IntArray, directions: FloatArray, numbers: int) -> FloatArray:
        """Derivatives (K, `numbers`, C) of the states at t (T,), or with 2 `numbers` of the places alone, along
        directions (P, C) in all that the shot depends on, in the order of `columns`.

        place (T, N) says which of the K each ball is at each time, -1 where it is not asked for. The order of contacts
        is held fixed; NaN for a ball in a pocket.
        """
        return self.along_to(t, place, directions, numbers, np.inf)[0]

    def along_to(
        self, t: FloatArray, place: IntArray, directions: FloatArray, numbers: int, end: float
    ) -> tuple[FloatArray, FloatArray]:
        """The same, and derivatives (N, 7, C) of the states of all balls at the time `end`; those are NaN where it is
        infinite."""
        first = len(BALL_COLUMNS) * len(self.balls.ids)
        by_physics = np.any(directions[first : first + len(NAMES)], axis=1)
        curves = bool(curved(self.physics.values)) or bool(by_physics[list(CURVING)].any())
        order = np.argsort(t, kind="stable")
        found = np.full((int(place.max(initial=-1)) + 1, numbers, directions.shape[1]), np.nan)
        at_end = np.full((len(self.balls.ids), STATE, directions.shape[1]), np.nan)
        differentiate(
            self.legs, self.contacts, self.gone, self.balls.radius, self.balls.mass, self.physics.values,
            self.physics.codes, self.rails.lines, self.rails.arcs, NORMALS, t[order], place[order], float(end),
            np.ascontiguousarray(directions), np.flatnonzero(by_physics), CURVED_ROWS if curves else STRAIGHT_ROWS,
            found, at_end,
        )  # fmt: skip
        return found, at_end

    def state(self, t: float | FloatArray) -> State:
        """The same as a `State`, with standard deviations of 0: nothing is uncertain."""
        found = self.at(t)
        nothing = np.where(np.isnan(found[..., 0]), np.nan, 0.0)
        return State(found[..., :2], found[..., 2:4], found[..., 4:7], nothing, nothing, np.zeros(nothing.shape, bool))

    @property
    def rows(self) -> int:
        """Pieces that one leg may have."""
        return CURVED_ROWS if curved(self.physics.values) else STRAIGHT_ROWS

    @property
    def events(self) -> Events:
        """All events of the shot; times are exact, `frame` is NaN. A simulated rest is when the ball stops."""
        return self.listed(np.nan)

    def listed(self, hz: float) -> Events:
        """Strikes at 0, contacts, pockets and rests in the order of time; `frame` counts pictures at `hz`."""
        rows = [*self._strikes(), *self._contacts(), *self._rests()]
        rows.sort(key=lambda row: row[1])
        kind, t, a, b, place, speed = zip(*rows, strict=True) if rows else ((),) * 6
        times, count = np.array(t, dtype=np.float64), len(rows)
        exact, unknown = np.full(count, 1e-9), np.full(count, np.nan)
        gap = np.where(np.isin(kind, ("ball", "cushion")), 0.0, np.nan) if count else unknown
        return Events(
            tuple(kind), times, exact, times * hz, tuple(a), tuple(b), np.array(place).reshape(-1, 2), np.ones(count),
            gap, gap, np.array(speed, dtype=np.float64),
        )  # fmt: skip

    def trajectory(self) -> Trajectory:
        """Cubic pieces; where slope or drag bend the path, short ones that stay within 10 nm of it."""
        pieces, balls, phases, spins = self.pieces()
        cubics = [
            (ball, PHASE_NAMES[phase], *cubic)
            for row, ball, phase, spin in zip(pieces, balls, phases, spins, strict=True)
            for cubic in _cubics(row, spin)
        ]
        ball, name, start, end, position, turn = zip(*cubics, strict=True)
        return Trajectory(
            self.balls.ids, np.array(ball, dtype=np.int64), np.array(start), np.array(end), np.array(position),
            np.array(turn), tuple(name), np.zeros((len(cubics), 4, 4)),
        )  # fmt: skip

    def pieces(self) -> tuple[FloatArray, IntArray, IntArray, FloatArray]:
        """Polynomial pieces (M, WIDTH), their columns START and END on the clock of the shot; ball (M,), phase (M,),
        and side spin with its rate (M, 2)."""
        most = self.rows * len(self.legs)
        rows, balls, phases = np.empty((most, WIDTH)), np.empty(most, np.int64), np.empty(most, np.int64)
        spins = np.empty((most, 2))
        count = cut(
            self.legs, self.gone, self.balls.radius, self.physics.values, self.seconds, self.rows,
            rows, balls, phases, spins,
        )  # fmt: skip
        return rows[:count], balls[:count], phases[:count], spins[:count]

    def _strikes(self) -> list[tuple[str, float, str, str, FloatArray, float]]:
        moving = np.hypot(*self.balls.state[:, 2:4].T)
        return [
            ("strike", 0.0, name, "", self.balls.state[k, :2], float(moving[k]))
            for k, name in enumerate(self.balls.ids) if moving[k] > 0
        ]  # fmt: skip

    def _contacts(self) -> list[tuple[str, float, str, str, FloatArray, float]]:
        ids, places = self.balls.ids, self._places()
        found = []
        for event, place in zip(self.contacts, places, strict=True):
            kind, a, other = int(event[KIND]), ids[int(event[FIRST])], int(event[SECOND])
            if kind == BALL:
                name, b = "ball", ids[other]
            elif kind == HOLE:
                name, b = "pocket", POCKETS[other]
            else:
                sides = self.rails.lines[:, 5] if kind == LINE else self.rails.arcs[:, 3]
                name, b = "cushion", CUSHIONS[int(sides[other])]
            found.append((name, float(event[TIME]), a, b, place, float(event[SPEED])))
        return found

    def _places(self) -> FloatArray:
        """(E, 2) m, where the first ball of each contact was: there its next leg begins."""
        found = np.empty((len(self.contacts), 2))
        used = np.ones(len(self.balls.ids), dtype=np.int64)
        first = np.searchsorted(self.legs[:, LEG_BALL], np.arange(len(self.balls.ids)))
        for k, event in enumerate(self.contacts):
            a, b = int(event[FIRST]), int(event[SECOND])
            found[k] = self.legs[first[a] + used[a], LEG_STATE : LEG_STATE + 2]
            used[a] += 1
            if event[KIND] == BALL:
                used[b] += 1
        return found

    def _rests(self) -> list[tuple[str, float, str, str, FloatArray, float]]:
        pieces, balls, phases, _ = self.pieces()
        came = np.flatnonzero((phases[1:] == REST) & (phases[:-1] != REST) & (balls[1:] == balls[:-1])) + 1
        return [
            ("rest", float(pieces[k, START]), self.balls.ids[balls[k]], "", pieces[k, [X, Y]], np.nan) for k in came
        ]


@compiled
def sample(legs, gone, radius, p, seconds, times, table_rows, out):  # type: ignore[no-untyped-def]
    """Fill out (T, N, 7) with states at sorted times (T,)."""
    rows, phases, rate = np.zeros((table_rows, WIDTH)), np.zeros(table_rows, np.int64), np.zeros(7)
    for k in range(len(legs)):
        a, start = int(legs[k, LEG_BALL]), legs[k, LEG_TIME]
        last = k == len(legs) - 1 or int(legs[k + 1, LEG_BALL]) != a
        until = gone[a] if last else legs[k + 1, LEG_TIME]
        first = np.searchsorted(times, start) if start > 0.0 else 0
        after = len(times) if until == np.inf else np.searchsorted(times, until)
        if first >= after or start >= gone[a]:
            continue
        state = legs[k, LEG_STATE:]
        count = plan(state, radius[a], p, max(seconds, times[after - 1]) - start, rows, phases)
        for i in range(first, after):
            follow(rows, count, state[6], p, times[i] - start, out[i, a], rate)


@compiled
def cut(legs, gone, radius, p, seconds, table_rows, found, balls, kinds, spins):  # type: ignore[no-untyped-def]
    """Fill found (M, WIDTH), balls, kinds (M,), spins (M, 2) with all pieces up to `seconds`; how many there are."""
    rows, phases, made = np.zeros((table_rows, WIDTH)), np.zeros(table_rows, np.int64), 0
    out, rate = np.zeros(7), np.zeros(7)
    for k in range(len(legs)):
        a, start = int(legs[k, LEG_BALL]), legs[k, LEG_TIME]
        last = k == len(legs) - 1 or int(legs[k + 1, LEG_BALL]) != a
        until = min(seconds, gone[a]) if last else legs[k + 1, LEG_TIME]
        if start >= until:
            continue
        count = plan(legs[k, LEG_STATE:], radius[a], p, seconds - start, rows, phases)
        for i in range(count):
            begin = start + rows[i, START]
            end = min(start + rows[i, END], until)
            if end <= begin:
                continue
            follow(rows, count, legs[k, LEG_STATE + 6], p, rows[i, START], out, rate)
            found[made] = rows[i]
            found[made, START], found[made, END] = begin, end
            balls[made], kinds[made] = a, phases[i]
            spins[made, 0], spins[made, 1] = out[6], -np.sign(out[6]) * p[SPIN_DECAY]
            made += 1
    return made


def _cubics(row: FloatArray, spin: FloatArray) -> list[tuple[float, float, FloatArray, FloatArray]]:
    """Start, end, position (4, 2), spin (2, 3) of the cubic pieces that stand for one piece of degree five."""
    x = np.stack([row[X : X + 6], row[Y : Y + 6]], axis=1)
    w = np.stack([row[WX : WX + 5], row[WY : WY + 5]], axis=1)
    length = min(float(row[END] - row[START]), FOREVER)
    bend = np.abs(24 * x[4]).max() + 120 * np.abs(x[5]).max() * length
    parts = max(1, int(np.ceil((bend * length**4 / 384 / _SMOOTH) ** 0.25)))
    times = set(np.linspace(0, length, parts + 1))
    if spin[1] and abs(spin[0]) < abs(spin[1]) * length:
        times.add(float(abs(spin[0] / spin[1])))
    ends = sorted(times)
    return [
        (float(row[START] + a), float(row[START] + b), _cubic(x, a, b), _turn(w, spin, a, b))
        for a, b in pairwise(ends) if b - a > 1e-12
    ]  # fmt: skip


def _cubic(x: FloatArray, a: float, b: float) -> FloatArray:
    """Position (4, 2) from a to b with the place and velocity of x (6, 2) at both ends; exact where x is a cubic."""
    (p0, v0), (p1, v1) = (_value_and_rate(x, t) for t in (a, b))
    h = b - a
    if not np.any(x[3:]):
        return np.array([p0, v0, x[2], np.zeros(2)])
    mean = (p1 - p0) / h
    return np.array([p0, v0, (3 * mean - 2 * v0 - v1) / h, (v0 + v1 - 2 * mean) / h**2])


def _turn(w: FloatArray, spin: FloatArray, a: float, b: float) -> FloatArray:
    """Spin (2, 3) from a to b."""
    (w0, _), (w1, _) = (_value_and_rate(w, t) for t in (a, b))
    left = [max(abs(spin[0]) - abs(spin[1]) * t, 0.0) * np.sign(spin[0]) for t in (a, b)]
    first, last = np.append(w0, left[0]), np.append(w1, left[1])
    return np.array([first, (last - first) / (b - a)])


def _value_and_rate(c: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
    powers = t ** np.arange(len(c))
    return powers @ c, (np.arange(1, len(c)) * powers[:-1]) @ c[1:]
