"""Words of rallies: events, trust level, and the answers to an umpire's questions about a landing and the net."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from models.core.fit_result import AMBER_SHARE, GREEN_SHARE, Trust, TrustLevel, is_undecided
from models.core.number_format import format_flight_speed, format_probability, format_time
from models.core.rally import Rally, RallyEvent
from models.estimation.rally.landing_judgement import (
    SIDE_SIGMAS,
    CallReason,
    LandingCall,
    NetCrossing,
    find_explained_share,
)
from models.estimation.rally.landing_margin import format_distance, format_line_distance, format_margin
from pipeline.reporting.text.text_formatting import start_sentence

# px up to which painted lines lie where the camera puts them: they are a few pixels wide, and found to a fraction.
MAX_LINE_ERROR_PX = 2.0
EVENT_WORDS = {"hit": "is hit", "bounce": "bounces", "net": "touches the net", "landing": "lands"}
AREA_WORDS = {"service-box": "the service box"}
# That a camera turns is no doubt, and stands beside how well its lines fit.
HARMLESS_NOTE = "camera-moves"
NOTE_WORDS = {
    "incomplete_clip": "the clip is incomplete",
    "camera-motion-interpolated": "in some frames only the frames around them tell where the camera looks",
    "camera-travels": "the camera changes its place, not only its direction",
    "no-flight": "no flight was found",
}
REASON_WORDS: dict[CallReason, str] = {
    "close": "The error of the place reaches over the line.",
    "no_landing": "The clip does not show that it landed, nor that it would have.",
    "hit_doubtful": "The last hit is doubtful, and with it the half in which a landing is good.",
    "hitter_unknown": "The clip does not show from which side it was hit.",
    "unexplained": "The law of flight does not explain the last flight, so that its landing is unknown.",
    "mostly_unexplained": "The law of flight does not explain most of the rally, so that its landing is unknown.",
    "several": "It may have landed at several places or times.",
}


@dataclass(frozen=True, slots=True)
class LandingWords:
    """A call of a landing in words."""

    question: str
    verdict: str
    """`in`, `out` or `cannot be decided`."""
    probability: str
    sentence: str
    """The whole answer."""
    margin: str
    """How far from the line; empty without a landing."""
    advice: str
    """Why the clip does not decide, and what would; empty where it does."""


def format_rally_event(event: RallyEvent, name: str) -> str:
    """Format an event of the object `name` as a sentence without a full stop."""
    who = f" by the {event.player} player" if event.player else ""
    words = {"hit": " and leaves at {}", "bounce": ", arriving at {}", "landing": ", arriving at {}"}.get(
        event.kind, ""
    )
    shown = words.format(format_flight_speed(event.speed, event.speed_sigma)) if math.isfinite(event.speed) else ""
    return f"The {name} {EVENT_WORDS[event.kind]}{who}{shown}"


def list_event_rows(rally: Rally) -> list[tuple[str, str, str]]:
    """List time, words and probability of all events."""
    name = rally.scene.sport.object.name
    return [
        (format_time(one.t, one.t_sigma), format_rally_event(one, name), format_probability(one.probability))
        for one in rally.events
    ]


def assess_rally_trust(rally: Rally) -> Trust:
    """Assess the trust level of a rally, with its reasons."""
    name, share = rally.scene.sport.object.name, find_explained_share(rally)
    is_seen = np.isfinite(rally.px[:, 0])
    if share == 0:
        return Trust("red", (f"No flight of the {name} is explained.",))
    used = float(np.mean(rally.is_used[is_seen])) if is_seen.any() else 0.0
    reasons = [f"Gravity and air explain {100 * share:.0f} % of the time in flight."]
    level: TrustLevel = "green" if share >= GREEN_SHARE else "amber" if share >= AMBER_SHARE else "red"
    doubts = []
    if used < GREEN_SHARE:
        doubts.append(f"{100 * (1 - used):.0f} % of the places where the {name} was detected fit no flight.")
    if rally.scene.line_error > MAX_LINE_ERROR_PX:
        doubts.append(f"The painted lines lie {rally.scene.line_error:.1f} px from where the camera puts them.")
    undecided = [one for one in rally.events if is_undecided(one.probability)]
    if undecided:
        first = min(undecided, key=lambda one: abs(one.probability - 0.5))
        more = f", and {len(undecided) - 1} more" if len(undecided) > 1 else ""
        words = f"{format_rally_event(first, name)} at {format_time(first.t, first.t_sigma)}"
        doubts.append(f"Undecided: {words} ({format_probability(first.probability)}){more}.")
    doubts += [f"{start_sentence(one)}." for one in format_rally_notes(rally)]
    if doubts and level == "green":
        level = "amber"
    return Trust(level, (*reasons, *doubts))


def format_rally_notes(rally: Rally) -> list[str]:
    """Format the notes of a rally and of its court, without full stops."""
    codes = dict.fromkeys([*rally.scene.notes, *rally.notes])
    return [NOTE_WORDS.get(code, re.sub("[-_]", " ", code)) for code in codes if code != HARMLESS_NOTE]


def format_landing(call: LandingCall, rally: Rally) -> LandingWords:
    """Format a call of a landing."""
    name = rally.scene.sport.object.name
    where = AREA_WORDS.get(call.area, f"the {call.area} court")
    question = f"Did the {name} land in {where}?"
    decided = call.verdict != "undecided"
    verdict = call.verdict if decided else "cannot be decided"
    likely = "in" if call.probability >= call.out_probability else "out"
    probability = format_probability(max(call.probability, call.out_probability))
    shown = probability if decided else f"{likely}: {probability}"
    head = f"{start_sentence(verdict)} ({shown})"
    if call.landing is None:
        text = f"{start_sentence(verdict)}: no landing of the {name} is known."
        return LandingWords(question, verdict, "", text, "", _format_advice(call, name))
    margin = format_margin(call)
    would = "began to roll" if call.landing.is_rolling else "landed" if call.landing.is_seen else "would have landed"
    when = format_time(call.landing.t, call.landing.t_sigma)
    speed = f", at {format_flight_speed(call.speed, call.speed_sigma)}" if math.isfinite(call.speed) else ""
    text = f"{head}: at {when} the {name} {would} {margin}{speed}."
    if call.rival is not None:
        text += f" The probability depends more on another distance: {format_line_distance(call.rival)}."
    return LandingWords(question, verdict, shown, text, margin, _format_advice(call, name))


def describe_landing_call(call: LandingCall, rally: Rally) -> dict[str, Any]:
    """Describe a call of a landing as JSON values, with its words."""
    words, landing = format_landing(call, rally), call.landing
    return {
        "area": call.area, "code": call.verdict, "verdict": words.verdict,
        "probability_in": call.probability, "probability_out": call.out_probability, "half": call.half or None,
        "rectangles": [list(one) for one in call.rectangles],
        "line": call.line or None, "distance": call.distance, "distance_sigma": call.distance_sigma,
        "rival": None if call.rival is None else asdict(call.rival),
        "speed": call.speed, "speed_sigma": call.speed_sigma,
        "place": None if landing is None else landing.place,
        "covariance": None if landing is None else landing.covariance,
        "t": None if landing is None else landing.t, "t_sigma": None if landing is None else landing.t_sigma,
        "is_seen": None if landing is None else landing.is_seen,
        "is_rolling": None if landing is None else landing.is_rolling,
        "frames": list(call.frames) if call.frames[0] >= 0 else None, "reason": call.reason,
        "sentence": words.sentence, "advice": words.advice or None,
    }  # fmt: skip


def _format_advice(call: LandingCall, name: str) -> str:
    """Format why a clip does not decide, and what would; empty where it does."""
    if call.reason is None:
        return ""
    text = REASON_WORDS[call.reason]
    if call.frames[0] < 0 or call.reason not in ("close", "no_landing", "several"):
        return text
    first, last = call.frames
    where = f"frame {first}" if first == last else f"frames {first} to {last}"
    return f"{text} Sharp frames, or more of them, around {where} would decide, with the {name} in view."


def format_crossing(crossing: NetCrossing, name: str) -> str:
    """Format how high the object `name` passed the net, as a sentence."""
    what = "touched the net" if crossing.is_touch else "passed the net"
    return f"The {name} {what} {format_height_over_net(crossing)} at {crossing.t:.2f} s."


def format_height_over_net(crossing: NetCrossing) -> str:
    """Format how high a crossing is; what passed the net was not below its edge, wherever an error puts it."""
    height = format_distance(crossing.height, crossing.height_sigma)
    if not crossing.is_touch and -SIDE_SIGMAS * crossing.height_sigma < crossing.height < 0:
        return f"close over its edge (measured: {height} below)"
    return f"{height} {'over' if crossing.height >= 0 else 'below'} its edge"
