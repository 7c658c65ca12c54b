"""Which flights a rally consists of: hypotheses of hits, bounces and the net, by the evidence of fits in space.

Kinks of the path in the image are the candidate events: a superset, since a cubic in time follows a long flight badly.
Every stretch between two of them is fitted as one flight, in each sense of its depth; the best sequences of flights are
then found by dynamic programming, each pair joined by the event of most evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.constants import GRAVITY
from models.core.court import Sport
from models.core.progress import Progress
from models.core.rally import RallyEventKind
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.event_evidence import FlightEnds, weigh_events
from models.estimation.rally.flight_observations import CLUTTER_COST, MARK_EVIDENCE, REST_PX, FlightObservations
from models.estimation.rally.play_order import advance_play, locate_event, start_play
from models.estimation.rally.single_flight import FlightPrior, SingleFlight, build_flight_prior, fit_single_flight

# s, longest flight between two events, and most stretches between kinks in it.
_LONGEST_FLIGHT, _MOST_STRETCHES = 3.5, 7
# Standard deviations of a place in the image for kinks, and the cost of one: low, so that none is missed.
_KINK_SIGMAS, _KINK_COST = 1.2, 5.0
# s of no sight after which a flight may have begun unseen: half the time of a fast exchange. Few places on both sides
# of a gap fit any curve.
_UNSEEN_TIME = 0.25
# Gravities of acceleration within a flight, seen from any side, and s in which they may change as much.
_KINK_GRAVITIES, _BEND_TIME = 2.0, 0.1
# chi2 per observation from which a stretch is no flight, and longer ones are not tried: a place that is clutter costs
# twice `CLUTTER_COST`, so that half of them are.
_HOPELESS = CLUTTER_COST
# Best sequences that are kept at every flight.
_BEST = 4
# Cost of a rest.
_REST_COST = 8.0


@dataclass(frozen=True, slots=True)
class FlightGuess:
    """A flight of a hypothesis."""

    first: int
    last: int
    """Indices of its first and last observation."""
    flight: SingleFlight
    kind: RallyEventKind | None
    """The event that begins it; None where nothing precedes."""
    t: float
    """s, of that event; of the first observation without one."""
    is_joined: bool
    """Whether the flight before it ends with that event."""


@dataclass(frozen=True, slots=True)
class RallyHypothesis:
    """A sequence of flights."""

    flights: tuple[FlightGuess, ...]
    evidence: float
    """Natural logarithm."""


@dataclass(frozen=True, slots=True)
class _Node:
    begin: int
    """Index of the kink before the first observation."""
    end: int
    flight: SingleFlight | None
    """None for an object at rest."""
    evidence: float


def find_kinks(observed: FlightObservations, px: FloatArray, sport: Sport) -> IntArray:
    """Find where the path in the image may have kinks.

    Args:
        observed: N observations.
        px: (N, 2) places in an image that stands still.

    Returns:
        Indices (M + 1,) of the first observations of M stretches, and N.
    """
    n = len(observed)
    noise = np.sqrt(np.maximum(np.einsum("nij,nij->n", observed.whitening, observed.whitening) / 2, 1e-9))
    middle = np.array([sport.length / 2, sport.width / 2, 1.0, 1.0])
    per_metre = np.linalg.norm(observed.matrix[:, 0, :3], axis=1) / np.maximum(observed.matrix[:, 2] @ middle, 1.0)
    steps = np.linalg.norm(np.diff(px, axis=0), axis=1) / np.diff(observed.t)
    best, source = np.full(n + 1, np.inf), np.zeros(n + 1, np.int64)
    best[0] = 0.0
    for i in range(n):
        last = int(np.searchsorted(observed.t, observed.t[i] + _LONGEST_FLIGHT))
        fastest = float(steps[i : i + 3].max(initial=0.0))
        slowing = sport.object.drag.mean * fastest**2 / per_metre[i]
        bend = np.hypot(_KINK_GRAVITIES * GRAVITY * per_metre[i], slowing)
        tau, sigma = observed.t[i:last] - observed.t[i], _KINK_SIGMAS / noise[i:last]
        cost = best[i] + _KINK_COST + 0.5 * _fit_cubics(tau, px[i:last], sigma, float(bend))
        ends = slice(i + 1, last + 1)
        better = cost < best[ends]
        best[ends] = np.where(better, cost, best[ends])
        source[ends] = np.where(better, i, source[ends])
    kinks = [n]
    while kinks[-1] > 0:
        kinks.append(int(source[kinks[-1]]))
    marked = np.searchsorted(observed.t, [mark.t for mark in observed.marks if mark.is_there])
    after_gaps = np.flatnonzero(np.diff(observed.t) > _UNSEEN_TIME) + 1
    return np.unique(np.concatenate([kinks, after_gaps, marked[(marked > 0) & (marked < n)]]))


def _fit_cubics(t: FloatArray, px: FloatArray, sigma: FloatArray, bend: float) -> FloatArray:
    """Return chi2 (L,) of cubics in time that are fitted to the first 1 to L of L places.

    `bend`, px/s^2, is the standard deviation of their acceleration, which may change as much in `_BEND_TIME`.
    """
    scale = max(float(t[-1]), 1e-6) if len(t) else 1.0
    powers = (t / scale)[:, None] ** np.arange(7) / sigma[:, None] ** 2
    moments = np.cumsum(powers, axis=0)
    off = px - px[0]
    right = np.cumsum(powers[:, :4, None] * off[:, None, :], axis=0)
    total = np.cumsum((off**2 / sigma[:, None] ** 2).sum(axis=1))
    normal = moments[:, np.arange(4)[:, None] + np.arange(4)]
    stiff = np.array([0.0, 0.0, 2 / (bend * scale**2), 6 * _BEND_TIME / (bend * scale**3)])
    normal = normal + np.diag(stiff**2) + 1e-9 * normal[:, :1, :1] * np.eye(4)
    solved = np.linalg.solve(normal, right)
    return np.asarray(np.maximum(total - (solved * right).sum(axis=(1, 2)), 0.0))


def segment_rally(
    observed: FlightObservations, px: FloatArray, sport: Sport, progress: Progress
) -> tuple[RallyHypothesis, ...]:
    """Find the most probable sequences of flights.

    Args:
        observed: N observations of the object.
        px: (N, 2) places in an image that stands still.
        progress: Receives the finished share.

    Returns:
        Hypotheses, the most probable first; none where nothing flies.
    """
    if len(observed) < 3:
        return ()
    kinks, prior = find_kinks(observed, px, sport), build_flight_prior(sport)
    nodes: list[_Node] = []
    for begin in range(len(kinks) - 1):
        nodes += _fit_from(begin, kinks, observed, px, sport, prior)
        progress(begin / len(kinks))
    return _find_sequences(nodes, kinks, observed, sport, prior)


def _fit_from(
    begin: int, kinks: IntArray, observed: FlightObservations, px: FloatArray, sport: Sport, prior: FlightPrior
) -> list[_Node]:
    """Fit the flights, and find the rests, that begin at a kink."""
    nodes: list[_Node] = []
    first = int(kinks[begin])
    for end in range(begin + 1, len(kinks)):
        last = int(kinks[end])
        off = px[first:last] - np.median(px[first:last], axis=0)
        if last - first >= 3 and np.abs(off).max() < REST_PX:
            nodes.append(_Node(begin, end, None, -_REST_COST - 0.5 * float((off**2).sum())))
        if end - begin > _MOST_STRETCHES or observed.t[last - 1] - observed.t[first] > _LONGEST_FLIGHT:
            break
        part = observed.select(slice(first, last))
        fitted: list[SingleFlight] = []
        for heading in (1.0, -1.0) if last - first > 2 else (0.0,):
            flight = fit_single_flight(part, sport, prior, heading=heading)
            if flight is not None and not any(_agree(flight, other) for other in fitted):
                fitted.append(flight)
        nodes += [_Node(begin, end, flight, flight.evidence) for flight in fitted]
        if fitted and last - first > 6 and min(flight.cost for flight in fitted) > _HOPELESS * (last - first):
            break
    return nodes


def _agree(one: SingleFlight, other: SingleFlight) -> bool:
    off = one.path.states[0, :3] - other.path.states[0, :3]
    return bool(np.linalg.norm(off) < 0.1 and abs(one.cost - other.cost) < 1.0)


def _collect_ends(nodes: list[_Node], t: FloatArray, is_end: bool) -> FlightEnds:
    row = -1 if is_end else 0
    flights = [node.flight for node in nodes if node.flight is not None]
    states = np.array([flight.path.states[row] for flight in flights])
    by = np.array([flight.path.derivatives[row] for flight in flights])
    covariances = np.array([flight.covariance for flight in flights])
    accelerations = np.array([flight.path.accelerations[row] for flight in flights])
    return FlightEnds(float(t), states, by @ covariances @ by.transpose(0, 2, 1), accelerations)


@dataclass(frozen=True, slots=True)
class _Step:
    """A partial sequence that ends with a node."""

    score: float
    node: int
    previous: _Step | None
    kind: RallyEventKind | None
    t: float
    belief: FloatArray
    """(10,) of the state of play, see `play_order`."""


def _find_sequences(
    nodes: list[_Node], kinks: IntArray, observed: FlightObservations, sport: Sport, prior: FlightPrior
) -> tuple[RallyHypothesis, ...]:
    """Find the best sequences of nodes; stretches between them may be skipped as clutter."""
    count = len(kinks) - 1
    starting = [[k for k, node in enumerate(nodes) if node.begin == at] for at in range(count + 1)]
    steps: list[list[_Step]] = [[] for _ in nodes]
    ends: list[list[_Step]] = [[] for _ in range(count + 1)]
    sizes = np.diff(kinks)
    ended: list[_Step] = []
    for at in range(count + 1):
        skipped = -CLUTTER_COST * float(sizes[:at].sum())
        now = starting[at]
        for k in now:
            node = nodes[k]
            steps[k].append(
                _Step(skipped + node.evidence, k, None, None, float(observed.t[kinks[at]]), start_play(sport))
            )
        for back in range(max(at - 2, 0), at + 1):  # stretches from `back` to `at` are clutter
            cost = CLUTTER_COST * float(sizes[back:at].sum())
            _join(ends[back], now, nodes, steps, cost, kinks, observed, sport, prior)
        for k in now:
            # nothing follows a landing, so one that comes too early must not crowd out what goes on
            flies_on = sorted((step for step in steps[k] if step.kind != "landing"), key=lambda step: -step.score)
            landed = sorted((step for step in steps[k] if step.kind == "landing"), key=lambda step: -step.score)
            steps[k] = flies_on[:_BEST] + landed[:_BEST]
            ends[nodes[k].end].extend(steps[k])
        rest = CLUTTER_COST * float(sizes[at:].sum())
        ended += [replace(step, score=step.score - rest) for step in ends[at]]
    best = sorted(ended, key=lambda step: -step.score)
    hypotheses: dict[tuple[object, ...], RallyHypothesis] = {}
    for step in best:
        hypothesis = _trace(step, nodes, kinks)
        key = tuple((guess.first, guess.kind) for guess in hypothesis.flights)
        if hypothesis.flights and key not in hypotheses:
            hypotheses[key] = hypothesis
        if len(hypotheses) == _BEST:
            break
    return tuple(hypotheses.values())


def _join(
    arriving: list[_Step],
    now: list[int],
    nodes: list[_Node],
    steps: list[list[_Step]],
    cost: float,
    kinks: IntArray,
    observed: FlightObservations,
    sport: Sport,
    prior: FlightPrior,
) -> None:
    """Continue partial sequences with the nodes that begin now."""
    for k in now:
        flight = nodes[k].flight
        for step in arriving:
            if step.kind == "landing" and flight is not None:
                continue
            if flight is None or nodes[step.node].flight is None:
                t, order, belief = float(observed.t[kinks[nodes[k].begin]]), np.zeros(()), start_play(sport)
                if flight is not None:
                    x, sigma = flight.path.states[0, :1], np.sqrt(flight.covariance[0, :1])
                    where = locate_event(x, sigma, np.zeros(1, np.bool_), sport)[0]
                    order, belief = _follow_rules(belief, "hit", where, sport)
                score = step.score + nodes[k].evidence - cost + float(order)
                steps[k].append(_Step(score, k, step, None if flight is None else "hit", t, belief))
    flying = [k for k in now if nodes[k].flight is not None]
    before = list(dict.fromkeys(step.node for step in arriving if nodes[step.node].flight is not None))
    if not flying or not before:
        return
    t_a, t_b = observed.t[kinks[nodes[before[0]].end] - 1], observed.t[kinks[nodes[flying[0]].begin]]
    weights = weigh_events(
        _collect_ends([nodes[k] for k in before], t_a, True),
        _collect_ends([nodes[k] for k in flying], t_b, False),
        sport,
        prior,
    )
    joined = [step for step in arriving if step.node in before]
    rows, beliefs = [before.index(step.node) for step in joined], np.array([step.belief for step in joined])
    for kind, (alone, when, where) in weights.items():
        value = alone + _weigh_mark(observed, kind, int(kinks[nodes[flying[0]].begin]), when)
        # after a landing it hops, and nobody plays on
        usable = [i for i, step in enumerate(joined) if step.kind != "landing" or kind == "landing"]
        for column, k in enumerate(flying):
            orders, after = _follow_rules(beliefs, kind, where[rows, column], sport)
            for i in usable:
                score = joined[i].score + nodes[k].evidence - cost + float(value[rows[i], column] + orders[i])
                steps[k].append(_Step(score, k, joined[i], kind, float(when[rows[i], column]), after[i]))


def _weigh_mark(observed: FlightObservations, kind: RallyEventKind, row: int, when: FloatArray) -> FloatArray:
    """Weigh by what a person marked an event before an observation; `when` (A, B), s, is its time."""
    own, t = [mark for mark in observed.marks if mark.kind == kind], observed.t
    if any(mark.is_there and t[row - 1] < mark.t <= t[row] for mark in own):
        return np.full(when.shape, MARK_EVIDENCE)
    denied = [mark.is_near(when) for mark in own if not mark.is_there]
    return np.asarray(-MARK_EVIDENCE * np.any(denied, axis=0) if denied else 0 * when)


def _follow_rules(
    belief: FloatArray, kind: RallyEventKind, where: FloatArray, sport: Sport
) -> tuple[FloatArray, FloatArray]:
    """Return the logarithms (...) of the probability of an event by the rules, and the states (..., 10) after it."""
    after = advance_play(belief, kind, where, sport)
    total = after.sum(axis=-1)
    return np.asarray(np.log(total)), np.asarray(after / total[..., None])


def _trace(step: _Step, nodes: list[_Node], kinks: IntArray) -> RallyHypothesis:
    guesses: list[FlightGuess] = []
    at: _Step | None = step
    while at is not None:
        node = nodes[at.node]
        if node.flight is not None:
            first, last = int(kinks[node.begin]), int(kinks[node.end]) - 1
            is_joined = at.previous is not None and nodes[at.previous.node].flight is not None
            guesses.append(FlightGuess(first, last, node.flight, at.kind, at.t, is_joined))
        at = at.previous
    return RallyHypothesis(tuple(guesses[::-1]), step.score)
