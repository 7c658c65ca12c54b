"""A shot in five answers: who hit whom first, when, how fast, what the ball did then, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.core.events import Events
from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from pipeline.reporting.text.sentences import event_sentence, event_time

JUST = 1e-3
"""s before and after a contact, beyond twice its error, at which a ball's velocity is told."""
SETTLED = 0.4
"""s after a contact at which most balls roll again, and the eye has seen where they go."""
STANDS = 0.03
"""m/s below which one says that a ball stands."""
ON, BACK = 25.0, 140.0
"""Degrees of a turn up to which a ball goes on, and from which it comes back."""
LIKELY = 0.5
"""Probability from which an event is told."""
CUE_KINDS = ("cue", "white", "yellow")
UNSEEN = "No stroke is seen in this clip: what came before it is not told."
AFTERWARDS = 6
"""Events of the ball after the contact that are told one by one; balls before cushions."""
SURE = 0.9985
"""Probability from which a fit's word is "at least 99.9 %": no fit knows more."""
UNTOLD = "-"
"""An answer where there is none."""


@dataclass(frozen=True, slots=True)
class Story:
    """One stroke; each answer is one or two sentences."""

    start: float
    """s"""
    first: str
    when: str
    speed: str
    after: str
    sure: str
    potted: str = ""
    """What fell, and where; empty where nothing did."""


def tell(tracks: Tracks, fit: Fit, scale_doubts: Sequence[str] = ()) -> list[Story]:
    """A story for every stroke; of a clip that begins after it, for the ball that moves first.

    `scale_doubts`: sentences that say by how much all speeds may be wrong; told beside them.
    """
    events = fit.events
    likely = [k for k in range(len(events)) if events.probability[k] >= LIKELY]
    strikes = [k for k in likely if events.kind[k] == "strike" and events.a[k] in fit.trajectory.ids]
    if strikes:
        ends = [*(float(events.t[k]) for k in strikes[1:]), np.inf]
        told = [
            (_story(fit, tracks, events.a[k], float(events.t[k]), end, likely, k), end)
            for k, end in zip(strikes, ends, strict=True)
        ]
    else:
        begins = _first_mover(tracks, fit, likely)
        first = float(tracks.t[0])
        told = [] if begins is None else [(_story(fit, tracks, begins, first, np.inf, likely, None), np.inf)]
    return [
        replace(
            story,
            potted=_potted(events, likely, story.start, end),
            speed=" ".join([story.speed, *(scale_doubts if story.speed != UNTOLD else ())]),
        )
        for story, end in told
    ]


def _potted(events: Events, likely: list[int], start: float, end: float) -> str:
    fallen = [k for k in likely if events.kind[k] == "pocket" and start <= events.t[k] < end]
    told = _list([f"{events.a[k]} into the {events.b[k]} pocket at {event_time(events, k)}" for k in fallen])
    return told + "." if told else ""


def _first_mover(tracks: Tracks, fit: Fit, likely: list[int]) -> str | None:
    """Who came, at the first contact of balls: the faster one, or the one that was too fast to be seen before.

    Without a contact the ball that moves first, of several a cue ball before others.
    """
    events, ids = fit.events, fit.trajectory.ids
    for k in likely:
        if events.kind[k] == "ball" and {events.a[k], events.b[k]} <= set(ids):
            pair = [events.a[k], events.b[k]]
            v = fit.trajectory.at(float(events.t[k] + _beside(events, k)[0])).v
            speed = [float(np.nan_to_num(np.linalg.norm(v[ids.index(ball)]), nan=np.inf)) for ball in pair]
            return pair[int(np.argmax(speed))]
    moving = np.flatnonzero(fit.moving.any(axis=0))
    started = [int(np.argmax(fit.moving[:, k])) for k in moving]
    first = [int(k) for k, row in zip(moving, started, strict=True) if row == min(started)]
    cue = [k for k in first if tracks.kinds[k] in CUE_KINDS]
    return tracks.ids[(cue or first)[0]] if first else None


def _story(
    fit: Fit, tracks: Tracks, ball: str, start: float, end: float, likely: list[int], strike: int | None
) -> Story:
    events = fit.events
    own = [k for k in likely if start <= events.t[k] < end and ball in (events.a[k], events.b[k]) and k != strike]
    touch = next((k for k in own if events.kind[k] == "ball"), None)
    struck = (
        f" {UNSEEN}" if strike is None else f" It was struck at {event_time(events, strike)}{_left_at(events, strike)}."
    )
    if touch is None:
        then = _told_after(fit, tracks, ball, own, start, end)
        when = UNTOLD if strike is None else f"{event_time(events, strike)} (the stroke)"
        first = f"{ball} touched no other ball.{struck}"
        return Story(start, first, when, _stroke_speed(events, strike), then, _sure(fit, own, strike))
    t = float(events.t[touch])
    other = events.b[touch] if events.a[touch] == ball else events.a[touch]
    then = _told_after(fit, tracks, ball, [k for k in own if events.t[k] > t], t, end)
    return Story(
        start,
        f"{ball} hit {other} first{_by_way_of(events, own, t)}.{struck}",
        f"{event_time(events, touch)} (picture {events.frame[touch]:.2f}){_since(events, strike, t)}",
        _speeds(fit, ball, other, touch),
        f"{_way_on(fit, ball, touch, own, end)} {then}",
        _sure(fit, own, touch),
    )


def _by_way_of(events: Events, own: list[int], t: float) -> str:
    cushions = [events.b[k] for k in own if events.kind[k] == "cushion" and events.t[k] < t]
    return f", by way of the {_list(cushions)} cushion{'s' if len(cushions) > 1 else ''}" if cushions else ""


def _since(events: Events, strike: int | None, t: float) -> str:
    return "" if strike is None else f", {t - events.t[strike]:.3f} s after the stroke"


def _left_at(events: Events, k: int) -> str:
    return f" and left at {events.speed[k]:.2f} m/s" if np.isfinite(events.speed[k]) else ""


def _stroke_speed(events: Events, k: int | None) -> str:
    if k is None or not np.isfinite(events.speed[k]):
        return UNTOLD
    return f"{events.speed[k]:.2f} m/s after the stroke"


def _speeds(fit: Fit, ball: str, other: str, touch: int) -> str:
    """How fast they closed, and how fast the ball came and the other left."""
    events, ids = fit.events, fit.trajectory.ids
    before, after = (fit.trajectory.at(float(t)) for t in events.t[touch] + _beside(events, touch))
    came = float(np.linalg.norm(before.v[ids.index(ball)]))
    sigma = float(before.sigma_v[ids.index(ball)])
    left = float(np.linalg.norm(after.v[ids.index(other)])) if other in ids else float("nan")
    parts = []
    if np.isfinite(events.speed[touch]):
        parts.append(f"They closed at {events.speed[touch]:.2f} m/s along the line of their centres")
    if np.isfinite(came):
        parts.append(f"{ball} came at {came:.2f} ± {sigma:.3f} m/s")
    elif parts:
        parts.append(f"how fast {ball} came was not seen")
    if np.isfinite(left):
        parts.append(f"{other} left at {left:.2f} m/s")
    return "; ".join(parts) + "." if parts else "not known"


def _beside(events: Events, k: int) -> FloatArray:
    """s before and after event k at which it is sure that it is still to come, and over."""
    return np.asarray(np.array([-1.0, 1.0]) * (JUST + 2 * events.t_sigma[k]), np.float64)


def _way_on(fit: Fit, ball: str, touch: int, own: list[int], end: float) -> str:
    """Where the ball went, once it rolled or met the next thing."""
    events, ids = fit.events, fit.trajectory.ids
    t, k = float(events.t[touch]), ids.index(ball)
    ahead = [float(events.t[j] + _beside(events, j)[0]) for j in own if events.t[j] > t + JUST]
    before_and_after = t + _beside(events, touch)
    look = max(min(t + SETTLED, *(ahead[:1] or [np.inf]), end - JUST), float(before_and_after[1]))
    known = fit.trajectory.at(np.append(before_and_after, look)).v[:, k]
    before, later = known[0], known[2]
    speeds = np.linalg.norm(known, axis=1)
    if not np.isfinite(speeds[2]):
        return f"Where {ball} went is not known."
    if not speeds[0] > STANDS:
        return f"{ball} went at {speeds[2]:.2f} m/s {look - t:.2f} s later; from where it came was not seen."
    if speeds[2] < STANDS:
        return f"{ball} stopped where it was ({speeds[2]:.2f} m/s {look - t:.2f} s later)."
    slow = f"all but stopped ({speeds[1]:.2f} m/s), then " if speeds[1] < 0.5 * speeds[2] else ""
    return f"{ball} {slow}{_course(before, later)}, at {speeds[2]:.2f} m/s {look - t:.2f} s later."


def _course(before: FloatArray, later: FloatArray) -> str:
    """How a ball turned from one velocity (2,) to another, as a player says it."""
    angle = _turn(before, later)
    side = "right" if angle > 0 else "left"  # y runs down: a positive angle turns clockwise as seen from above
    if abs(angle) < ON:
        return f"went on in its old direction ({abs(angle):.0f}° to the {side})"
    if abs(angle) > BACK:
        return "came back"
    return f"went off {abs(angle):.0f}° to the {side} of its old way"


def _turn(before: FloatArray, later: FloatArray) -> float:
    """Degrees from one velocity (2,) to another; clockwise, as seen from above, above 0."""
    cross = before[0] * later[1] - before[1] * later[0]
    return float(np.degrees(np.arctan2(cross, before @ later)))


def _told_after(fit: Fit, tracks: Tracks, ball: str, later: list[int], start: float, end: float) -> str:
    """What the ball met then, and where it ended."""
    events = fit.events
    met = [k for k in later if events.kind[k] in ("ball", "cushion")]
    told = _chosen(events, met)
    more = f" and {len(met) - len(told)} more" if len(met) > len(told) else ""
    words = [f"{_met(events, k, ball)} at {events.t[k]:.3f} s" for k in told]
    then = f"Then it met {_list(words)}{more}. " if words else "It met nothing more. " if start > 0 else ""
    for k in later:
        if events.kind[k] == "pocket":
            return then + f"It fell into the {events.b[k]} pocket at {event_time(events, k)}."
    return then + _end(fit, tracks, ball, min(end, float(tracks.t[-1])), later)


def _chosen(events: Events, met: list[int]) -> list[int]:
    """As many as are told, in their order: balls first, for they decide a stroke, then the first cushions."""
    wanted = sorted(met, key=lambda k: (events.kind[k] != "ball", events.t[k]))[:AFTERWARDS]
    return sorted(wanted, key=lambda k: float(events.t[k]))


def _end(fit: Fit, tracks: Tracks, ball: str, t: float, later: list[int]) -> str:
    events = fit.events
    state = fit.trajectory.at(t - JUST)
    k = fit.trajectory.ids.index(ball)
    if not np.isfinite(state.xy[k]).all():
        return "How it ended is not known."
    place = f"({state.xy[k, 0]:.3f}, {state.xy[k, 1]:.3f}) m"
    speed = float(np.linalg.norm(state.v[k]))
    rests = [j for j in later if events.kind[j] == "rest"]
    if rests:
        return f"It came to rest at {events.t[rests[-1]]:.2f} s at {place}."
    if speed < STANDS:
        return f"At {t:.2f} s it lay at {place}."
    return f"When the clip ends, at {t:.2f} s, it still rolls at {speed:.2f} m/s, at {place}."


def _met(events: Events, k: int, ball: str) -> str:
    if events.kind[k] == "cushion":
        return f"the {events.b[k]} cushion"
    return events.b[k] if events.a[k] == ball else events.a[k]


def _sure(fit: Fit, own: list[int], main: int | None) -> str:
    """Of the contact that was told, of the others, and of the whole clip."""
    events = fit.events
    parts = []
    if main is not None:
        what = "first contact" if events.kind[main] == "ball" else "stroke"
        parts.append(f"The {what} is {_probably(float(events.probability[main]))}")
    others = [k for k in own if k != main]
    worst = min(others, key=lambda k: events.probability[k], default=None)
    if worst is not None and events.probability[worst] > SURE:
        parts.append("all that this ball met besides is at least 99.9 % sure")
    elif worst is not None:
        parts.append(
            f"of what this ball met besides, the least sure is {_probably(float(events.probability[worst]))} "
            f"({event_sentence(events, worst)})"
        )
    parts.append(f"the clip's trust light is {fit.trust.light}")
    text = "; ".join(parts) + "."
    return text[0].upper() + text[1:]


def _probably(probability: float) -> str:
    """A probability in words; no fit knows more than that something is more than 99.9 % sure."""
    return "at least 99.9 % sure" if probability > SURE else f"{100 * probability:.1f} % sure"


def _list(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""
