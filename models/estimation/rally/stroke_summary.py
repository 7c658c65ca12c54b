"""The strokes of a rally in numbers: speed at the racket, apex, height over the net, and where each one landed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.rally import LandingHypothesis, Rally, RallyEvent
from models.core.typing import FloatArray
from models.estimation.rally.landing_hypotheses import find_first_touch, predict_landing
from models.estimation.rally.landing_judgement import LandingCall, NetCrossing, judge_landing, judge_net
from models.estimation.rally.rally_views import PlacesInSpace, evaluate_rally

# s between the places among which the highest is sought: at the apex, an object rises by 1 mm in that time.
APEX_STEP_S = 0.01
# s by which the start of a flight and its hit may differ by rounding.
SAME_TIME_S = 1e-6


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
    call: LandingCall | None
    """Whether it first touched the surface in or out; None where that is unknown. Where it was returned before, its
    landing is not seen: the flight is continued by its physics as if nobody had returned it.
    """


def summarize_strokes(rally: Rally, area: str | None = None) -> tuple[Stroke, ...]:
    """Summarize the strokes of a rally in the order of time; `area` is that of `judge_landing`."""
    hits = [event for event in rally.events if event.kind == "hit"]
    crossings, ends = judge_net(rally), [*(hit.t for hit in hits), np.inf][1:]
    return tuple(_summarize_stroke(rally, hit, end, crossings, area) for hit, end in zip(hits, ends, strict=True))


def _summarize_stroke(
    rally: Rally, hit: RallyEvent, end: float, crossings: tuple[NetCrossing, ...], area: str | None
) -> Stroke:
    """Summarize the stroke from a hit to the next one at `end`, s, or infinity."""
    own = [k for k, one in enumerate(rally.flights) if hit.t - SAME_TIME_S <= one.start < end - SAME_TIME_S]
    net = next((one for one in crossings if hit.t < one.t < end), None)
    apex, sigma = np.full(3, np.nan), np.nan
    last = rally.flights[own[-1]].end if own else hit.t
    if own:
        t = np.append(np.arange(rally.flights[own[0]].start, last, APEX_STEP_S), last)
        path = evaluate_rally(rally, t)
        if np.isfinite(path.xyz[:, 2]).any():
            highest = int(np.nanargmax(path.xyz[:, 2]))
            apex, sigma = path.xyz[highest], float(np.sqrt(path.covariance[highest, 2, 2]))
    landing = _find_landing(rally, hit, own, end == np.inf)
    call = None
    if end == np.inf and rally.landings:
        call = judge_landing(rally, area)
    elif landing is not None:
        until = tuple(one for one in rally.events if one.t <= hit.t)
        flights = rally.flights[: own[-1] + 1] if own else ()
        part = replace(rally, events=until, flights=flights, landings=(landing,), no_landing=1 - landing.weight)
        call = judge_landing(part, area)
    return Stroke(hit, last, apex, sigma, net, call)


def _find_landing(rally: Rally, hit: RallyEvent, flights: list[int], is_last: bool) -> LandingHypothesis | None:
    """Find where a stroke first touched the surface, or would have had nobody returned it; None where unknown."""
    if is_last and rally.landings:
        return rally.landings[0]
    touch = find_first_touch(rally.events, rally.events.index(hit), rally.scene.sport)
    if touch is not None:
        return LandingHypothesis(1.0, touch.t, touch.t_sigma, touch.place, touch.covariance, True)
    if not flights:
        return None
    flight = rally.flights[flights[-1]]
    landing = predict_landing(flight, rally.scene.sport, flight.end, float(np.median(np.diff(rally.t))))
    return None if landing is None else replace(landing, weight=1.0, is_seen=False)


def find_service(rally: Rally, area: str) -> LandingCall | None:
    """Judge the first stroke of a rally as a service that may have been played on after it landed.

    Returns:
        The call; None where the rally has no stroke, or where the service was returned before it landed.
    """
    hits = [k for k, event in enumerate(rally.events) if event.kind == "hit"]
    touch = find_first_touch(rally.events, hits[0], rally.scene.sport) if hits else None
    if len(hits) == 1:
        return judge_landing(rally, area)
    return None if touch is None else summarize_strokes(rally, area)[0].call


def find_current_stroke(strokes: tuple[Stroke, ...], t: float) -> int:
    """Find the index of the stroke that a time, s, belongs to; -1 before the first."""
    return int(np.searchsorted([one.hit.t for one in strokes], t, side="right")) - 1


def sample_flights(rally: Rally, step: float) -> list[PlacesInSpace]:
    """Sample every flight by a step, s, with both of its ends."""
    return [evaluate_rally(rally, np.append(np.arange(one.start, one.end, step), one.end)) for one in rally.flights]
