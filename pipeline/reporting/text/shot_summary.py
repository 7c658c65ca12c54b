"""Summary of a stroke in sentences: first contact, time, speeds, later motion, confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.core.events import Events
from models.core.fit_result import Fit
from models.core.naming import join_names
from models.core.number_format import EXTREME_PROBABILITY, format_probability
from models.core.shot_explanation import RackBreak
from models.core.shot_numbers import ShotNumber, ShotNumbers
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.contact_test.call_answers import CallAnswer
from models.estimation.contact_test.candidate_contacts import SAME_MOMENT_TIME
from pipeline.reporting.text.number_sentences import format_number
from pipeline.reporting.text.text_formatting import format_event, format_event_time, start_sentence

CONTACT_MARGIN = 1e-3
"""s, added to twice the standard deviation of a contact time: where the velocities before and after are sampled."""
SETTLING_TIME = 0.4
"""s after a contact by which most balls roll again, so that their direction is visible."""
REST_SPEED = 0.03
"""m/s below which a ball is described as at rest."""
MAX_STRAIGHT_ANGLE, MIN_RETURN_ANGLE = 25.0, 140.0
"""Degrees: a ball that turns by less continues in its direction, one that turns by more comes back."""
MIN_PROBABILITY = 0.5
"""Probability from which an event is mentioned."""
LOST_FRAMES = 2.0
"""Frames without a detection after which a ball is lost."""
CUE_KINDS = ("cue", "white", "yellow")
STROKE_NOT_VISIBLE = "The clip shows no stroke; the motion before it is unknown."
MAX_LATER_CONTACTS = 6
"""Later contacts of the ball that are listed one by one; balls take precedence over cushions."""
NO_ANSWER = "-"
"""Text of an answer that does not exist."""


@dataclass(frozen=True, slots=True)
class ShotSummary:
    """Summary of one stroke; each field is one or two sentences."""

    start: float
    """Time of the stroke, s."""
    first: str
    when: str
    speed: str
    after: str
    confidence: str
    potted: str = ""
    """Potted balls and their pockets; empty if there are none."""
    spread: str = ""
    """How a rack burst; empty if none did."""


def summarize_shots(
    tracks: Tracks, fit: Fit, scale_doubts: Sequence[str] = (), calls: Sequence[CallAnswer] = ()
) -> list[ShotSummary]:
    """Summarize every stroke of a clip.

    Args:
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        scale_doubts: Sentences on the possible error of all lengths; appended to the speeds.
        calls: Answers on which ball a ball touched first; a summary states their probability.

    Returns:
        One summary per stroke; if the clip begins after the stroke, one for the ball that moves first.
    """
    events = _state_first_contacts(fit.events, calls)
    fit = replace(fit, events=events)
    likely = [k for k in range(len(events)) if events.probability[k] >= MIN_PROBABILITY]
    strikes = [k for k in likely if events.kind[k] == "strike" and events.a[k] in fit.trajectory.ids]
    if strikes:
        ends = [*(float(events.t[k]) for k in strikes[1:]), np.inf]
        summaries = [
            (_summarize_stroke(fit, tracks, events.a[k], float(events.t[k]), end, likely, k), end)
            for k, end in zip(strikes, ends, strict=True)
        ]
    else:
        first_ball = _find_first_mover(tracks, fit, likely)
        first = float(tracks.t[0])
        summaries = (
            []
            if first_ball is None
            else [(_summarize_stroke(fit, tracks, first_ball, first, np.inf, likely, None), np.inf)]
        )
    return [
        replace(
            summary,
            potted=_format_potted(fit, likely, summary.start, end),
            spread=" ".join(
                _format_break(one, tracks, fit, likely)
                for one in fit.explanation.breaks
                if summary.start <= one.t < end
            ),
            speed=" ".join([summary.speed, *(scale_doubts if summary.speed != NO_ANSWER else ())]),
        )
        for summary, end in summaries
    ]


def _state_first_contacts(events: Events, calls: Sequence[CallAnswer]) -> Events:
    """Give each first contact the probability that its call states: the same ball may be touched again later."""
    probability = events.probability.copy()
    for call in calls:
        pairs = [{a, b} == {*call.subject, call.met} for a, b in zip(events.a, events.b, strict=True)]
        is_same = np.array(pairs, bool) & (np.abs(events.t - call.t) < SAME_MOMENT_TIME)
        probability[is_same & (call.kind == "first")] = call.probability
    return replace(events, probability=probability)


def _format_potted(fit: Fit, likely: list[int], start: float, end: float) -> str:
    """Format the balls potted between `start` and `end` (s)."""
    events, naming = fit.events, fit.naming
    potted = [k for k in likely if events.kind[k] == "pocket" and start <= events.t[k] < end]
    text = join_names(
        f"{naming.say(events.a[k])} into the {naming.name_pocket(events.b[k])} at {format_event_time(events, k)}"
        for k in potted
    )
    return start_sentence(f"{text}.") if text else ""


def _format_break(rack: RackBreak, tracks: Tracks, fit: Fit, likely: list[int]) -> str:
    """Format how a rack burst: balls that left it, reached a cushion or were potted, and what frames do not show."""
    events, naming = fit.events, fit.naming
    later = [k for k in likely if events.t[k] >= rack.t]
    left = fit.moving[tracks.t > rack.t].any(axis=0)
    count = len(rack.rack)
    moved = sum(bool(left[tracks.ids.index(ball)]) for ball in rack.rack)
    to_rail = {events.a[k] for k in later if events.kind[k] == "cushion"} & {*rack.rack}
    potted = {events.a[k] for k in later if events.kind[k] == "pocket"} & {*rack.rack}
    text = f"{naming.say(rack.ball)} broke a cluster of {count} balls: {moved} of them moved, "
    text += f"{len(to_rail)} reached a {naming.rail_word}"
    text += f" and {len(potted) or 'none'} {'was' if len(potted) < 2 else 'were'} potted."
    if rack.end > rack.t:
        text += f" Which of them touched each other until {rack.end:.2f} s is beyond what the film can show."
    return start_sentence(text)


def _find_first_mover(tracks: Tracks, fit: Fit, likely: list[int]) -> str | None:
    """Return the incoming ball of the first contact: the faster one, or one whose velocity is unknown.

    Without a contact, return the ball that moves first; among several, a cue ball takes precedence.
    """
    events, ids = fit.events, fit.trajectory.ids
    for k in likely:
        if events.kind[k] == "ball" and {events.a[k], events.b[k]} <= set(ids):
            pair = [events.a[k], events.b[k]]
            v = fit.trajectory.at(float(events.t[k] + _contact_margins(events, k)[0])).v
            speed = [float(np.nan_to_num(np.linalg.norm(v[ids.index(ball)]), nan=np.inf)) for ball in pair]
            return pair[int(np.argmax(speed))]
    moving = np.flatnonzero(fit.moving.any(axis=0))
    started = [int(np.argmax(fit.moving[:, k])) for k in moving]
    first = [int(k) for k, row in zip(moving, started, strict=True) if row == min(started)]
    cue = [k for k in first if tracks.kinds[k] in CUE_KINDS]
    return tracks.ids[(cue or first)[0]] if first else None


def _summarize_stroke(
    fit: Fit, tracks: Tracks, ball: str, start: float, end: float, likely: list[int], strike: int | None
) -> ShotSummary:
    """Summarize the motion of `ball` from its stroke, event `strike`, at `start` to `end` (s)."""
    events, name = fit.events, start_sentence(fit.naming.say(ball))
    own = [k for k in likely if start <= events.t[k] < end and ball in (events.a[k], events.b[k]) and k != strike]
    touch = next((k for k in own if events.kind[k] == "ball"), None)
    struck = (
        f" {STROKE_NOT_VISIBLE}"
        if strike is None
        else f" It was struck at {format_event_time(events, strike)}{_format_stroke_departure(events, strike)}."
    )
    if touch is None:
        then = _format_later_contacts(fit, tracks, ball, own, start, end)
        when = NO_ANSWER if strike is None else f"{format_event_time(events, strike)} (the stroke)"
        first = f"{name} touched no other ball.{struck}"
        return ShotSummary(
            start, first, when, _format_stroke_speed(events, strike), then, _format_confidence(fit, own, strike)
        )
    t = float(events.t[touch])
    other = events.b[touch] if events.a[touch] == ball else events.a[touch]
    then = _format_later_contacts(fit, tracks, ball, [k for k in own if events.t[k] > t], t, end)
    return ShotSummary(
        start,
        f"{name} hit {fit.naming.say(other)} first{_format_cushions_before(fit, own, t)}.{struck}",
        f"{format_event_time(events, touch)} (frame {events.frame[touch]:.2f}){_format_delay(events, strike, t)}",
        _format_speeds(fit, ball, other, touch, _find_numbers(fit, ball, other, start)),
        f"{_format_direction_after(fit, ball, touch, own, end)} {then}",
        _format_confidence(fit, own, touch),
    )


def _format_cushions_before(fit: Fit, own: list[int], t: float) -> str:
    """Format the cushions that the ball touched before t (s); empty if there are none."""
    events = fit.events
    cushions = [fit.naming.say(events.b[k]) for k in own if events.kind[k] == "cushion" and events.t[k] < t]
    return f", after {join_names(cushions)}" if cushions else ""


def _format_delay(events: Events, strike: int | None, t: float) -> str:
    """Format the time (s) from the stroke to t; empty without a stroke."""
    return "" if strike is None else f", {t - events.t[strike]:.3f} s after the stroke"


def _format_stroke_departure(events: Events, k: int) -> str:
    """Format the speed after a stroke as a clause; empty if it is unknown."""
    return f" and left at {events.speed[k]:.2f} m/s" if np.isfinite(events.speed[k]) else ""


def _format_stroke_speed(events: Events, k: int | None) -> str:
    """Format the speed after a stroke as an answer."""
    if k is None or not np.isfinite(events.speed[k]):
        return NO_ANSWER
    return f"{events.speed[k]:.2f} m/s after the stroke."


def _find_numbers(fit: Fit, ball: str, other: str, start: float) -> ShotNumbers | None:
    """Find the numbers of the stroke of `ball` at `start` (s) that hits `other` first; None if there are none."""
    own = [shot for shot in fit.shot_numbers if (shot.cue, shot.first) == (ball, other)]
    return min(own, key=lambda shot: abs(shot.t - start), default=None)


def _format_speed(numbers: ShotNumbers | None, name: str, speed: float, sigma: float) -> str:
    """Format a speed (m/s) as the table of numbers states it; by `speed` and `sigma` where it does not."""
    one = None if numbers is None else numbers.find_number(name)
    return format_number(one if one is not None and one.observable else ShotNumber(name, speed, sigma, "m/s", True))


def _format_speeds(fit: Fit, ball: str, other: str, touch: int, numbers: ShotNumbers | None) -> str:
    """Format the closing speed of a contact, the speed of the ball before it and of the other ball after it."""
    events, ids = fit.events, fit.trajectory.ids
    before, after = (fit.trajectory.at(float(t)) for t in events.t[touch] + _contact_margins(events, touch))
    is_explained = not before.measured[ids.index(ball)]
    speed_before = float(np.linalg.norm(before.v[ids.index(ball)])) if is_explained else float("nan")
    sigma = float(before.sigma_v[ids.index(ball)])
    speed_after = float(np.linalg.norm(after.v[ids.index(other)])) if other in ids else float("nan")
    parts, (came, went) = list[str](), map(fit.naming.say, (ball, other))
    if np.isfinite(events.speed[touch]):
        parts.append(f"The closing speed along the line of centres was {events.speed[touch]:.2f} m/s")
    if np.isfinite(speed_before):
        parts.append(f"{came} arrived at {_format_speed(numbers, 'contact_speed', speed_before, sigma)}")
    elif parts:
        parts.append(f"the speed of {came} before the contact was not observed")
    if np.isfinite(speed_after):
        sigma_after = float(after.sigma_v[ids.index(other)])
        parts.append(f"{went} left at {_format_speed(numbers, 'object_speed', speed_after, sigma_after)}")
    return start_sentence("; ".join(parts)) + "." if parts else "unknown"


def _contact_margins(events: Events, k: int) -> FloatArray:
    """Return offsets (2,) s from the time of event k at which it is certainly still to come, and certainly over."""
    return np.asarray(np.array([-1.0, 1.0]) * (CONTACT_MARGIN + 2 * events.t_sigma[k]), np.float64)


def _format_direction_after(fit: Fit, ball: str, touch: int, own: list[int], end: float) -> str:
    """Format the direction of the ball once it rolls again, or just before its next contact."""
    events, ids = fit.events, fit.trajectory.ids
    t, k, name = float(events.t[touch]), ids.index(ball), start_sentence(fit.naming.say(ball))
    ahead = [float(events.t[j] + _contact_margins(events, j)[0]) for j in own if events.t[j] > t + CONTACT_MARGIN]
    before_and_after = t + _contact_margins(events, touch)
    sample_time = max(
        min(t + SETTLING_TIME, *(ahead[:1] or [np.inf]), end - CONTACT_MARGIN), float(before_and_after[1])
    )
    velocities = fit.trajectory.at(np.append(before_and_after, sample_time)).v[:, k]
    before, later = velocities[0], velocities[2]
    speeds = np.linalg.norm(velocities, axis=1)
    if not np.isfinite(speeds[2]):
        return f"The direction of {fit.naming.say(ball)} after the contact is unknown."
    if not speeds[0] > REST_SPEED:
        return (
            f"{name} moved at {speeds[2]:.2f} m/s {sample_time - t:.2f} s later;"
            " its direction before the contact was not observed."
        )
    if speeds[2] < REST_SPEED:
        return f"{name} stopped at the place of contact ({speeds[2]:.2f} m/s {sample_time - t:.2f} s later)."
    slow = f"almost stopped ({speeds[1]:.2f} m/s), then " if speeds[1] < 0.5 * speeds[2] else ""
    return f"{name} {slow}{_format_turn(before, later)}, at {speeds[2]:.2f} m/s {sample_time - t:.2f} s later."


def _format_turn(before: FloatArray, later: FloatArray) -> str:
    """Format the change of direction between two velocities (2,)."""
    angle = _turn_angle(before, later)
    side = "right" if angle > 0 else "left"  # y runs down: a positive angle turns clockwise as seen from above
    if abs(angle) < MAX_STRAIGHT_ANGLE:
        return f"continued in its direction ({abs(angle):.0f}° to the {side})"
    if abs(angle) > MIN_RETURN_ANGLE:
        return "came back"
    return f"turned {abs(angle):.0f}° to the {side}"


def _turn_angle(before: FloatArray, later: FloatArray) -> float:
    """Compute the angle between two velocities (2,) in degrees; positive is clockwise as seen from above."""
    cross = before[0] * later[1] - before[1] * later[0]
    return float(np.degrees(np.arctan2(cross, before @ later)))


def _format_later_contacts(fit: Fit, tracks: Tracks, ball: str, later: list[int], start: float, end: float) -> str:
    """Format the later contacts of the ball and its final state."""
    events = fit.events
    contacts = [k for k in later if events.kind[k] in ("ball", "cushion")]
    selected = _select_later_contacts(events, contacts)
    more = f" and {len(contacts) - len(selected)} more" if len(contacts) > len(selected) else ""
    words = [f"{_contact_partner(fit, k, ball)} at {events.t[k]:.3f} s" for k in selected]
    none = "It had no further contact. " if start > 0 else ""
    then = f"Then it touched {join_names(words)}{more}. " if words else none
    for k in later:
        if events.kind[k] == "pocket":
            return then + f"It fell into the {fit.naming.name_pocket(events.b[k])} at {format_event_time(events, k)}."
    return then + _format_final_state(fit, tracks, ball, min(end, float(tracks.t[-1])), later)


def _select_later_contacts(events: Events, contacts: list[int]) -> list[int]:
    """Select the contacts to list, ordered by time: balls first, because they decide a stroke, then early cushions."""
    selected = sorted(contacts, key=lambda k: (events.kind[k] != "ball", events.t[k]))[:MAX_LATER_CONTACTS]
    return sorted(selected, key=lambda k: float(events.t[k]))


def _format_final_state(fit: Fit, tracks: Tracks, ball: str, t: float, later: list[int]) -> str:
    """Format the state of the ball at t (s), or its rest before it."""
    events = fit.events
    k = fit.trajectory.ids.index(ball)
    last = float(tracks.t[tracks.is_observed[:, tracks.ids.index(ball)]].max(initial=-np.inf))
    is_seen = t - last < LOST_FRAMES * float(np.median(np.diff(tracks.t)))
    t = t if is_seen else last
    state = fit.trajectory.at(t - CONTACT_MARGIN)
    if not np.isfinite(state.xy[k]).all():
        return "Its final state is unknown."
    place = f"({state.xy[k, 0]:.3f}, {state.xy[k, 1]:.3f}) m"
    speed = float(np.linalg.norm(state.v[k]))
    rests = [j for j in later if events.kind[j] == "rest"]
    if rests:
        return f"It came to rest at {events.t[rests[-1]]:.2f} s at {place}."
    if speed < REST_SPEED:
        return f"At {t:.2f} s it was at rest at {place}."
    when = f"It was last seen at {t:.2f} s, when it moved"
    if is_seen:
        event = "the next stroke follows" if t < tracks.t[-1] else "the clip ends"
        when = f"When {event}, at {t:.2f} s, it still moves"
    return f"{when} at {speed:.2f} m/s at {place}."


def _contact_partner(fit: Fit, k: int, ball: str) -> str:
    """Return the name of what `ball` touched in event k."""
    a, b = fit.events.a[k], fit.events.b[k]
    return fit.naming.say(b if a == ball else a)


def _format_confidence(fit: Fit, own: list[int], main: int | None) -> str:
    """Format the probability of the main event and of the others, and the trust level of the clip."""
    events = fit.events
    parts = []
    if main is not None:
        what = "first contact" if events.kind[main] == "ball" else "stroke"
        parts.append(f"The {what} has a probability of {format_probability(float(events.probability[main]))}")
    others = [k for k in own if k != main]
    worst = min(others, key=lambda k: events.probability[k], default=None)
    if worst is not None and events.probability[worst] > 1 - EXTREME_PROBABILITY:
        parts.append("every other contact of this ball has a probability above 99.9 %")
    elif worst is not None:
        parts.append(
            "the least certain other contact of this ball has a probability of"
            f" {format_probability(float(events.probability[worst]))} ({format_event(events, worst, fit.naming)})"
        )
    parts.append(f"the trust level of the clip is {fit.trust.level}")
    return start_sentence("; ".join(parts) + ".")
