"""A refined story as a list of events, each with its time, error, probability and margin."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.scene import CUSHIONS, POCKETS, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import span_before, state_at
from models.estimation.joint_fit.fit_solution import Layout, Solution, end_state, layout
from models.estimation.reconstruction.trajectory_assembly import state_covariance
from models.estimation.segmentation.contact_classification import CUE_KINDS, INWARD, NEAR_BALL, cushion_distances
from models.estimation.segmentation.contact_graph import Contact
from models.physics.billiards.cloth.closed_form_motion import STATE, Friction, kinematics, rest_time, slide_time

GAP_HORIZON = 0.25
"""s: how far free paths are followed beyond a contact to find their least distance."""
POCKET_REACH = 3.0
"""ball radii plus the way of two frames: a track that ends so near to a pocket has been potted."""
TO_GO = 0.05
"""ball radii, about a pixel: a ball that has no more left to go rests to the eye; real ones even roll back a little,
into the dent that they make in the cloth, so that the moment of no speed at all cannot be seen."""
_CLOSING = 0.02
"""m/s at which two balls close who meet; slower than any ball that is told from a resting one."""
_LONGEST = 0.5
"""s: a rest less certain is no event."""
_SHORTEST = 0.01
"""m: a ball that rested, and moved less by itself, has not come to rest: it jittered."""
_CLEAR = 0.3
"""m/s: so fast a ball comes to one that it surely meets where it turns."""
_MET_SIGMA = 0.01
"""m: how well the place of such a contact is known."""
_NUDGE = 0.5
"""ball radii: an object ball that seems to move less by itself was only seen badly."""
_BLIND = 0.02
"""of the time that a ball was not seen around its strike: how well its speed meanwhile is known."""
_PRICE = 20.0
"""chi2 that an event must improve to be as likely as not."""


@dataclass(frozen=True, slots=True)
class Happening:
    """One event, see `models.core.events.Events`."""

    kind: str
    t: float
    t_sigma: float
    a: str
    b: str
    xy: FloatArray
    probability: float
    gap: float = np.nan
    gap_sigma: float = np.nan
    speed: float = np.nan


def events_of(
    solution: Solution, tracks: Tracks, table: Table, chi2: FloatArray, potted: list[Happening], played: list[Happening]
) -> Events:
    """All events of a clip, those that were `played` too; `chi2` (S,) per span inflates the errors of times where
    a span fits badly."""
    plan = layout(solution.story)
    found = [*potted, *played]
    for number, contact in enumerate(solution.story.contacts):
        found += _contact(solution, plan, number, contact, tracks, table, chi2)
    vanish = {event.a: event.t for event in potted}
    found += _rests(solution, plan, tracks, table.ball_radius)
    jaws = 3 * float(np.median(np.diff(tracks.t))) if potted else 0.0
    kept = [
        event for event in found
        if event.kind not in ("rest", "cushion") or event.t < vanish.get(event.a, np.inf) - jaws
    ]  # fmt: skip
    return listed([_bounded(event, tracks) for event in _one_cue(kept, tracks)], tracks)


def _one_cue(found: list[Happening], tracks: Tracks) -> list[Happening]:
    """Without strikes of object balls where a cue ball was struck: something else set them going, seen badly."""
    strikes = [event for event in found if event.kind == "strike"]
    kinds = ("cue",) if "cue" in tracks.kinds else CUE_KINDS
    struck = [event for event in strikes if tracks.kinds[tracks.ids.index(event.a)] in kinds]
    believed = struck or sorted(strikes, key=lambda event: event.t)[:1]
    return [event for event in found if event.kind != "strike" or event in believed]


def _bounded(event: Happening, tracks: Tracks) -> Happening:
    """No event is less certain than a few pictures: the samples before and after it show that much."""
    seen = tracks.t[tracks.observed[:, tracks.ids.index(event.a)]]
    row = int(np.clip(np.searchsorted(seen, event.t), 1, len(seen) - 1)) if len(seen) > 1 else 0
    limit = 2 * float(seen[row] - seen[row - 1]) if row else _LONGEST
    return replace(event, t_sigma=min(event.t_sigma, limit)) if event.kind != "rest" else event


def listed(found: list[Happening], tracks: Tracks) -> Events:
    """Happenings as columns, sorted by time."""
    found = sorted(found, key=lambda event: (event.t, event.a))
    t = np.array([event.t for event in found], dtype=np.float64)
    return Events(
        tuple(event.kind for event in found), t,
        np.array([max(event.t_sigma, 1e-6) for event in found], dtype=np.float64),
        frame_at(tracks, t),
        tuple(event.a for event in found), tuple(event.b for event in found),
        np.array([event.xy for event in found]).reshape(-1, 2),
        *(np.array([getattr(event, name) for event in found], dtype=np.float64)
          for name in ("probability", "gap", "gap_sigma", "speed")),
    )  # fmt: skip


def frame_at(tracks: Tracks, t: FloatArray) -> FloatArray:
    """Fractional pictures (E,) at times t (E,), also a little outside the clip."""
    if len(tracks.t) < 2:
        return np.zeros_like(t)
    row, numbers = (
        np.clip(np.searchsorted(tracks.t, t, side="right") - 1, 0, len(tracks.t) - 2),
        tracks.frame.astype(float),
    )
    share = (t - tracks.t[row]) / (tracks.t[row + 1] - tracks.t[row])
    frames: FloatArray = numbers[row] + share * (numbers[row + 1] - numbers[row])
    return frames


def pocketed(solution: Solution, tracks: Tracks, table: Table) -> list[Happening]:
    """Balls whose tracks end early, in motion, near a pocket."""
    found = []
    last_frame = len(tracks.t) - 1
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.observed[:, ball])
        if not table.pockets or len(rows) < 2 or rows[-1] > last_frame - 2:
            continue
        span = solution.story.of_ball(ball)[-1]
        if solution.story.spans[span].static:
            found += _stuck(solution, tracks, table, ball, span, rows)
            continue
        found += _fall(solution, tracks, table, ball, span, int(rows[-1]))
    return found


def _stuck(
    solution: Solution, tracks: Tracks, table: Table, ball: int, span: int, rows: NDArray[np.int64]
) -> list[Happening]:
    """A ball that stops in the jaws for a picture or three, then is gone, fell."""
    story, interval = solution.story, float(np.median(np.diff(tracks.t)))
    last = float(tracks.t[rows[-1]])
    distance = np.linalg.norm(table.pocket_centres - tracks.xy[rows[-1], ball], axis=1)
    pocket = int(np.argmin(distance))
    waited = last - story.begin(span)
    if story.spans[span].start is None or waited > 3 * interval or distance[pocket] > POCKET_REACH * table.ball_radius:
        return []
    x = tracks.xy[rows[-1], ball]
    return [Happening("pocket", last + 0.5 * interval, interval, tracks.ids[ball], POCKETS[pocket], x, 0.9)]


def _fall(solution: Solution, tracks: Tracks, table: Table, ball: int, span: int, row: int) -> list[Happening]:
    story, interval = solution.story, float(np.median(np.diff(tracks.t)))
    state, begin = story.spans[span].state, story.begin(span)
    t = max(float(tracks.t[row]), begin) + np.linspace(0, 8 * interval, 161)
    path = kinematics(np.repeat(state[None], len(t), axis=0), t - begin, solution.friction)
    speed = float(np.hypot(*path[0, 2:4]))
    distance = np.linalg.norm(path[:, None, :2] - table.pocket_centres, axis=2)  # (161, 6)
    pocket = int(np.argmin(distance.min(axis=0)))
    here = float(np.linalg.norm(tracks.xy[row, ball] - table.pocket_centres[pocket]))
    reach = POCKET_REACH * table.ball_radius
    if here > reach + 2 * interval * speed or distance[:, pocket].min() > reach or speed < 0.02:
        return []
    inside = np.flatnonzero(distance[:, pocket] < max(1.0 * table.ball_radius, distance[:, pocket].min() + 1e-4))
    when = float(t[inside[0]])
    sigma = max(0.5 * interval, 0.5 * table.ball_radius / max(speed, 0.05))
    return [
        Happening("pocket", when, sigma, tracks.ids[ball], POCKETS[pocket], path[inside[0], :2], 0.95, speed=speed)
    ]  # fmt: skip


def probability(gain: float) -> float:
    """That a contact happened, from the chi2 it improves."""
    return float(np.clip(1 / (1 + np.exp(np.clip(-(gain - _PRICE) / 2, -40, 40))), 0.001, 0.999))


def _contact(
    solution: Solution, plan: Layout, number: int, contact: Contact, tracks: Tracks, table: Table, chi2: FloatArray
) -> list[Happening]:
    ids = tracks.ids
    if contact.kind in ("jump", "burst"):
        return []
    if contact.kind == "free":
        return _met(solution, plan, number, contact, tracks, table) + _stopped(solution, plan, number, contact, ids)
    spans = solution.story.spans
    balls = [spans[k].ball for k in contact.before]
    around = chi2[[*contact.before, *contact.after]]
    excess = max(1.0, float(np.nanmax(around)) if np.isfinite(around).any() else 1.0)
    sigma = float(np.sqrt(solution.covariance[plan.contact + number, plan.contact + number] * excess))
    after = [spans[k].state for k in contact.after]
    likely = probability(contact.gain)
    if contact.kind == "strike":
        speed = float(np.hypot(*after[0][2:4]))
        hitter = None if tracks.kinds[balls[0]] in CUE_KINDS else _hitter(solution, contact, tracks, table)
        if hitter is not None:
            sigma = max(sigma, 0.5 * float(np.median(np.diff(tracks.t))))
            return [Happening("ball", contact.t, sigma, ids[hitter], ids[balls[0]], after[0][:2], 0.7, speed=speed)]
        seen = tracks.t[tracks.observed[:, balls[0]]]
        row = int(np.clip(np.searchsorted(seen, contact.t), 1, max(len(seen) - 1, 1)))
        gap = float(seen[row] - seen[row - 1]) if len(seen) > 1 else 0.0
        sigma = float(np.hypot(sigma, _BLIND * gap))
        way = np.linalg.norm(end_state(solution, contact.after[0])[:2] - after[0][:2])
        if tracks.kinds[balls[0]] not in CUE_KINDS and way < _NUDGE * table.ball_radius:
            return []
        return [Happening("strike", contact.t, sigma, ids[balls[0]], "", after[0][:2], likely, speed=speed)]
    before = [end_state(solution, k) for k in contact.before]
    if contact.kind == "cushion":
        side = CUSHIONS.index(contact.cushion)
        gap, gap_sigma = _cushion_gap(solution, plan, contact, side, table)
        speed = float(-INWARD[side] @ before[0][2:4])
        found = [
            Happening(
                "cushion", contact.t, sigma, ids[balls[0]], contact.cushion, after[0][:2], likely, gap, gap_sigma, speed
            )
        ]
        return found + _stopped(solution, plan, number, contact, ids)
    apart = after[1][:2] - after[0][:2]
    normal = apart / np.hypot(*apart)
    speed = float((before[0][2:4] - before[1][2:4]) @ normal)
    if speed < _CLOSING and not contact.driven:  # balls that lay together, or part: nothing met
        return _stopped(solution, plan, number, contact, ids)
    gap, gap_sigma = _ball_gap(solution, plan, contact, table)
    found = [
        Happening("ball", contact.t, sigma, ids[balls[0]], ids[balls[1]], after[0][:2], likely, gap, gap_sigma, speed)
    ]
    return found + _stopped(solution, plan, number, contact, ids)


def _met(
    solution: Solution, plan: Layout, number: int, contact: Contact, tracks: Tracks, table: Table
) -> list[Happening]:
    """The contact with a ball that lies where another one turns, though no law explains how the two share it.

    So a cue ball meets a rack: what it gives has gone on to the next ones before a picture shows it.
    """
    story, ids = solution.story, tracks.ids
    ball, coming = story.spans[contact.before[0]].ball, end_state(solution, contact.before[0])
    found: list[tuple[float, int, float]] = []
    for other in {span.ball for span in story.spans} - {ball}:
        there = state_at(story, solution.friction, span_before(story, other, contact.t), contact.t)
        apart = there[:2] - coming[:2]
        distance = float(np.hypot(*apart))
        closing = float((coming[2:4] - there[2:4]) @ apart) / max(distance, 1e-9)
        miss = abs(distance / table.ball_radius - 2)
        if miss < NEAR_BALL and closing > _CLEAR:
            found.append((miss, other, closing))
    if not found:
        return []
    _, other, closing = min(found)
    interval = float(np.median(np.diff(tracks.t)))
    near = [c for c in story.contacts if c.kind == "ball" and abs(c.t - contact.t) < interval]
    if any(story.balls_at(c) == {ball, other} for c in near):  # it is told already
        return []
    sigma = max(float(np.sqrt(solution.covariance[(plan.contact + number,) * 2])), _MET_SIGMA / closing)
    return [Happening("ball", contact.t, sigma, ids[ball], ids[other], coming[:2], 0.7, speed=closing)]


def _hitter(solution: Solution, contact: Contact, tracks: Tracks, table: Table) -> int | None:
    """The ball that set an object ball going though no common contact was fitted.

    A neighbour that leaves in the same picture, or a ball whose track begins just after on a way that leads from here.
    """
    story, interval = solution.story, float(np.median(np.diff(tracks.t)))
    place, ball = story.spans[contact.before[0]].state[:2], story.spans[contact.before[0]].ball
    found: list[tuple[float, int]] = []
    for k, span in enumerate(story.spans):
        if span.ball == ball:
            continue
        if span.static:
            there = span.state[:2]
            fits = abs(story.finish(k) - contact.t) < 1.5 * interval
        else:
            there = kinematics(span.state[None], np.array([contact.t - span.t0]), solution.friction)[0, :2]
            fits = span.start is None and 0 < span.t0 - contact.t < 5 * interval
        miss = abs(float(np.linalg.norm(there - place)) / table.ball_radius - 2)
        if fits and miss < (0.35 if span.static else 0.8):
            found.append((miss, span.ball))
    return min(found)[1] if found else None


def _stopped(solution: Solution, plan: Layout, number: int, contact: Contact, ids: tuple[str, ...]) -> list[Happening]:
    """Balls that a contact brought to rest."""
    spans = solution.story.spans
    sigma = float(np.sqrt(solution.covariance[plan.contact + number, plan.contact + number]))
    return [
        Happening("rest", contact.t, sigma, ids[spans[two].ball], "", spans[two].state[:2], probability(contact.gain))
        for one, two in zip(contact.before, contact.after, strict=True)
        if spans[two].static and not spans[one].static and sigma < _LONGEST
    ]


def _rests(solution: Solution, plan: Layout, tracks: Tracks, radius: float) -> list[Happening]:
    """Balls that rolled out, and were seen at rest."""
    story, found = solution.story, []
    interval = float(np.median(np.diff(tracks.t))) if len(tracks.t) > 1 else 0.0
    for k, span in enumerate(story.spans):
        if span.static:
            continue
        length, stop = _rolled_out(solution, k, TO_GO * radius)
        t = story.begin(k) + length
        seen = tracks.t[tracks.observed[:, span.ball]]
        if story.begin(k) + stop > story.finish(k) or t > float(seen[-1]) + interval:
            continue
        place = kinematics(span.state[None], np.array([length]), solution.friction)[0, :2]
        sigma = _rest_sigma(solution, plan, k)
        if sigma > _LONGEST or (_began_at_rest(solution, k) and np.linalg.norm(place - span.state[:2]) < _SHORTEST):
            continue
        found.append(Happening("rest", t, sigma, tracks.ids[span.ball], "", place, 0.99))
    return found


def _rolled_out(solution: Solution, k: int, to_go: float) -> tuple[float, float]:
    """s after the start of a span: when it has `to_go` m left, and when it stops."""
    state, friction = solution.story.spans[k].state, solution.friction
    stop, slide = float(rest_time(state, friction)), float(slide_time(state, friction))
    speed = float(np.hypot(*kinematics(state[None], np.array([slide]), friction)[0, 2:4]))
    last = np.sqrt(2 * to_go * (stop - slide) / max(speed, 1e-9))
    return max(stop - float(last), 0.0), stop


def _began_at_rest(solution: Solution, k: int) -> bool:
    """Whether a span is the first of its ball, or follows a rest."""
    start, spans = solution.story.spans[k].start, solution.story.spans
    if start is None:
        return True
    contact = solution.story.contacts[start]
    return spans[contact.before[contact.after.index(k)]].static


def _rest_sigma(solution: Solution, plan: Layout, k: int) -> float:
    """Of the time of rest: by central differences over the state and the coefficients of the cloth."""
    span, friction, step = solution.story.spans[k], solution.friction, 1e-6
    slope = np.zeros(plan.size)
    for index in range(STATE):
        shift = np.zeros(STATE)
        shift[index] = step
        slope[plan.span[k] + index] = (
            float(rest_time(span.state + shift, friction) - rest_time(span.state - shift, friction)) / (2 * step)
        )  # fmt: skip
    for index in range(2):
        up, down = (_scaled(friction, index, float(np.exp(sign * step))) for sign in (1, -1))
        change = float(rest_time(span.state, up) - rest_time(span.state, down))
        slope[plan.globals + index] = change / (2 * step)
    if span.start is not None:
        slope[plan.contact + span.start] = 1.0
    variance = float(slope @ solution.covariance @ slope)
    return float(np.sqrt(max(variance, 0.0)))


def _scaled(friction: Friction, index: int, by: float) -> Friction:
    """With one coefficient, sliding (0) or rolling (1), multiplied."""
    return Friction(friction.sliding * (by if index == 0 else 1.0), friction.rolling * (by if index == 1 else 1.0))


def _free_path(solution: Solution, k: int, t: FloatArray) -> FloatArray:
    """Positions (M, 2) of a span, followed beyond its end as if nothing had happened."""
    span = solution.story.spans[k]
    if span.static:
        return np.repeat(span.state[None, :2], len(t), axis=0)
    states = np.repeat(span.state[None], len(t), axis=0)
    return kinematics(states, t - solution.story.begin(k), solution.friction)[:, :2]


def _ball_gap(solution: Solution, plan: Layout, contact: Contact, table: Table) -> tuple[float, float]:
    t = contact.t + np.linspace(-0.02, GAP_HORIZON, 271)
    apart = _free_path(solution, contact.before[1], t) - _free_path(solution, contact.before[0], t)
    distance = np.linalg.norm(apart, axis=1)
    least = int(np.argmin(distance))
    reach = 2 * table.ball_radius * solution.diameter
    normal = apart[least] / max(distance[least], 1e-9)
    variance = (2 * table.ball_radius) ** 2 * solution.covariance[plan.globals + 2, plan.globals + 2]
    for k in contact.before:
        tau = np.array([t[least] - solution.story.begin(k)])
        variance += float(normal @ state_covariance(solution, plan, k, tau)[0, :2, :2] @ normal)
    return float(distance[least] - reach), float(np.sqrt(variance))


def _cushion_gap(solution: Solution, plan: Layout, contact: Contact, side: int, table: Table) -> tuple[float, float]:
    t = contact.t + np.linspace(-0.02, GAP_HORIZON, 271)
    distance = cushion_distances(_free_path(solution, contact.before[0], t), table)[:, side]
    least = int(np.argmin(distance))
    column = plan.globals + 3 + side
    tau = np.array([t[least] - solution.story.begin(contact.before[0])])
    place = state_covariance(solution, plan, contact.before[0], tau)[0, :2, :2]
    variance = float(INWARD[side] @ place @ INWARD[side] + solution.covariance[column, column])
    return float(distance[least] - table.ball_radius - solution.nose[side]), float(np.sqrt(variance))
