"""Summary of a stroke in sentences: first contact, time, speeds, later motion, confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.core.events import Events
from models.core.fit_result import Fit, RackBreak, ShotNumber, ShotNumbers
from models.core.naming import join_names
from models.core.number_format import format_moment, format_probability, format_speed
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.contact_test.call_answers import CallAnswer
from models.estimation.contact_test.shot_record import SAME_MOMENT_TIME
from models.estimation.segmentation.contact_classification import CUE_KINDS
from pipeline.reporting.text.call_sentences import format_score
from pipeline.reporting.text.check_sentences import format_event_probability, format_least_sure
from pipeline.reporting.text.number_sentences import NOT_OBSERVABLE, format_hit, format_number
from pipeline.reporting.text.prediction_sentences import format_place
from pipeline.reporting.text.text_formatting import format_event_time, is_repeated, start_sentence

# s, added to twice the standard deviation of a contact time: where the velocities before and after are sampled.
CONTACT_MARGIN = 1e-3
# s after a contact by which most balls roll again, so that their direction is visible.
SETTLING_TIME = 0.4
# m/s below which a ball is described as at rest.
REST_SPEED = 0.03
# Degrees: a ball that turns by less continues in its direction, one that turns by more comes back.
MAX_STRAIGHT_ANGLE, MIN_RETURN_ANGLE = 25.0, 140.0
# Probability from which an event is mentioned.
MIN_PROBABILITY = 0.5
# Frames without a detection after which a ball is lost.
LOST_FRAMES = 2.0
STROKE_NOT_VISIBLE = "The clip shows no stroke; the motion before it is unknown."
MOVING = "still moving"
# Later contacts of the ball that are listed one by one.
MAX_LATER_CONTACTS = 8
# Text of an answer that does not exist.
NO_ANSWER = "-"


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
    ends: tuple[str, ...] = ()
    """What still moves at the end, then one line per ball that moved: where it ended."""
    score: str = ""
    """Whether it was a point, and why; empty where the game has none."""


def summarize_shots(
    tracks: Tracks, fit: Fit, table: Table, scale_doubts: Sequence[str] = (), calls: Sequence[CallAnswer] = ()
) -> list[ShotSummary]:
    """Summarize every stroke of a clip.

    Args:
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        table: The table, for places on it.
        scale_doubts: Sentences on the possible error of all lengths; appended to the speeds.
        calls: Answers on which ball a ball touched first; a summary states their probability.

    Returns:
        One summary per stroke; if the clip begins after the stroke, one for the ball that moves first.
    """
    likely = [k for k in range(len(fit.events)) if fit.events.probability[k] >= MIN_PROBABILITY]
    events = fit.events
    strikes = [k for k in likely if events.kind[k] == "strike" and events.a[k] in fit.trajectory.ids]
    starts: list[tuple[str, float, int | None]] = [(events.a[k], float(events.t[k]), k) for k in strikes]
    if not strikes and (first_ball := _find_first_mover(tracks, fit, calls)) is not None:
        starts = [(first_ball, float(tracks.t[0]), None)]
    ends = [*(start for _, start, _ in starts[1:]), np.inf][: len(starts)]
    summaries = []
    for (ball, start, strike), end in zip(starts, ends, strict=True):
        own = [k for k in likely if start <= events.t[k] < end and k != strike]
        stroke = _Stroke(tracks, fit, table, ball, start, end, strike, own, calls)
        summary = stroke.summarize()
        speed = " ".join([summary.speed, *(scale_doubts if "m/s" in summary.speed else ())])
        spread = " ".join(stroke.format_break(one) for one in fit.explanation.breaks if start <= one.t < end)
        points = (
            format_score(one, fit.naming, stroke.is_moving(ball))
            for one in calls if one.kind == "score" and one.subject[0] == ball
        )  # fmt: skip
        summaries.append(
            replace(summary, speed=speed, potted=stroke.format_potted(), spread=spread, ends=stroke.list_ends(),
                    score=next(points, ""))
        )  # fmt: skip
    return summaries


def _find_first_mover(tracks: Tracks, fit: Fit, calls: Sequence[CallAnswer]) -> str | None:
    """Return the ball whose first contact was asked for; else the one that moves first, among several a cue ball."""
    moving = np.flatnonzero(fit.moving.any(axis=0))
    started = [(int(np.argmax(fit.moving[:, k])), tracks.kinds[k] not in CUE_KINDS, int(k)) for k in moving]
    firsts = (one.subject[0] for one in calls if one.kind == "first")
    return next(firsts, tracks.ids[min(started)[2]] if started else None)


def _contact_margins(events: Events, k: int) -> FloatArray:
    """Return offsets (2,) s from the time of event k at which it is certainly still to come, and certainly over."""
    return np.asarray(np.array([-1.0, 1.0]) * (CONTACT_MARGIN + 2 * events.t_sigma[k]), np.float64)


@dataclass(frozen=True, slots=True)
class _Stroke:
    """The motion from one stroke to the next."""

    tracks: Tracks
    fit: Fit
    table: Table
    ball: str
    """The struck ball, or the one that moves first."""
    start: float
    end: float
    """s; infinite for the last stroke."""
    strike: int | None
    """Its event; None where the clip begins later."""
    likely: list[int]
    """The other events of this time that are mentioned."""
    calls: Sequence[CallAnswer]
    """The same ball may be touched again later, so that which ball was first may be surer than a touch."""

    @property
    def name(self) -> str:
        """Name of the ball at the beginning of a sentence."""
        return start_sentence(self.fit.naming.say(self.ball))

    @property
    def own(self) -> list[int]:
        """Events of the ball after the stroke."""
        return [k for k in self.likely if self.ball in (self.fit.events.a[k], self.fit.events.b[k])]

    @property
    def numbers(self) -> ShotNumbers | None:
        """Numbers of the stroke; None where it has none."""
        played = [shot for shot in self.fit.shot_numbers if shot.cue == self.ball]
        return min(played, key=lambda shot: abs(shot.t - self.start), default=None)

    def summarize(self) -> ShotSummary:
        """Summarize the stroke, without the potted balls."""
        events, naming, strike = self.fit.events, self.fit.naming, self.strike
        touch = next((k for k in self.own if events.kind[k] == "ball"), None)
        left, struck = "", STROKE_NOT_VISIBLE
        if strike is not None:
            left = format_speed(events.speed[strike]) if np.isfinite(events.speed[strike]) else ""
            struck = f"{self.name} was struck at {format_event_time(events, strike)}{left and f' and left at {left}'}."
        elif ("strike", self.ball) in (strokes := list(zip(events.kind, events.a, strict=True))):
            k = strokes.index(("strike", self.ball))
            chance = format_event_probability(events, k, self.fit.explanation, naming)
            struck = f"{self.name} was perhaps struck at {format_event_time(events, k)} ({chance})."
        if touch is None:
            return ShotSummary(
                self.start, f"{self.name} touched no other ball. {struck}",
                NO_ANSWER if strike is None else f"{format_event_time(events, strike)} (the stroke)",
                f"{left} after the stroke." if left else NO_ANSWER,
                self._format_later_contacts(self.start), self._format_confidence(strike),
            )  # fmt: skip
        t, other = float(events.t[touch]), self._find_partner(touch)
        numbers = self.numbers if self.numbers is not None and self.numbers.first == other else None
        hit = "" if numbers is None else format_hit(numbers)
        cushions = [naming.say(events.b[k]) for k in self.own if events.kind[k] == "cushion" and events.t[k] < t]
        before = f", after {join_names(cushions)}" if cushions else ""
        delay = "" if strike is None else f", {t - events.t[strike]:.3f} s after the stroke"
        return ShotSummary(
            self.start, f"{self.name} hit {naming.say(other)} first{before}{hit and f': {hit}'}. {struck}",
            f"{format_event_time(events, touch)} (frame {events.frame[touch]:.1f}){delay}",
            self._format_speeds(touch, numbers),
            f"{self._format_direction_after(touch)} {self._format_later_contacts(t)}", self._format_confidence(touch),
        )  # fmt: skip

    def format_potted(self) -> str:
        """Format the potted balls; empty for a table without pockets."""
        events, naming = self.fit.events, self.fit.naming
        text = join_names(
            f"{naming.say(events.a[k])} into the {naming.name_pocket(events.b[k])} at {format_event_time(events, k)}"
            f" ({format_event_probability(events, k, self.fit.explanation, naming)})"
            for k in self.likely
            if events.kind[k] == "pocket"
        )
        return start_sentence(f"{text}.") if text else "No ball." if self.table.pockets else ""

    def format_break(self, rack: RackBreak) -> str:
        """Format how a rack burst: balls that moved, reached a cushion or were potted, and what frames do not show."""
        events, naming = self.fit.events, self.fit.naming
        of_rack = [k for k in self.likely if events.t[k] >= rack.t and events.a[k] in rack.rack]
        moving = self.fit.moving[self.tracks.t > rack.t]
        moved = sum(bool(moving[:, self.tracks.ids.index(ball)].any()) for ball in rack.rack)
        kinds = ("cushion", "pocket")
        to_rail, potted = (len({events.a[k] for k in of_rack if events.kind[k] == kind}) for kind in kinds)
        text = (
            f"{start_sentence(naming.say(rack.ball))} broke a cluster of {len(rack.rack)} balls: {moved} of them moved,"
            f" {to_rail} reached a {naming.rail_word} and {potted or 'none'} {'was' if potted < 2 else 'were'} potted."
        )
        if rack.end > rack.t:
            until = format_moment(rack.end)
            text += f" Which of them touched each other until {until} is beyond what the film can show."
        return text

    def _find_partner(self, k: int) -> str:
        """Return what the ball touched in event k."""
        a, b = self.fit.events.a[k], self.fit.events.b[k]
        return b if a == self.ball else a

    def _format_speeds(self, touch: int, numbers: ShotNumbers | None) -> str:
        """Format the speed of the ball before a contact and of the other ball after it, as the numbers state them."""
        ids, other = self.fit.trajectory.ids, self._find_partner(touch)
        times = self.fit.events.t[touch] + _contact_margins(self.fit.events, touch)
        texts = []
        for ball, t, name in ((self.ball, times[0], "contact_speed"), (other, times[1], "object_speed")):
            state, k = self.fit.trajectory.at(float(t)), ids.index(ball) if ball in ids else None
            is_known = k is not None and not (name == "contact_speed" and state.measured[k])
            speed = float(np.linalg.norm(state.v[k])) if is_known else float("nan")
            fitted = ShotNumber(
                name, speed, 0.0 if k is None else float(state.sigma_v[k]), "m/s", bool(np.isfinite(speed))
            )
            stated = None if numbers is None else numbers.find_number(name)
            texts.append(format_number(stated if stated is not None and fitted.observable else fitted))
        came, went = ("" if text == NOT_OBSERVABLE else text for text in texts)
        if not (came or went):
            return start_sentence(f"{NOT_OBSERVABLE}.")
        name, after = self.fit.naming.say(self.ball), f"; {self.fit.naming.say(other)} left at {went}" if went else ""
        before = f"{name} arrived at {came}" if came else f"the speed of {name} before the contact is {NOT_OBSERVABLE}"
        return start_sentence(f"{before}{after}.")

    def _format_direction_after(self, touch: int) -> str:
        """Format the direction of the ball once it rolls again, or just before its next contact."""
        events, t, k = self.fit.events, float(self.fit.events.t[touch]), self.fit.trajectory.ids.index(self.ball)
        ahead = [
            float(events.t[j] + _contact_margins(events, j)[0]) for j in self.own if events.t[j] > t + CONTACT_MARGIN
        ]
        around = t + _contact_margins(events, touch)
        sample_time = max(min(t + SETTLING_TIME, *(ahead[:1] or [np.inf]), self.end - CONTACT_MARGIN), float(around[1]))
        velocities = self.fit.trajectory.at(np.append(around, sample_time)).v[:, k]
        speeds = np.linalg.norm(velocities, axis=1)
        if not np.isfinite(speeds[2]):
            return f"The direction of {self.fit.naming.say(self.ball)} after the contact is unknown."
        speed = f"at {format_speed(speeds[2])} {sample_time - t:.2f} s later"
        if not speeds[0] > REST_SPEED:
            return f"{self.name} moved {speed}; its direction before the contact was not observed."
        if speeds[2] < REST_SPEED:
            return f"{self.name} stopped at the place of contact."
        slow = "almost stopped, then " if speeds[1] < 0.5 * speeds[2] else ""
        return f"{self.name} {slow}{_format_turn(velocities[0], velocities[2])}, {speed}."

    def _format_later_contacts(self, t: float) -> str:
        """Format the first contacts of the ball after t (s), in order of time."""
        events = self.fit.events
        later = [k for k in self.own if events.t[k] > t]
        contacts = [k for k in later if events.kind[k] in ("ball", "cushion")]
        more = f", then {len(contacts) - MAX_LATER_CONTACTS} more" if len(contacts) > MAX_LATER_CONTACTS else ""
        words = [
            f"{self.fit.naming.say(self._find_partner(k))}{' again' * is_repeated(events, k)}"
            f" at {format_event_time(events, k)}"
            for k in contacts[:MAX_LATER_CONTACTS]
        ]
        none = "It had no further contact." if t > self.start else NO_ANSWER
        return f"Then it touched {join_names(words)}{more}." if words else none

    def list_ends(self) -> tuple[str, ...]:
        """List what still moves at the end of the stroke, then where each ball ended that moved."""
        events, naming = self.fit.events, self.fit.naming
        during = (self.tracks.t >= self.start) & (self.tracks.t < self.end)
        active = {body for k in self.likely for body in (events.a[k], events.b[k])} | {self.ball}
        balls = [ball for k, ball in enumerate(self.tracks.ids) if ball in active or self.fit.moving[during, k].any()]
        ends = {ball: self._format_end(ball) for ball in balls}
        moving = [naming.say(ball) for ball in balls if self.is_moving(ball)]
        t = min(self.end, float(self.tracks.t[-1]))
        moment = f"the {'next stroke begins' if t < self.tracks.t[-1] else 'clip ends'}, at {format_moment(t)}"
        still = f"{join_names(moving) or 'no ball'} still move{'s' * (len(moving) < 2)} when {moment}."
        lines = [start_sentence(still), *(f"{start_sentence(naming.name_ball(ball))}: {ends[ball]}." for ball in balls)]
        others = join_names(naming.say(ball) for ball in self.tracks.ids if ball not in balls)
        return *lines, *([start_sentence(f"{others} did not move.")] if others else [])

    def is_moving(self, ball: str) -> bool:
        """Return whether a ball still moves at the end."""
        return MOVING in self._format_end(ball)

    def _format_end(self, ball: str) -> str:
        """Format where a ball ended, in which state, and its way: length and cushions."""
        events, naming, k, times = self.fit.events, self.fit.naming, self.tracks.ids.index(ball), self.tracks.t
        counts = [self.numbers and self.numbers.find_number(name, ball) for name in ("length", "cushions")]
        shown = [format_number(one) for one in counts if one]
        way = ""
        if len(shown) == 2:
            is_known = shown[0] != NOT_OBSERVABLE
            ran = f"it ran {shown[0]} and" if is_known else f"the length of its path is {NOT_OBSERVABLE}; it"
            way = f"; {ran} met {shown[1]} {naming.rail_word}{'s' * (shown[1] != '1')}"
        own = [j for j in self.likely if ball in (events.a[j], events.b[j])]
        last_event = own[-1] if own else None
        if last_event is not None and events.kind[last_event] == "pocket":
            pocket = naming.name_pocket(events.b[last_event])
            return f"fell into the {pocket} at {format_event_time(events, last_event)}{way}"
        t = min(self.end, float(times[-1]))
        last = float(times[self.tracks.is_observed[:, k]].max(initial=-np.inf))
        is_seen = t - last < LOST_FRAMES * float(np.median(np.diff(times)))
        t = t if is_seen else last
        state, row = self.fit.trajectory.at(t - CONTACT_MARGIN), self.fit.trajectory.ids.index(ball)
        if not np.isfinite(state.xy[row]).all():
            return "its end is unknown"
        speed = float(np.linalg.norm(state.v[row]))
        motion = MOVING if is_seen else f"last seen at {format_moment(t)}, moving"
        words = f"{motion} at {format_speed(speed)}"
        if speed < REST_SPEED:  # measured places of a resting ball scatter
            words = "at rest" if speed == 0 or state.measured[row] else "almost at rest"
        if last_event is not None and events.kind[last_event] == "rest":
            words = f"at rest since {format_event_time(events, last_event)}"
        return f"{words}, {format_place(state.xy[row], np.nan, self.table, naming)}{way}"

    def _format_confidence(self, main: int | None) -> str:
        """Format the probability of the main event and of the others, and the trust level of the clip."""
        events, parts = self.fit.events, []
        if main is not None:
            first = f"{self.fit.naming.say(self._find_partner(main))} first"
            what = start_sentence(first if events.kind[main] == "ball" else "stroke")
            firsts = (one for one in self.calls if one.kind == "first" and one.subject == (self.ball,))
            called = (one.probability for one in firsts if abs(one.t - events.t[main]) < SAME_MOMENT_TIME)
            parts.append(f"{what}: {format_probability(next(called, float(events.probability[main])))}.")
        others = {
            k for k in range(len(events))
            if self.start <= events.t[k] < self.end and k != main and events.kind[k] != "rest"
        }  # fmt: skip
        worst = format_least_sure(events, sorted(others), self.fit.explanation, self.fit.naming)
        if others:
            shown = f"Of the other contacts, the least sure: {worst}."
            parts.append(shown if worst else "All other contacts: above 99.9 %.")
        return " ".join([*parts, f"Trust level of the clip: {self.fit.trust.level}."])


def _format_turn(before: FloatArray, later: FloatArray) -> str:
    """Format the change of direction between two velocities (2,); y runs down, so that clockwise is positive."""
    angle = float(np.degrees(np.arctan2(before[0] * later[1] - before[1] * later[0], before @ later)))
    side = "right" if angle > 0 else "left"
    if abs(angle) < 0.5:
        return "went straight on"
    if abs(angle) < MAX_STRAIGHT_ANGLE:
        return f"went on {abs(angle):.0f}° to the {side} of its own line"
    return "came back" if abs(angle) > MIN_RETURN_ANGLE else f"turned {abs(angle):.0f}° to its own {side}"
