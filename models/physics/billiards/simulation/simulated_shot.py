"""Result of a simulation: states at any time, events, a trajectory, and derivatives by all inputs."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from models.core.events import Events
from models.core.scene import CUSHIONS, POCKETS
from models.core.trajectory import State, Trajectory
from models.core.typing import FloatArray, IntArray
from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.cloth_motion import plan_motion
from models.physics.billiards.cloth.forces import has_curved_path
from models.physics.billiards.cloth.motion_pieces import (
    PHASE_NAMES,
    PIECE_END,
    PIECE_START,
    PIECE_WIDTH,
    REST,
    REST_DURATION,
    WX,
    WY,
    X,
    Y,
    count_pieces,
    evaluate_pieces,
)
from models.physics.billiards.cushion_geometry import CUSHION_NORMALS, Rails
from models.physics.billiards.parameter_vector import PARAMETER_NAMES, SPIN_DECAY
from models.physics.billiards.simulation.event_engine import (
    BALL,
    EVENT_FIRST,
    EVENT_KIND,
    EVENT_SECOND,
    EVENT_SPEED,
    EVENT_TIME,
    HOLE,
    LINE,
    SEGMENT_BALL,
    SEGMENT_STATE,
    SEGMENT_TIME,
)
from models.physics.billiards.simulation.shot_derivatives import BALL_COLUMNS, differentiate_shot
from models.physics.billiards.simulation.table_physics import Physics

# Numbers of the state of a ball: x, y (m), vx, vy (m/s), wx, wy, wz (rad/s).
STATE_SIZE = 7


@dataclass(frozen=True, slots=True)
class BallSet:
    """Initial states, radii and masses of N balls, in the frame of the table."""

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


@dataclass(frozen=True, slots=True)
class SimulatedShot:
    """A shot from time 0 to `seconds`."""

    balls: BallSet
    rails: Rails
    physics: Physics
    seconds: float
    contacts: FloatArray
    """(E, EVENT_WIDTH) as `simulate_events` logs them."""
    segments: FloatArray
    """(L, SEGMENT_WIDTH) sorted by ball, then by time."""
    pocket_times: FloatArray = field(init=False, repr=False)
    """(N,) s, when each ball fell into a pocket; infinite where it did not."""

    def __post_init__(self) -> None:
        pocket_times = np.full(len(self.balls.ids), np.inf)
        for hole in self.contacts[self.contacts[:, EVENT_KIND] == HOLE]:
            pocket_times[int(hole[EVENT_FIRST])] = hole[EVENT_TIME]
        object.__setattr__(self, "pocket_times", pocket_times)

    def states_at(self, t: float | FloatArray) -> FloatArray:
        """Evaluate the states of all balls.

        Args:
            t: (...) times, s.

        Returns:
            (..., N, 7) states; NaN for a ball in a pocket.
        """
        times = np.asarray(t, dtype=np.float64)
        order = np.argsort(times.reshape(-1), kind="stable")
        ordered = np.full((times.size, len(self.balls.ids), 7), np.nan)
        fill_states(
            self.segments, self.pocket_times, self.balls.radius, self.physics.values, self.seconds,
            times.reshape(-1)[order], ordered,
        )  # fmt: skip
        states = np.empty_like(ordered)
        states[order] = ordered
        return states.reshape(*times.shape, *ordered.shape[1:])

    def directional_derivatives(
        self, t: FloatArray, place: IntArray, directions: FloatArray, numbers: int
    ) -> FloatArray:
        """Differentiate states along directions in the space of all inputs; the order of contacts is held fixed.

        Args:
            t: (T,) times, s.
            place: (T, N) row of the result for each ball and time, -1 where none is wanted.
            directions: (P, C) over `BALL_COLUMNS` of each ball, `PARAMETER_NAMES`, and the offsets of the noses.
            numbers: 7 for whole states, 2 for places only.

        Returns:
            (K, numbers, C) derivatives; NaN for a ball in a pocket.
        """
        return self.directional_derivatives_until(t, place, directions, numbers, np.inf)[0]

    def directional_derivatives_until(
        self, t: FloatArray, place: IntArray, directions: FloatArray, numbers: int, end: float
    ) -> tuple[FloatArray, FloatArray]:
        """Differentiate states as `directional_derivatives` does, and those of all balls at one more time.

        Args:
            t: (T,) times, s.
            place: (T, N) row of the result for each ball and time, -1 where none is wanted.
            directions: (P, C) over `BALL_COLUMNS` of each ball, `PARAMETER_NAMES`, and the offsets of the noses.
            numbers: 7 for whole states, 2 for places only.
            end: s; infinite if no states at an end are wanted.

        Returns:
            Derivatives (K, numbers, C), and derivatives (N, 7, C) at `end`, NaN where `end` is infinite.
        """
        first = len(BALL_COLUMNS) * len(self.balls.ids)
        by_physics = np.any(directions[first : first + len(PARAMETER_NAMES)], axis=1)
        order = np.argsort(t, kind="stable")
        derivatives = np.full((int(place.max(initial=-1)) + 1, numbers, directions.shape[1]), np.nan)
        at_end = np.full((len(self.balls.ids), STATE_SIZE, directions.shape[1]), np.nan)
        differentiate_shot(
            self.segments,
            self.contacts,
            self.pocket_times,
            self.balls.radius,
            self.balls.mass,
            self.physics.values,
            self.physics.model_codes,
            self.rails.lines,
            self.rails.arcs,
            CUSHION_NORMALS,
            t[order],
            place[order],
            float(end),
            np.ascontiguousarray(directions),
            np.flatnonzero(by_physics),
            derivatives,
            at_end,
        )
        return derivatives, at_end

    def to_state(self, t: float | FloatArray) -> State:
        """Return the states at times t (...), s, as a `State` with standard deviations of 0."""
        states = self.states_at(t)
        zeros = np.where(np.isnan(states[..., 0]), np.nan, 0.0)
        return State(states[..., :2], states[..., 2:4], states[..., 4:7], zeros, zeros, np.zeros(zeros.shape, bool))

    @property
    def events(self) -> Events:
        """All events of the shot; times are exact, `frame` is NaN. A simulated rest is when the ball stops."""
        return self.list_events(np.nan)

    def list_events(self, hz: float) -> Events:
        """List all events by time.

        Args:
            hz: Frame rate for the column `frame`; NaN if there are no frames.

        Returns:
            Strikes at time 0, contacts, pockets and rests.
        """
        rows = [*self._list_strikes(), *self._list_contacts(), *self._list_rests()]
        rows.sort(key=lambda row: row[1])
        kind, t, a, b, place, speed = zip(*rows, strict=True) if rows else ((),) * 6
        times, count = np.array(t, dtype=np.float64), len(rows)
        exact, unknown = np.full(count, 1e-9), np.full(count, np.nan)
        gap = np.where(np.isin(kind, ("ball", "cushion")), 0.0, np.nan) if count else unknown
        return Events(
            tuple(kind), times, exact, times * hz, tuple(a), tuple(b), np.array(place).reshape(-1, 2), np.ones(count),
            gap, gap, np.array(speed, dtype=np.float64),
        )  # fmt: skip

    def to_trajectory(self) -> Trajectory:
        """Convert to a trajectory of cubic pieces.

        Returns:
            The trajectory; where slope or drag bend a path, short pieces stay within 10 nm of it.
        """
        pieces, balls, phases, spins = self.collect_pieces()
        cubics = [
            (ball, PHASE_NAMES[phase], *cubic)
            for row, ball, phase, spin in zip(pieces, balls, phases, spins, strict=True)
            for cubic in _split_into_cubics(row, spin)
        ]
        ball, name, start, end, position, turn = zip(*cubics, strict=True)
        return Trajectory(
            self.balls.ids, np.array(ball, dtype=np.int64), np.array(start), np.array(end), np.array(position),
            np.array(turn), tuple(name), np.zeros((len(cubics), 4, 4)),
        )  # fmt: skip

    def collect_pieces(self) -> tuple[FloatArray, IntArray, IntArray, FloatArray]:
        """Collect the polynomial pieces of all segments.

        Returns:
            Pieces (M, PIECE_WIDTH), whose columns PIECE_START and PIECE_END count from the start of the shot; ball
            (M,); phase (M,); side spin and its rate (M, 2).
        """
        most = int(count_pieces(has_curved_path(self.physics.values))) * len(self.segments)
        rows, balls, phases = np.empty((most, PIECE_WIDTH)), np.empty(most, np.int64), np.empty(most, np.int64)
        spins = np.empty((most, 2))
        count = fill_pieces(
            self.segments, self.pocket_times, self.balls.radius, self.physics.values, self.seconds,
            rows, balls, phases, spins,
        )  # fmt: skip
        return rows[:count], balls[:count], phases[:count], spins[:count]

    def _list_strikes(self) -> list[tuple[str, float, str, str, FloatArray, float]]:
        """List a strike at time 0 for every ball that moves then."""
        moving = np.hypot(*self.balls.state[:, 2:4].T)
        return [
            ("strike", 0.0, name, "", self.balls.state[k, :2], float(moving[k]))
            for k, name in enumerate(self.balls.ids) if moving[k] > 0
        ]  # fmt: skip

    def _list_contacts(self) -> list[tuple[str, float, str, str, FloatArray, float]]:
        """List the contacts and pockets with their places."""
        ids, places = self.balls.ids, self._find_contact_places()
        rows = []
        for event, place in zip(self.contacts, places, strict=True):
            kind, a, other = int(event[EVENT_KIND]), ids[int(event[EVENT_FIRST])], int(event[EVENT_SECOND])
            if kind == BALL:
                name, b = "ball", ids[other]
            elif kind == HOLE:
                name, b = "pocket", POCKETS[other]
            else:
                sides = self.rails.lines[:, 5] if kind == LINE else self.rails.arcs[:, 3]
                name, b = "cushion", CUSHIONS[int(sides[other])]
            rows.append((name, float(event[EVENT_TIME]), a, b, place, float(event[EVENT_SPEED])))
        return rows

    def _find_contact_places(self) -> FloatArray:
        """Find where the first ball of each contact was (E, 2), m: there its next segment begins."""
        places = np.empty((len(self.contacts), 2))
        used = np.ones(len(self.balls.ids), dtype=np.int64)
        first = np.searchsorted(self.segments[:, SEGMENT_BALL], np.arange(len(self.balls.ids)))
        for k, event in enumerate(self.contacts):
            a, b = int(event[EVENT_FIRST]), int(event[EVENT_SECOND])
            places[k] = self.segments[first[a] + used[a], SEGMENT_STATE : SEGMENT_STATE + 2]
            used[a] += 1
            if event[EVENT_KIND] == BALL:
                used[b] += 1
        return places

    def _list_rests(self) -> list[tuple[str, float, str, str, FloatArray, float]]:
        """List when and where balls come to rest."""
        pieces, balls, phases, _ = self.collect_pieces()
        stopping = np.flatnonzero((phases[1:] == REST) & (phases[:-1] != REST) & (balls[1:] == balls[:-1])) + 1
        return [
            ("rest", float(pieces[k, PIECE_START]), self.balls.ids[balls[k]], "", pieces[k, [X, Y]], np.nan)
            for k in stopping
        ]


@compile_kernel
def fill_states(segments, pocket_times, radius, p, seconds, times, out):  # type: ignore[no-untyped-def]
    """Write to out (T, N, 7) the states at sorted times (T,), s."""
    capacity, rate = count_pieces(has_curved_path(p)), np.zeros(7)
    rows, phases = np.zeros((capacity, PIECE_WIDTH)), np.zeros(capacity, np.int64)
    for k in range(len(segments)):
        a, start = int(segments[k, SEGMENT_BALL]), segments[k, SEGMENT_TIME]
        last = k == len(segments) - 1 or int(segments[k + 1, SEGMENT_BALL]) != a
        until = pocket_times[a] if last else segments[k + 1, SEGMENT_TIME]
        first = np.searchsorted(times, start) if start > 0.0 else 0
        after = len(times) if until == np.inf else np.searchsorted(times, until)
        if first >= after or start >= pocket_times[a]:
            continue
        state = segments[k, SEGMENT_STATE:]
        count = plan_motion(state, radius[a], p, max(seconds, times[after - 1]) - start, rows, phases)
        for i in range(first, after):
            evaluate_pieces(rows, count, state[6], p, times[i] - start, out[i, a], rate)


@compile_kernel
def fill_pieces(segments, pocket_times, radius, p, seconds, pieces, balls, piece_phases, spins):  # type: ignore[no-untyped-def]
    """Write all pieces up to `seconds`; return their number.

    pieces (M, PIECE_WIDTH), balls (M,), piece_phases (M,) and spins (M, 2), side spin and its rate, receive them.
    """
    capacity, piece_count = count_pieces(has_curved_path(p)), 0
    rows, phases = np.zeros((capacity, PIECE_WIDTH)), np.zeros(capacity, np.int64)
    out, rate = np.zeros(7), np.zeros(7)
    for k in range(len(segments)):
        a, start = int(segments[k, SEGMENT_BALL]), segments[k, SEGMENT_TIME]
        last = k == len(segments) - 1 or int(segments[k + 1, SEGMENT_BALL]) != a
        until = min(seconds, pocket_times[a]) if last else segments[k + 1, SEGMENT_TIME]
        if start >= until:
            continue
        count = plan_motion(segments[k, SEGMENT_STATE:], radius[a], p, seconds - start, rows, phases)
        for i in range(count):
            begin = start + rows[i, PIECE_START]
            end = min(start + rows[i, PIECE_END], until)
            if end <= begin:
                continue
            evaluate_pieces(rows, count, segments[k, SEGMENT_STATE + 6], p, rows[i, PIECE_START], out, rate)
            pieces[piece_count] = rows[i]
            pieces[piece_count, PIECE_START], pieces[piece_count, PIECE_END] = begin, end
            balls[piece_count], piece_phases[piece_count] = a, phases[i]
            spins[piece_count, 0], spins[piece_count, 1] = out[6], -np.sign(out[6]) * p[SPIN_DECAY]
            piece_count += 1
    return piece_count


# m; greatest error of a cubic of a trajectory on a path that is no cubic.
_CUBIC_TOLERANCE = 1e-8


def _split_into_cubics(row: FloatArray, spin: FloatArray) -> list[tuple[float, float, FloatArray, FloatArray]]:
    """Split a piece of degree five into cubics: start, end (s), position (4, 2), spin (2, 3) of each."""
    x = np.stack([row[X : X + 6], row[Y : Y + 6]], axis=1)
    w = np.stack([row[WX : WX + 5], row[WY : WY + 5]], axis=1)
    length = min(float(row[PIECE_END] - row[PIECE_START]), REST_DURATION)
    bend = np.abs(24 * x[4]).max() + 120 * np.abs(x[5]).max() * length
    parts = max(1, int(np.ceil((bend * length**4 / 384 / _CUBIC_TOLERANCE) ** 0.25)))
    times = set(np.linspace(0, length, parts + 1))
    if spin[1] and abs(spin[0]) < abs(spin[1]) * length:
        times.add(float(abs(spin[0] / spin[1])))
    ends = sorted(times)
    return [
        (
            float(row[PIECE_START] + a),
            float(row[PIECE_START] + b),
            _fit_cubic(x, a, b),
            _interpolate_spin(w, spin, a, b),
        )
        for a, b in pairwise(ends)
        if b - a > 1e-12
    ]


def _fit_cubic(x: FloatArray, a: float, b: float) -> FloatArray:
    """Fit position coefficients (4, 2) from a to b (s) to place and velocity of x (6, 2) at both ends.

    The result is exact where x is a cubic.
    """
    (p0, v0), (p1, v1) = (_value_and_rate(x, t) for t in (a, b))
    h = b - a
    if not np.any(x[3:]):
        return np.array([p0, v0, x[2], np.zeros(2)])
    mean = (p1 - p0) / h
    return np.array([p0, v0, (3 * mean - 2 * v0 - v1) / h, (v0 + v1 - 2 * mean) / h**2])


def _interpolate_spin(w: FloatArray, spin: FloatArray, a: float, b: float) -> FloatArray:
    """Interpolate the spin linearly from a to b (s): coefficients (2, 3) of wx, wy, wz."""
    (w0, _), (w1, _) = (_value_and_rate(w, t) for t in (a, b))
    left = [max(abs(spin[0]) - abs(spin[1]) * t, 0.0) * np.sign(spin[0]) for t in (a, b)]
    first, last = np.append(w0, left[0]), np.append(w1, left[1])
    return np.array([first, (last - first) / (b - a)])


def _value_and_rate(c: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
    """Evaluate a polynomial (K, D) and its derivative at t (s)."""
    powers = t ** np.arange(len(c))
    return powers @ c, (np.arange(1, len(c)) * powers[:-1]) @ c[1:]
