"""All flights of a rally fitted together: one law, events that join them, one least-squares problem.

The parameters are those of the law that all flights of the clip share, the parameters of every flight at its start, and
the times of the events between joined flights. An observation belongs to the flight that covers its time; since the
flights meet at an event, the cost is continuous where an event passes an observation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.court import Sport
from models.core.rally import RallyEventKind
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.event_evidence import (
    BOUNCE_SPREAD,
    CONTACT_SPREAD,
    HIT_HEIGHTS,
    HIT_RATE,
    NET_DEPTH,
    NET_SHARE,
    NET_SPREAD,
    contact_ranges,
    leave_net,
    limit_places,
    name_contact,
    turns_over,
    weigh_chance,
)
from models.estimation.rally.flight_observations import (
    CLUTTER_COST,
    FlightObservations,
    bound_residuals,
    compare_places,
    weigh_by_law,
)
from models.estimation.rally.flight_segmentation import RallyHypothesis
from models.estimation.rally.play_order import locate_event, weigh_order
from models.estimation.rally.single_flight import (
    DRAG,
    DRAG_EXPONENT,
    DRAG_SPREAD,
    LAG_LIFT,
    LIFT,
    TURN_DRAG,
    build_flight_prior,
)
from models.numerics.least_squares import (
    SearchOptions,
    invert_semidefinite,
    measure_log_determinant,
    minimize_residuals,
)
from models.physics.flight.flight_motion import PARAMETER_COUNT, FlightPath, fly

# m, softness of the surface below a flight, and of the upper edge of the net, which gives way and hangs unevenly.
_FLOOR_SOFTNESS, _EDGE_SOFTNESS = 0.02, 0.05
# m by which the height of a bounce is known: the object is pressed flat.
_BOUNCE_HEIGHT = 0.01
# m by which a hit is away from the player's feet, to either side: an arm, a racket and a jump. Beyond so many times
# that, the distance counts less: the feet of someone who is half hidden are not seen. s within which people are seen.
_ARM, _PLAYER_SCALE, _PLAYER_TIME = 1.1, 2.0, 0.15
# Parameters of a flight that the flights of a clip have in common: drag, its exponent, drag of the turn-over, and lift
# by lag; and the share of what is not known of all but the first by which they differ from flight to flight.
_SHARED, _FLIGHT_SHARE = (DRAG, DRAG_EXPONENT, TURN_DRAG, LAG_LIFT), 0.2
SHARED_COUNT = len(_SHARED)
# m/s along the court from which it is clear which way the object flies.
_WAY_SOFTNESS = 1.0
# Softness of 0 as the least drag of the turn-over: across its path a shuttle is not more slender than along it.
_TURN_SOFTNESS = 0.1
# s, least time between events, and the longest step of an event in the search.
_SHORTEST_FLIGHT, _LONGEST_SHIFT = 0.01, 0.1
# s after the last observation of a flight up to which a person may have seen where it touched the ground.
_LONGEST_FALL = 0.5
# Steps of a joint fit, and the accuracy that a comparison of explanations needs.
FULL_SEARCH = SearchOptions(
    iterations=30, attempts=6, min_gain=0.05, min_relative_gain=1e-4, quiet_steps=2, damping=1e-2
)


@dataclass(frozen=True, slots=True)
class RallyStructure:
    """What the flights of a rally are, without their numbers."""

    kinds: tuple[RallyEventKind | None, ...]
    """(F,) the event that begins each flight."""
    joined: tuple[bool, ...]
    """(F,) whether the flight before each ends with that event."""
    begin: FloatArray
    end: FloatArray
    """(F,) s, the first and last observation of each, which bound it where no event does."""
    heights: FloatArray
    """(F,) height of the surface of a bounce, m."""

    def __len__(self) -> int:
        return len(self.kinds)

    def turn_length(self, index: int, sport: Sport) -> float:
        """Return the length of path, m, over which a flight turns over; 0 where it does not."""
        return sport.object.turn_length if turns_over(self.kinds[index]) else 0.0


@dataclass(frozen=True, slots=True)
class RallyFit:
    """Fitted flights of a rally."""

    structure: RallyStructure
    values: FloatArray
    """(P,) shared parameters, those of each flight, and the start of each flight, s."""
    information: FloatArray
    """(P, P), of priors and observations."""
    covariance: FloatArray
    """(P, P), its inverse."""
    cost: float
    evidence: float
    """Natural logarithm (Laplace)."""


def flight_slice(index: int) -> slice:
    """Return where the parameters of a flight stand among the values of a fit."""
    first = SHARED_COUNT + PARAMETER_COUNT * index
    return slice(first, first + PARAMETER_COUNT)


def start_row(index: int, flights: int) -> int:
    """Return where the start of a flight stands among the values of a fit."""
    return SHARED_COUNT + PARAMETER_COUNT * flights + index


def fit_rally(observed: FlightObservations, sport: Sport, hypothesis: RallyHypothesis) -> RallyFit | None:
    """Fit the flights of a hypothesis together.

    Args:
        observed: N observations.
        hypothesis: Flights to start from.

    Returns:
        The fit; None where the flights that it starts from are not possible.
    """
    guesses = hypothesis.flights
    if not guesses:
        return None
    values, heights, joined = build_flight_prior(sport).mean[list(_SHARED)].tolist(), [], []
    for guess in guesses:
        p = guess.flight.parameters.copy()
        turn_length = sport.object.turn_length * guess.flight.turns
        moved = fly(p, np.array([guess.t - observed.t[guess.first]]), turn_length).states[0]
        # a flight that is followed back too far grows absurdly fast: nothing is known of what came before it
        joined.append(guess.is_joined and bool(np.linalg.norm(moved[3:]) < 1.5 * sport.object.max_speed))
        if joined[-1]:
            p[:6] = moved
        heights.append(sport.floor if sport.is_beside_table(p[2]) else 0.0)
        values.extend(p)
    starts = [
        guess.t if is_joined else observed.t[guess.first] for guess, is_joined in zip(guesses, joined, strict=True)
    ]
    structure = RallyStructure(
        tuple(guess.kind for guess in guesses),
        tuple(joined),
        observed.t[[guess.first for guess in guesses]],
        observed.t[[guess.last for guess in guesses]],
        np.array(heights),
    )
    return refine_fit(observed, sport, structure, np.array([*values, *starts], np.float64))


def refine_fit(
    observed: FlightObservations,
    sport: Sport,
    structure: RallyStructure,
    values: FloatArray,
    search: SearchOptions = FULL_SEARCH,
) -> RallyFit | None:
    """Fit flights of a known structure from initial values (P,)."""
    problem = _Problem(observed, sport, structure)
    try:
        best = minimize_residuals(values, problem.evaluate, search, problem.limit)
        # places far from where a search starts must pull; where it ends, they show another thing
        problem.most = CLUTTER_COST
        best = minimize_residuals(best.point, problem.evaluate, search, problem.limit)
    except ValueError:
        return None
    problem.normalizer = 0.0
    rows = problem.evaluate(best.point)
    assert rows is not None
    information = rows[1].T @ rows[1]
    # fixed starts have no rows
    fixed = [start_row(k, len(structure)) for k, is_joined in enumerate(structure.joined) if not is_joined]
    information[fixed, fixed] += 1e12
    free = np.delete(np.arange(len(information)), fixed)
    log_determinant = measure_log_determinant(rows[1][:, free])
    if not np.isfinite(log_determinant):
        return None  # nothing holds one of its values
    evidence = -0.5 * best.cost + problem.normalizer + 0.5 * len(free) * np.log(2 * np.pi) - 0.5 * log_determinant
    covariance = invert_semidefinite(information)
    where = locate_events(structure, best.point, covariance, sport)
    evidence += weigh_order(structure.kinds, where, ~np.array(structure.joined), sport)
    return RallyFit(structure, best.point, information, covariance, best.cost, float(evidence))


def locate_events(structure: RallyStructure, values: FloatArray, covariance: FloatArray, sport: Sport) -> FloatArray:
    """Compute the probabilities (F, 3), see `locate_event`, of where the flights of a fit begin."""
    x = SHARED_COUNT + PARAMETER_COUNT * np.arange(len(structure))
    sigma = np.sqrt(np.maximum(covariance[x, x], 0.0))
    is_off = (structure.heights < 0) & (np.array(structure.kinds) == "bounce")
    return locate_event(values[x], sigma, is_off, sport)


def assign_times(t: FloatArray, structure: RallyStructure, values: FloatArray) -> list[IntArray]:
    """Assign times (N,), s, in their order, to the flights that cover them.

    Returns:
        Indices of the times of each flight.
    """
    count = len(structure)
    starts = values[start_row(0, count) :]
    rows = []
    for k in range(count):
        low = starts[k] if structure.joined[k] else structure.begin[k] - 1e-9
        is_ended = k + 1 < count and structure.joined[k + 1]
        high = starts[k + 1] if is_ended else structure.end[k] + 1e-9
        begin, end = np.searchsorted(t, [low, high])
        rows.append(np.arange(begin, end))
    return rows


class _Problem:
    """Residuals of a rally and their Jacobian."""

    def __init__(self, observed: FlightObservations, sport: Sport, structure: RallyStructure) -> None:
        self.observed, self.sport, self.structure = observed, sport, structure
        self.prior = build_flight_prior(sport)
        self.size = SHARED_COUNT + (PARAMETER_COUNT + 1) * len(structure)
        self.normalizer, self.most = 0.0, np.inf
        self.rows: list[FloatArray] = []
        self.by: list[FloatArray] = []
        self.known = self._state_prior()

    def limit(self, old: FloatArray, new: FloatArray) -> FloatArray:
        """Keep the events in their order."""
        limited, count = new.copy(), len(self.structure)
        first = start_row(0, count)
        for k in range(count):
            at = first + k
            if not self.structure.joined[k]:
                limited[at] = old[at]
                continue
            low = limited[at - 1] + _SHORTEST_FLIGHT
            until = old[at + 1] if k + 1 < count else self.structure.end[k]
            high = max(until - _SHORTEST_FLIGHT, low)
            limited[at] = np.clip(
                new[at], max(low, old[at] - _LONGEST_SHIFT), max(min(high, old[at] + _LONGEST_SHIFT), low)
            )
        return limited

    def evaluate(self, values: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Evaluate residuals (R,) and their derivatives (R, P)."""
        self.rows, self.by, self.normalizer = [], [], 0.0
        sport, structure, count = self.sport, self.structure, len(self.structure)
        by_known, mean, log_sigmas = self.known
        self.rows.append(by_known @ values - mean)
        self.by.append(by_known)
        self.normalizer -= log_sigmas
        turn = _SHARED.index(TURN_DRAG)
        if values[turn] < 0:
            self._add(values[[turn]] / _TURN_SOFTNESS, np.array([[1 / _TURN_SOFTNESS]]), np.array([turn]))
        before: tuple[FloatArray, FloatArray, FloatArray] | None = None
        for k, rows in enumerate(assign_times(self.observed.t, structure, values)):
            part, start = flight_slice(k), values[start_row(k, count)]
            p, turn_length = values[part], structure.turn_length(k, sport)
            ends_joined = k + 1 < count and structure.joined[k + 1]
            end = values[start_row(k + 1, count)] if ends_joined else self.structure.end[k]
            path = fly(p, np.append(self.observed.t[rows], end) - start, turn_length)
            if not np.isfinite(path.states).all():
                return None
            self._add_observations(rows, path, k, part)
            self._add_surface(path, k, part)
            self._add_surroundings(path, part)
            self._add_net(k, part, p, path, turn_length, np.append(self.observed.t[rows], end) - start)
            if not ends_joined:
                self._add_marked_contact(k, part, p, start, turn_length)
            if structure.joined[k] and before is not None:
                self._add_marked_time(k, float(start))
                self._add_event(k, values, *before)
            elif structure.kinds[k] == "hit":
                self._add_reach(k, p, start)
            before = (path.states[-1], path.accelerations[-1], path.derivatives[-1])
        return np.concatenate(self.rows), np.vstack(self.by)

    def _add(self, residual: FloatArray, by: FloatArray, columns: slice | IntArray) -> None:
        full = np.zeros((len(residual), self.size))
        full[:, columns] = by
        self.rows.append(residual)
        self.by.append(full)

    def _state_prior(self) -> tuple[FloatArray, FloatArray, float]:
        """State what is known before, in standard deviations: matrix (R, P), right side (R,) and logarithmic norm."""
        mean, sigma = self.prior.mean, self.prior.sigma
        rows: list[tuple[dict[int, float], float, float]] = []  # columns, value and standard deviation
        for column, index in enumerate(_SHARED):
            rows.append(({column: 1.0}, mean[index], self.sport.object.drag.sigma if index == DRAG else sigma[index]))
        for k, (kind, is_joined) in enumerate(zip(self.structure.kinds, self.structure.joined, strict=True)):
            start, used = flight_slice(k).start, [*LIFT]
            if kind in (None, "hit") or not is_joined:
                used += [3, 4, 5]
            if not is_joined:
                used += [0, 1, 2]
            rows += [({start + j: 1.0}, mean[j], sigma[j]) for j in used]
            for column, index in enumerate(_SHARED):
                spread = DRAG_SPREAD * mean[DRAG] if index == DRAG else _FLIGHT_SHARE * sigma[index]
                rows.append(({start + index: 1.0, column: -1.0}, 0.0, spread))
        by, right = np.zeros((len(rows), self.size)), np.empty(len(rows))
        for row, (columns, value, spread) in enumerate(rows):
            by[row, list(columns)] = np.array(list(columns.values())) / spread
            right[row] = value / spread
        return by, right, float(sum(np.log(spread) + 0.5 * np.log(2 * np.pi) for _, _, spread in rows))

    def _add_observations(self, rows: IntArray, path: FlightPath, k: int, part: slice) -> None:
        observed = self.observed.select(rows)
        residual, by_place = compare_places(observed, path.states[:-1, :3])
        weight = weigh_by_law(by_place, path.states[:-1, :3], self.sport.object)
        self.normalizer += 2 * float(np.log(weight).sum())
        residual, by_place = residual * weight[:, None], by_place * weight[:, None, None]
        factor, slope = bound_residuals(residual, most=observed.bound_clutter(self.most))
        by = (by_place @ path.derivatives[:-1, :3]) * slope[:, None, None]
        by_start = -np.einsum("nij,nj->ni", by_place, path.states[:-1, 3:]) * slope[:, None]
        columns = np.append(np.arange(part.start, part.stop), start_row(k, len(self.structure)))
        if not self.structure.joined[k]:
            by_start = 0 * by_start
        full = np.concatenate([by, by_start[:, :, None]], axis=2).reshape(-1, PARAMETER_COUNT + 1)
        self._add((residual * factor[:, None]).ravel(), full, columns)

    def _add_surface(self, path: FlightPath, k: int, part: slice) -> None:
        """Keep the flight above the floor, and above a table."""
        states, sport = path.states, self.sport
        level = np.full(len(states), sport.floor)
        if sport.floor < 0:
            over = (np.abs(states[:, 0] - sport.length / 2) < sport.length / 2) & (
                np.abs(states[:, 1] - sport.width / 2) < sport.width / 2
            )
            level[over & (states[:, 2] > sport.floor / 4)] = 0.0
        depth = np.minimum(states[:, 2] - level - sport.object.radius, 0.0)
        rows = np.flatnonzero(depth < 0)
        if len(rows):
            self._add(depth[rows] / _FLOOR_SOFTNESS, path.derivatives[rows, 2] / _FLOOR_SOFTNESS, part)

    def _add_surroundings(self, path: FlightPath, part: slice) -> None:
        """Keep the flight near the court, by the place that is farthest from it in each direction."""
        for axis, (low, high, softness) in enumerate(limit_places(self.sport)[:2]):
            x = path.states[:, axis]
            row = int(np.argmax(np.abs(x - np.clip(x, low, high))))
            off = x[row] - np.clip(x[row], low, high)
            if off:
                self._add(np.array([off / softness]), path.derivatives[None, row, axis] / softness, part)

    def _add_marked_time(self, k: int, start: float) -> None:
        """Keep an event near the moment at which a person saw it."""
        for mark in self.observed.marks:
            if mark.is_there and mark.kind == self.structure.kinds[k] and abs(start - mark.t) < _LONGEST_SHIFT:
                column = np.array([start_row(k, len(self.structure))])
                self._add(np.array([(start - mark.t) / mark.sigma]), np.array([[1 / mark.sigma]]), column)

    def _add_marked_contact(self, k: int, part: slice, p: FloatArray, start: float, turn_length: float) -> None:
        """Let a flight that ends freely touch the ground where a person saw that."""
        last, sport = self.structure.end[k], self.sport
        until = self.structure.begin[k + 1] if k + 1 < len(self.structure) else last + _LONGEST_FALL
        for mark in self.observed.marks:
            if mark.is_there and mark.kind == name_contact(sport) and (mark.is_near(last) or last < mark.t < until):
                path = fly(p, np.array([mark.t - start]), turn_length)
                z, fall = path.states[0, [2, 5]]
                level = sport.object.radius + (sport.floor if sport.is_beside_table(z) else 0.0)
                sigma = float(np.hypot(_BOUNCE_HEIGHT, fall * mark.sigma))
                columns = np.append(np.arange(part.start, part.stop), start_row(k, len(self.structure)))
                by = np.append(path.derivatives[0, 2], -fall * self.structure.joined[k])
                self._add(np.array([(z - level) / sigma]), by[None] / sigma, columns)

    def _add_net(
        self, k: int, part: slice, p: FloatArray, path: FlightPath, turn_length: float, tau: FloatArray
    ) -> None:
        """Keep the flight above the net where it crosses it."""
        if self.structure.kinds[k] == "net":
            return
        times, x = np.append(0.0, tau), np.append(p[0], path.states[:, 0]) - self.sport.length / 2
        crossings = np.flatnonzero(x[:-1] * x[1:] < 0)
        ends_at_net = k + 1 < len(self.structure) and self.structure.kinds[k + 1] == "net"
        if not len(crossings) or ends_at_net:
            return
        c = crossings[0]
        at = times[c] + (times[c + 1] - times[c]) * x[c] / (x[c] - x[c + 1])
        over = fly(p, np.array([at]), turn_length)
        state, by = over.states[0], over.derivatives[0]
        edge = float(self.sport.net.height_at(state[1:2], self.sport.width)[0]) + self.sport.object.radius
        outside = state[1] < -self.sport.net.overhang or state[1] > self.sport.width + self.sport.net.overhang
        if state[2] < edge and not outside and abs(state[3]) > 1e-3:
            slope = by[2] - state[5] / state[3] * by[0]
            self._add(np.array([(state[2] - edge) / _EDGE_SOFTNESS]), slope[None] / _EDGE_SOFTNESS, part)

    def _add_reach(self, k: int, p: FloatArray, t: float) -> None:
        """Keep a hit within the players' reach and, where people are seen, near one of them."""
        sport, at = self.sport, flight_slice(k).start
        low, high, softness = limit_places(sport)[2]
        off = p[2] - float(np.clip(p[2], low, high))
        if off:
            self._add(np.array([off / softness]), np.array([[1 / softness]]), np.array([at + 2]))
        feet = self._find_feet(p, t)
        if feet is not None:
            off = (p[:2] - feet) / _ARM
            factor, slope = bound_residuals(off[None], _PLAYER_SCALE)
            self._add(off * factor[0], np.eye(2) * slope[0] / _ARM, np.array([at, at + 1]))
            behind, beside = sport.surroundings
            area = (sport.length + 2 * behind) * (sport.width + 2 * beside)
            self.normalizer += float(np.log(area / (2 * np.pi * _ARM**2)))

    def _find_feet(self, p: FloatArray, t: float) -> FloatArray | None:
        """Find the place (2,), m, of the player who is seen nearest to a place; None where nobody is seen then."""
        people = self.observed.players
        people = people[np.abs(people[:, 0] - t) < _PLAYER_TIME]
        if not len(people):
            return None
        people = people[np.abs(people[:, 0] - t) < np.abs(people[:, 0] - t).min() + 1e-6]
        matrix = self.observed.matrix[min(int(np.searchsorted(self.observed.t, t)), len(self.observed) - 1)]
        ahead = matrix[:, :3] @ p[:3] + matrix[:, 3]
        px, size = ahead[:2] / max(ahead[2], 0.1), people[:, 4] - people[:, 2]
        beside = np.maximum(np.maximum(people[:, 1] - px[0], px[0] - people[:, 3]), 0.0)
        above = np.maximum(np.maximum(people[:, 2] - px[1], px[1] - people[:, 4]), 0.0)
        return np.asarray(people[int(np.argmin(np.hypot(beside, above) / np.maximum(size, 1.0))), 5:7])

    def _add_event(
        self, k: int, values: FloatArray, state: FloatArray, acceleration: FloatArray, derivative: FloatArray
    ) -> None:
        """Join a flight to the end, (6,) with its acceleration and derivatives (6, P), of the one before."""
        sport, kind, count = self.sport, self.structure.kinds[k], len(self.structure)
        item, part, earlier = sport.object, flight_slice(k), flight_slice(k - 1)
        p, at_start, before_start = values[part], start_row(k, count), start_row(k - 1, count)
        rate = np.concatenate([state[3:], acceleration])
        stated: list[tuple[FloatArray, FloatArray, float, float]] = []

        def limit(of_state: FloatArray, of_start: FloatArray, residual: float, sigma: float) -> None:
            stated.append((of_state, of_start, residual, sigma))

        def add(of_state: FloatArray, of_start: FloatArray, residual: float, sigma: float) -> None:
            limit(of_state, of_start, residual, sigma)
            # what is known has a density; a limit, which says what cannot be, has none
            self.normalizer -= float(np.log(sigma) + 0.5 * np.log(2 * np.pi))

        unit = np.eye(6)
        for axis in range(3):
            add(unit[axis], -unit[axis], state[axis] - p[axis], CONTACT_SPREAD)
        if kind == "hit":
            self._add_reach(k, p, float(values[at_start]))
            share = float(np.clip((p[2] - sport.floor) / sport.reach, *HIT_HEIGHTS))
            self.normalizer += float(np.log(HIT_RATE * 6 * share * (1 - share)))
            came, leaves = 1 / (1 + np.exp(-np.clip(np.array([state[3], p[3]]) / _WAY_SOFTNESS, -50, 50)))
            self.normalizer += float(weigh_chance(came, 1 - leaves))
        elif kind in ("bounce", "landing"):
            restitution, retention = contact_ranges(sport)
            add(0 * unit[0], unit[2], p[2] - self.structure.heights[k] - item.radius, _BOUNCE_HEIGHT)
            level = float(np.hypot(state[3], state[4]))
            along = np.array([state[3], state[4]]) / max(level, 1e-6)
            for direction, left, sigma in (
                (along, retention.mean, np.hypot(retention.sigma * level, BOUNCE_SPREAD[0])),
                (np.array([-along[1], along[0]]), retention.mean, BOUNCE_SPREAD[0]),
            ):
                by = np.zeros(6)
                by[3:5] = direction
                add(-left * by, by, float(by @ (p[:6] - left * state)), float(sigma))
            sigma = np.hypot(restitution.sigma * state[5], BOUNCE_SPREAD[1])
            add(restitution.mean * unit[5], unit[5], p[5] + restitution.mean * state[5], float(sigma))
            self.normalizer += float(np.log(max(-state[5], 0.05)))
        else:
            add(0 * unit[0], unit[0], p[0] - sport.length / 2, NET_DEPTH)
            edge = float(sport.net.height_at(p[1:2], sport.width)[0]) + item.radius
            limit(0 * unit[0], unit[2] * (p[2] > edge), max(p[2] - edge, 0.0), _EDGE_SOFTNESS)
            speeds = np.linalg.norm([state[3:], p[3:6]], axis=1)
            ways = np.zeros((2, 6))
            ways[:, 3:] = [state[3:], p[3:6]] / np.maximum(speeds, 1e-6)[:, None]
            gain = max(float(speeds[1] - speeds[0]), 0.0)
            limit(-ways[0] * (gain > 0), ways[1] * (gain > 0), gain, NET_SPREAD)
            left, off = (row[0] for row in leave_net(state[None, 3:], p[None, :3], sport))
            for axis, share, sigma in zip((3, 4, 5), left, off, strict=True):
                add(-share * unit[axis], unit[axis], p[axis] - share * state[axis], float(sigma))
            self.normalizer += float(np.log(NET_SHARE * max(abs(state[3]), 0.05)))
        of_state, of_start, residual, sigmas = (np.array(column) for column in zip(*stated, strict=True))
        rows = np.zeros((len(stated), self.size))
        rows[:, earlier] = of_state @ derivative
        rows[:, at_start] = of_state @ rate
        if self.structure.joined[k - 1]:
            rows[:, before_start] = -rows[:, at_start]
        rows[:, part.start : part.start + 6] = of_start
        self.rows.append(residual / sigmas)
        self.by.append(rows / sigmas[:, None])
