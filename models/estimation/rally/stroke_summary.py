"""The strokes of a rally in numbers: speed at the racket, apex, height over the net, and where each one landed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.court import Sport
from models.core.rally import Rally, RallyEvent
from models.core.typing import FloatArray
from models.estimation.rally.landing_judgement import NetCrossing, judge_net
from models.estimation.rally.rally_views import PlacesInSpace, continue_flight, evaluate_rally

# s between the places among which the highest is sought: at the apex, an object rises by 1 mm in that time.
APEX_STEP_S = 0.01
# s up to which a flight that was returned is continued.
LONGEST_FLIGHT_S = 5.0
# s by which the start of a flight and its hit may differ by rounding.
SAME_TIME_S = 1e-6
# m above the surface at which a continued flight has reached it.
ON_SURFACE = 0.01


@dataclass(frozen=True, slots=True)
class Stroke:
    """What became of one hit until the next one."""

    hit: RallyEvent
    end: float
    """s, of the last flight before the next hit; the time of the hit where no flight follows."""
    apex: FloatArray
    """(3,) m, highest place; NaN where no flight follows."""
    apex_sigma: float
    """m, of its height."""
    net: NetCrossing | None
    """Where it first crossed or touched the net."""
    landing: FloatArray
    """(3,) m, where it first touched the surface or the floor, or would have; NaN where that is unknown."""
    landing_covariance: FloatArray
    """(3, 3) m^2."""
    is_landed: bool
    """Whether it landed; otherwise the flight is continued by its physics as if nobody had returned it."""


def summarize_strokes(rally: Rally) -> tuple[Stroke, ...]:
    """Summarize the strokes of a rally in the order of time."""
    hits = [event for event in rally.events if event.kind == "hit"]
    ends = [*(event.t for event in hits[1:]), np.inf]
    crossings = judge_net(rally)
    return tuple(_summarize_stroke(rally, hit, end, crossings) for hit, end in zip(hits, ends, strict=True))


def _summarize_stroke(rally: Rally, hit: RallyEvent, end: float, crossings: tuple[NetCrossing, ...]) -> Stroke:
    """Summarize the stroke from a hit to the next one at `end`, s, or infinity."""
    own = [k for k, one in enumerate(rally.flights) if hit.t - SAME_TIME_S <= one.start < end - SAME_TIME_S]
    touches = [one for one in rally.events if one.kind in ("bounce", "landing") and hit.t < one.t < end]
    net = next((one for one in crossings if hit.t < one.t < end), None)
    place, covariance = np.full(3, np.nan), np.full((3, 3), np.nan)
    if touches:
        place, covariance = touches[0].place, touches[0].covariance
    elif end == np.inf and rally.landings:
        place, covariance = rally.landings[0].place, rally.landings[0].covariance
    elif own:
        path = continue_flight(rally, own[-1], LONGEST_FLIGHT_S)
        if _is_on_surface(path, rally.scene.sport):
            place, covariance = path.xyz[-1], path.covariance[-1]
    apex, sigma = np.full(3, np.nan), np.nan
    last = rally.flights[own[-1]].end if own else hit.t
    if own:
        t = np.append(np.arange(rally.flights[own[0]].start, last, APEX_STEP_S), last)
        path = evaluate_rally(rally, t)
        if np.isfinite(path.xyz[:, 2]).any():
            highest = int(np.nanargmax(path.xyz[:, 2]))
            apex, sigma = path.xyz[highest], float(np.sqrt(path.covariance[highest, 2, 2]))
    return Stroke(hit, last, apex, sigma, net, place, covariance, bool(touches) or end == np.inf)


def _is_on_surface(path: PlacesInSpace, sport: Sport) -> bool:
    """Return whether a continued flight ends on the playing surface or on the floor."""
    height = float(path.xyz[-1, 2]) - sport.object.radius
    return min(abs(height), abs(height - sport.floor)) < ON_SURFACE


def find_current_stroke(strokes: tuple[Stroke, ...], t: float) -> int:
    """Find the index of the stroke that a time, s, belongs to; -1 before the first."""
    return int(np.searchsorted([one.hit.t for one in strokes], t, side="right")) - 1


def sample_flights(rally: Rally, step: float) -> list[PlacesInSpace]:
    """Sample every flight by a step, s, with both of its ends."""
    return [evaluate_rally(rally, np.append(np.arange(one.start, one.end, step), one.end)) for one in rally.flights]
