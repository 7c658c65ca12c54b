"""Words of the strokes of a rally, and of who won its last point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.fit_result import SURE_PROBABILITY
from models.core.number_format import (
    format_flight_speed,
    format_moment,
    format_probability,
    format_time,
    format_with_sigma,
)
from models.core.rally import LandingHypothesis, Rally
from models.estimation.rally.landing_judgement import LandingCall, find_last_hit, weigh_hitter
from models.estimation.rally.point_judgement import judge_point, name_half
from models.estimation.rally.stroke_summary import Stroke
from pipeline.reporting.text.rally_sentences import format_height_over_net, format_landing

OTHER_SIDE = {"near": "far", "far": "near", "left": "right", "right": "left"}
# s of the clip after a bounce without another hit, from which nobody can have returned it.
UNRETURNED_S = 1.0
# m, error of a landing from which nothing useful is known of its place.
MAX_PLACE_SIGMA = 2.0
NOT_KNOWN = "not known"


@dataclass(frozen=True, slots=True)
class PointWords:
    """Who won the last point of a rally."""

    headline: str
    is_decided: bool
    reason: str
    confidence: str


def format_point(rally: Rally, call: LandingCall) -> PointWords:
    """Format who won the last point of a rally by the call of its landing, why, and how sure that is."""
    words, name = format_landing(call, rally), rally.scene.sport.object.name
    hit = find_last_hit(rally, np.inf if call.landing is None else call.landing.t)
    hitter = "" if hit is None or not hit.player else hit.player
    winner, chance = judge_point(rally, call)
    if call.landing is not None and call.landing.is_rolling:
        return _format_rolled_point(rally, call.landing, winner, chance)
    chances = [("in", call.probability), ("out", call.out_probability), ("no landing in view", rally.no_landing)]
    stated = [f"{what}: {format_probability(p)}" for what, p in chances if p >= 0.0005 or what != chances[2][0]]
    confidence = f"{', '.join(stated)} (by the rules of {call.area.replace('-', ' ')})."
    sure = weigh_hitter(rally, hit) if hit is not None and hitter else 1.0
    if sure < SURE_PROBABILITY:
        certainty = format_probability(sure)
        confidence += f" These include the probability that the {hitter} player hit it last: {certainty}."
    reason = " ".join(filter(None, [_describe_end(rally, call, hitter), words.advice]))
    if not winner or call.verdict == "undecided":
        if hitter and call.landing is not None:
            reason += f" If it was in, the {hitter} player won; if it was out, the {OTHER_SIDE[hitter]} player."
        return PointWords("Who won the last point cannot be decided.", False, reason, confidence)
    end = f": the {name} was {call.verdict}"
    if call.verdict == "in" and _may_go_on(rally, call):
        end = f", unless the {OTHER_SIDE[hitter]} player returned it after the clip"
    elif call.verdict == "out" and call.landing is not None and name_half(rally, call.landing) == hitter:
        end = f": the {name} did not cross the net"
    return PointWords(f"The {winner} player won the last point{end}.", True, reason, confidence)


def _format_rolled_point(rally: Rally, landing: LandingHypothesis, winner: str, chance: float) -> PointWords:
    """Format who won a point that ends with a ball that rolls on the table."""
    name, loser = rally.scene.sport.object.name, OTHER_SIDE[winner]
    reason = (
        f"From {format_time(landing.t, landing.t_sigma)} on the {name} rolls on the {loser} half of the table: the"
        f" {loser} player did not return it, or did not get it over the net."
    )
    confidence = f"That it rolls there: {format_probability(chance)}, whoever hit it last."
    if chance < SURE_PROBABILITY:
        return PointWords("Who won the last point cannot be decided.", False, reason, confidence)
    headline = f"The {winner} player won the last point: the {name} stayed on the {loser} half."
    return PointWords(headline, True, reason, confidence)


def _may_go_on(rally: Rally, call: LandingCall) -> bool:
    """Return whether the object bounces and the clip ends before nobody can return it any more."""
    bounces = rally.scene.sport.object.restitution is not None
    return bounces and call.landing is not None and float(rally.t[-1]) - call.landing.t < UNRETURNED_S


def _describe_end(rally: Rally, call: LandingCall, hitter: str) -> str:
    """Describe the last hit and the landing in a sentence."""
    words, name = format_landing(call, rally), rally.scene.sport.object.name
    if call.landing is None:
        return f"The clip does not show where the {name} came down."
    who = f"The {hitter} player hit last. " if hitter else ""
    verb = "landed" if call.landing.is_seen else "would have landed, by its flight until then,"
    return f"{who}The {name} {verb} {words.margin} at {format_time(call.landing.t, call.landing.t_sigma)}."


STROKE_HEADINGS = ("time", "player", "speed at the racket", "apex", "at the net", "landing", "place")
# Those for which a narrow screen has room.
NARROW_COLUMNS = tuple(map(STROKE_HEADINGS.index, ("time", "player", "speed at the racket", "landing")))


def list_stroke_rows(rally: Rally, strokes: tuple[Stroke, ...]) -> list[tuple[float, tuple[str, ...]]]:
    """List the strokes as table rows: time, s, and the cells under `STROKE_HEADINGS`."""
    return [
        (
            one.hit.t,
            (
                format_time(one.hit.t, one.hit.t_sigma),
                (one.hit.player or NOT_KNOWN) + _format_doubt(one),
                format_flight_speed(one.hit.speed, one.hit.speed_sigma) if np.isfinite(one.hit.speed) else NOT_KNOWN,
                f"{format_with_sigma(float(one.apex[2]), one.apex_sigma, 2)} m"
                if np.isfinite(one.apex[2])
                else NOT_KNOWN,
                format_net(one),
                *_split_stroke_end(rally, one),
            ),
        )
        for one in strokes
    ]


def _format_doubt(stroke: Stroke) -> str:
    """Format the probability of a hit that is not sure."""
    sure = stroke.hit.probability >= SURE_PROBABILITY
    return "" if sure else f" ({format_probability(stroke.hit.probability)})"


def format_net(stroke: Stroke) -> str:
    """Format how high a stroke crossed the net."""
    if stroke.net is None:
        return NOT_KNOWN
    if stroke.net.is_touch:
        return "touched it"
    return format_height_over_net(stroke.net)


def format_stroke_end(rally: Rally, stroke: Stroke) -> str:
    """Format where a stroke landed, or would have landed had nobody returned it."""
    return ", ".join(filter(None, _split_stroke_end(rally, stroke)))


def _split_stroke_end(rally: Rally, stroke: Stroke) -> tuple[str, str]:
    """Format whether a stroke landed in, and how far from which line; the second is empty where that is not known."""
    call = stroke.call
    if call is None or call.landing is None:
        return NOT_KNOWN, ""
    if float(np.sqrt(np.linalg.eigvalsh(call.landing.covariance[:2, :2]).max())) > MAX_PLACE_SIGMA:
        return NOT_KNOWN, ""
    words = format_landing(call, rally)
    why = "after the clip" if call.landing.t > rally.t[-1] else "without the return"
    would = "" if call.landing.is_seen else f"{why}, at {format_moment(call.landing.t)}: "
    return f"{would}{words.verdict} ({words.probability})", words.margin
