"""Umpires' questions about a rally: did it land in, and how high over the net did it fly?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.special import ndtr

from models.core.court import Rectangle, Sport
from models.core.fit_result import AMBER_SHARE, SURE_PROBABILITY
from models.core.rally import Flight, LandingHypothesis, Rally, RallyEvent
from models.core.typing import FloatArray
from models.estimation.rally.rally_views import continue_flight, evaluate_rally

# Nodes of the Gauss-Legendre rule along y, and standard deviations beyond which there is nothing to integrate.
NODES, REACH_SIGMAS = 200, 8.0
# m, below the least standard deviation of a place that any camera gives; it only keeps divisions finite.
LEAST_SIGMA = 1e-6
# s between times at which a flight is sought at the net: at 75 m/s it moves 15 cm, and its height is interpolated.
NET_STEP_S = 0.002
# s up to which an event and a landing hypothesis are the same moment: half a frame at 25 fps.
SAME_MOMENT_S = 0.02
# Standard deviations from a line, or the net, up to which a landing may lie on either side of it.
SIDE_SIGMAS = 3.0
# m by which an outer edge of a line and of an area may differ by rounding.
EDGE_TOLERANCE = 1e-6

# Misfit per degree of freedom, and share of the places where the object was seen during a flight, beyond which the law
# of flight does not explain it: as for segments of billiards. Its landing is then anywhere.
MAX_FLIGHT_CHI2, MIN_USED_SHARE = 4.0, 0.5
# Players who hit towards larger x.
FORWARD = ("near", "left")
# Probability of what nothing observed speaks for or against (principle of indifference).
INDIFFERENT = 0.5

CallReason = Literal[
    "close", "no_landing", "hit_doubtful", "hitter_unknown", "several", "unexplained", "mostly_unexplained"
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class LineDistance:
    """How far a landing is from a line."""

    line: str
    """Its name, or `net`."""
    distance: float
    """m from the outer edge of the line to the place of contact, positive for in."""
    sigma: float
    """m."""


@dataclass(frozen=True, slots=True)
class LandingCall:
    """Whether the ball or shuttle landed in an area."""

    area: str
    """Name of the rule, such as `singles`."""
    verdict: Literal["in", "out", "undecided"]
    probability: float
    """Of in; a place on the line is in."""
    out_probability: float
    """Of out; the rest to 1 is that it does not land, or that the last hit was none."""
    half: str
    """Half in which a landing is good: `near`, `far`, `left` or `right`; empty where that is not known."""
    rectangles: tuple[Rectangle, ...]
    """Where a landing is good, m."""
    landing: LandingHypothesis | None
    """The most probable one; None where it more probably does not land."""
    line: str
    """The nearest line, or `net`; beyond several, the one that is missed by most. Empty without a landing."""
    distance: float
    """m from the outer edge of that line to the place of contact, positive for in; NaN without a landing."""
    distance_sigma: float
    speed: float
    """m/s, at the landing; NaN where it is unknown."""
    speed_sigma: float
    frames: tuple[int, int]
    """Frames in the file between which it lands: sharp ones, or more of them, would decide."""
    reason: CallReason | None
    """Why the clip does not decide; None where it does."""
    rival: LineDistance | None = None
    """Another line, on either side of which the object may have landed, and which is nearer in standard deviations: the
    probability depends more on it. None without such a line, and where the place of the landing is not trusted."""


@dataclass(frozen=True, slots=True)
class NetCrossing:
    """A flight over, or into, the net."""

    t: float
    """s."""
    place: FloatArray
    """(3,) m, centre of the object in the plane of the net."""
    height: float
    """m, of the lowest point of the object over the upper edge of the net; negative below it."""
    height_sigma: float
    speed: float
    """m/s."""
    is_touch: bool = False
    """Whether it touched the net."""

    @property
    def over_probability(self) -> float:
        """Probability that it is over the edge."""
        return float(ndtr(self.height / max(self.height_sigma, LEAST_SIGMA)))


def judge_landing(rally: Rally, area: str | None = None) -> LandingCall:
    """Judge whether the object landed in an area, over all hypotheses of its landing.

    Args:
        area: Name of the area in the rules of the sport; None for the usual one.

    Returns:
        The call. It is undecided unless in or out is at least as probable as `SURE_PROBABILITY`, and where the law of
        flight does not explain the flight to the landing, or most of the rally: wrong flights have wrong errors.

    Raises:
        ValueError: The sport has no such area.
    """
    sport = rally.scene.sport
    name = sport.default_area if area is None else area
    if name not in sport.areas:
        raise ValueError(f"{sport.name} has the areas {', '.join(sport.areas)}; got {name!r}")
    landings = sorted(rally.landings, key=lambda one: -one.weight)
    # a landing that is less probable than none is not stated
    best = landings[0] if landings and rally.no_landing <= INDIFFERENT else None
    targets = _weigh_targets(rally, name, best)
    inside = sum(
        one.weight * share * sum(_integrate_over(rectangle, one, sport) for rectangle in rectangles)
        for one in landings
        for rectangles, share in targets
    )
    # where the last hit is doubtful, so is the half in which a landing is good
    weight = sum(one.weight for one in landings) * sum(share for _, share in targets)
    doubt = None if best is None or best.is_rolling else _find_doubt(rally, best)
    probability = float(np.clip(inside, 0.0, weight)) if doubt is None else INDIFFERENT * weight
    out = float(weight - probability)
    verdict: Literal["in", "out", "undecided"] = "undecided"
    if max(probability, out) >= SURE_PROBABILITY:
        verdict = "in" if probability >= out else "out"
    rectangles = max(targets, key=lambda one: one[1])[0]
    nearest, rival = LineDistance("", math.nan, math.nan), None
    if best is not None:
        nearest, rival = _measure_distances(rectangles, best, sport)
    speed, speed_sigma = _find_speed(rally, best)
    return LandingCall(
        name, verdict, probability, out, _name_half(sport, targets), rectangles, best, nearest.line,
        nearest.distance, nearest.sigma, speed, speed_sigma, _find_deciding_frames(rally, best),
        None if verdict != "undecided" else doubt or _find_reason(rally, targets, landings),
        rival if doubt is None else None,
    )  # fmt: skip


def judge_net(rally: Rally) -> tuple[NetCrossing, ...]:
    """Measure how high every flight crosses the plane of the net or touches the net, in order of time."""
    sport = rally.scene.sport
    crossings = []
    for flight in rally.flights:
        steps = max(math.ceil((flight.end - flight.start) / NET_STEP_S), 1)
        t = np.linspace(flight.start, flight.end, steps + 1)[1:-1]  # at its ends, two flights meet
        beyond = evaluate_rally(rally, t).xyz[:, 0] - sport.length / 2
        for k in np.flatnonzero(beyond[:-1] * beyond[1:] < 0):
            share = beyond[k] / (beyond[k] - beyond[k + 1])
            crossings.append(_measure_crossing(rally, float(t[k] + share * (t[k + 1] - t[k]))))
    touches = [one for one in rally.events if one.kind == "net" and one.probability >= INDIFFERENT]
    # two flights that meet at a touch may both cross the plane beside it
    crossings = [one for one in crossings if all(abs(one.t - touch.t) > SAME_MOMENT_S for touch in touches)]
    for one in touches:
        edge = float(sport.net.height_at(one.place[[1]], sport.width)[0])
        height, sigma = float(one.place[2]) - sport.object.radius - edge, math.sqrt(float(one.covariance[2, 2]))
        crossings.append(NetCrossing(one.t, one.place, height, sigma, one.speed, is_touch=True))
    return tuple(sorted(crossings, key=lambda one: one.t))


def _measure_crossing(rally: Rally, t: float) -> NetCrossing:
    """Measure a crossing at t, s; the error along the flight only shifts the moment at which it crosses."""
    sport, at = rally.scene.sport, evaluate_rally(rally, np.array([t]))
    place, v, covariance = at.xyz[0], at.v[0], at.covariance[0]
    edge = float(sport.net.height_at(place[[1]], sport.width)[0])
    step = 1e-3
    slope = (float(sport.net.height_at(place[[1]] + step, sport.width)[0]) - edge) / step
    along = np.array([-(v[2] - slope * v[1]) / v[0], -slope, 1.0])  # of the height in the plane by x, y and z
    sigma = math.sqrt(max(float(along @ covariance @ along), 0.0))
    return NetCrossing(
        t, place, float(place[2]) - sport.object.radius - edge, sigma, float(np.linalg.norm(v))
    )  # fmt: skip


def is_explained(rally: Rally, flight: Flight) -> bool:
    """Return whether the law of flight explains where the object was seen during a flight; too few places never do."""
    rows = (rally.t >= flight.start) & (rally.t <= flight.end) & np.isfinite(rally.px[:, 0])
    is_used = not rows.any() or float(np.mean(rally.is_used[rows])) >= MIN_USED_SHARE
    return is_used and flight.chi2 <= MAX_FLIGHT_CHI2


def find_explained_share(rally: Rally) -> float:
    """Find the share of the time in flight that the law of flight explains; 0 without any flight."""
    spans = sum(one.end - one.start for one in rally.flights)
    explained = sum(one.end - one.start for one in rally.flights if is_explained(rally, one))
    return explained / spans if spans > 0 else 0.0


def _find_doubt(rally: Rally, landing: LandingHypothesis) -> CallReason | None:
    """Find why the place of a landing is not trusted: no law explains its flight or the rally; no player hits back."""
    hit = find_last_hit(rally, landing.t)
    if hit is not None and hit.player and (landing.place[0] > hit.place[0]) != (hit.player in FORWARD):
        return "unexplained"
    before = [one for one in rally.flights if one.start < landing.t - SAME_MOMENT_S]
    if before and not is_explained(rally, before[-1]):
        return "unexplained"
    return "mostly_unexplained" if find_explained_share(rally) < AMBER_SHARE else None


def find_last_hit(rally: Rally, before: float = math.inf) -> RallyEvent | None:
    """Find the last probable hit before a time, s; None without one."""
    hits = [one for one in rally.events if one.kind == "hit" and one.probability >= 0.5 and one.t < before]
    return max(hits, key=lambda one: one.t, default=None)


def weigh_hitter(rally: Rally, hit: RallyEvent) -> float:
    """Return the probability that the player of the last hit hit last: of this hit, or of any of several."""
    player, chance = rally.last_player
    return max(hit.probability, chance) if hit.player == player else hit.probability


def _weigh_targets(
    rally: Rally, area: str, best: LandingHypothesis | None
) -> list[tuple[tuple[Rectangle, ...], float]]:
    """Weigh the sets of rectangles in which a landing may be good; shares add to the probability of the last hitter.

    A landing is good in the half opposite to the hitter, and a service in the box diagonally opposite.
    """
    sport = rally.scene.sport
    hit = find_last_hit(rally, math.inf if best is None else best.t)
    halves = {
        far: tuple(one for one in sport.areas[area] if ((one[0] + one[2]) / 2 > sport.length / 2) == far)
        for far in (True, False)
    }
    if hit is None or not hit.player:
        far = _weigh_direction(rally, best)
        return [(halves[True], far), (halves[False], 1 - far)]
    here = halves[hit.player in FORWARD]
    sides = {(one[1] + one[3]) / 2 > sport.width / 2 for one in here}
    sure = weigh_hitter(rally, hit)
    if len(here) < 2 or len(sides) < 2:
        return [(here, sure)]
    sigma = max(math.sqrt(float(hit.covariance[1, 1])), LEAST_SIGMA)
    from_low = float(ndtr((sport.width / 2 - hit.place[1]) / sigma))
    diagonal = {True: sure * from_low, False: sure * (1 - from_low)}  # from small y to large y, and back
    return [
        (tuple(one for one in here if ((one[1] + one[3]) / 2 > sport.width / 2) == high), share)
        for high, share in diagonal.items()
    ]


def _weigh_direction(rally: Rally, best: LandingHypothesis | None) -> float:
    """Return the probability that the object flew towards larger x, where no hit is known, by its last flight."""
    # a flight that begins at the net has turned round there
    turns = [one.t for one in rally.events if one.kind == "net"]
    flights = [
        one
        for one in rally.flights
        if (best is None or one.start < best.t) and not any(abs(one.start - t) < SAME_MOMENT_S for t in turns)
    ]
    if not flights:
        return INDIFFERENT
    sigma = max(math.sqrt(float(flights[-1].covariance[3, 3])), LEAST_SIGMA)
    return float(ndtr(flights[-1].parameters[3] / sigma))


def _integrate_over(rectangle: Rectangle, landing: LandingHypothesis, sport: Sport) -> float:
    """Integrate the normal distribution of a landing over a rectangle of the playing surface."""
    if sport.is_beside_table(landing.place[2]):
        return 0.0
    mean, covariance = landing.place[:2], landing.covariance[:2, :2]
    sigma_y = max(math.sqrt(float(covariance[1, 1])), LEAST_SIGMA)
    low, high = (
        float(np.clip((edge - mean[1]) / sigma_y, -REACH_SIGMAS, REACH_SIGMAS)) for edge in (rectangle[1], rectangle[3])
    )
    slope = covariance[0, 1] / sigma_y
    sigma_x = max(math.sqrt(max(float(covariance[0, 0] - slope**2), 0.0)), LEAST_SIGMA)
    nodes, weights = _list_nodes()
    u = low + (high - low) * (nodes + 1) / 2
    centre = mean[0] + slope * u
    within = ndtr((rectangle[2] - centre) / sigma_x) - ndtr((rectangle[0] - centre) / sigma_x)
    density = np.exp(-(u**2) / 2) / math.sqrt(2 * math.pi)
    return float((high - low) / 2 * np.sum(weights * density * within))


@lru_cache(1)
def _list_nodes() -> tuple[FloatArray, FloatArray]:
    """List the nodes and weights of the Gauss-Legendre rule on (-1, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return np.asarray(nodes), np.asarray(weights)


def _measure_distances(
    rectangles: tuple[Rectangle, ...], landing: LandingHypothesis, sport: Sport
) -> tuple[LineDistance, LineDistance | None]:
    """Measure the distances from the nearest line and from its `rival`, if any, see `LandingCall`.

    Of several rectangles, that counts in which the place lies deepest. The net is no line that one lands near, but a
    landing that may lie on either side of it.
    """
    sigmas = np.maximum(np.sqrt(np.diag(landing.covariance)[:2]), LEAST_SIGMA)
    choices = []
    for x0, y0, x1, y1 in rectangles:
        x, y = landing.place[:2]
        margins = []
        for distance, axis, at in ((x - x0, 0, x0), (x1 - x, 0, x1), (y - y0, 1, y0), (y1 - y, 1, y1)):
            name, sigma = _name_edge(axis, at, sport, float(landing.place[1 - axis])), float(sigmas[axis])
            if name != "net" or distance < SIDE_SIGMAS * sigma:
                margins.append(LineDistance(name, float(distance), sigma))
        choices.append(margins)
    margins = max(choices, key=lambda one: min(margin.distance for margin in one))
    nearest = min(margins, key=lambda one: one.distance)
    rival = min(margins, key=lambda one: one.distance / one.sigma)
    return nearest, rival if rival != nearest and abs(rival.distance) < SIDE_SIGMAS * rival.sigma else None


def _name_edge(axis: int, at: float, sport: Sport, along: float) -> str:
    """Name the painted line on which the edge of an area lies, next to a place along it; `net` for the middle."""
    if axis == 0 and abs(at - sport.length / 2) < EDGE_TOLERANCE:
        return "net"
    lines = [
        line
        for line in sport.lines
        if line.start[axis] == line.end[axis] and abs(line.start[axis] - at) < line.width / 2 + EDGE_TOLERANCE
    ]
    middles = [(line.start[1 - axis] + line.end[1 - axis]) / 2 for line in lines]
    return lines[int(np.argmin(np.abs(np.array(middles) - along)))].name if lines else "edge"


def _name_half(sport: Sport, targets: list[tuple[tuple[Rectangle, ...], float]]) -> str:
    """Name the half of the court in which the targets lie that are not ruled out; empty where they lie in both."""
    halves = {
        (one[0] + one[2]) / 2 > sport.length / 2
        for rectangles, share in targets
        for one in rectangles
        if share > 1 - SURE_PROBABILITY
    }
    return sport.halves[halves.pop()] if len(halves) == 1 else ""


def _find_speed(rally: Rally, landing: LandingHypothesis | None) -> tuple[float, float]:
    """Find the speed at a landing and its sigma, m/s: of the event there, else of the continued flight."""
    if landing is None or landing.is_rolling:
        return math.nan, math.nan
    touches = [one for one in rally.events if one.kind in ("landing", "bounce")]
    event = min(touches, key=lambda one: abs(one.t - landing.t), default=None)
    if event is not None and abs(event.t - landing.t) < SAME_MOMENT_S:
        return event.speed, event.speed_sigma
    begun = [k for k, flight in enumerate(rally.flights) if flight.start < landing.t]
    if not begun:
        return math.nan, math.nan
    path = continue_flight(rally, begun[-1], max(landing.t - rally.flights[begun[-1]].end, 0.0))
    is_there = np.isfinite(path.v[:, 0])
    return (float(np.linalg.norm(path.v[is_there][-1])), math.nan) if is_there.any() else (math.nan, math.nan)


def _find_deciding_frames(rally: Rally, landing: LandingHypothesis | None) -> tuple[int, int]:
    """Find the frames in which the object was last seen before a landing and first seen after it, or ended."""
    if landing is None or not len(rally.t):
        return (-1, -1)
    is_seen = np.isfinite(rally.px[:, 0])
    before, after = np.flatnonzero(is_seen & (rally.t <= landing.t)), np.flatnonzero(rally.t > landing.t)
    last = before[-1] if len(before) else 0
    return int(rally.frame[last]), int(rally.frame[after[0] if len(after) else -1])


def _find_reason(
    rally: Rally, targets: list[tuple[tuple[Rectangle, ...], float]], landings: list[LandingHypothesis]
) -> CallReason:
    """Find why a clip does not decide: no landing, an unknown side, rival landings, or the worse of hit and place."""
    if not landings or rally.no_landing > 1 - SURE_PROBABILITY:
        return "no_landing"
    inside = [sum(_integrate_over(one, landings[0], rally.scene.sport) for one in target) for target, _ in targets]
    if max(inside) - min(inside) > 0.5 and max(share for _, share in targets) < SURE_PROBABILITY:
        return "hitter_unknown"
    if landings[0].weight < SURE_PROBABILITY:
        return "several"
    share = sum(one for _, one in targets)
    within = sum(one * part for one, (_, part) in zip(inside, targets, strict=True)) / share
    return "hit_doubtful" if 1 - share > min(within, 1 - within) else "close"
