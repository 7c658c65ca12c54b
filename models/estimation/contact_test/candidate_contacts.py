"""When balls and cushions may have touched in a recorded shot, each such moment weighed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from models.core.scene import CUSHIONS
from models.estimation.contact_test.contact_moment import Cushion, Encounter, Watched, watch
from models.estimation.contact_test.contact_probability import weigh
from models.estimation.contact_test.shot_record import Record
from models.estimation.segmentation.contact_classification import INWARD, cushion_distances

WINDOW = 0.4
"""s to either side of a moment: farther away, what a table adds to the laws of rolling counts more than noise."""
GUARD = 3.0
"""standard deviations of its time that samples keep from another event."""
NEAR_PASS = 0.25
"""ball radii: paths that pass each other within it may have met."""
SAME = 0.06
"""s: an event and a near pass so close in time are one moment."""
RESTS = 0.02
"""m/s below which a ball rests to the eye."""
NEVER, ALWAYS = 0.001, 0.999
"""No call is surer: what is in the pictures may not be what happened."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A contact that may have happened."""

    ball: int
    other: str
    """The other ball or the cushion."""
    t: float
    t_sigma: float
    probability: float
    gap: float
    gap_sigma: float


def ball_moments(record: Record, one: int, two: int) -> list[Moment]:
    """Every moment at which two balls may have touched, weighed."""
    found = []
    for t in _candidates(record, one, two):
        who = {record.ids[one], record.ids[two]}
        try:
            balls = tuple(watched(record, t, ball, who) for ball in (one, two))
            asked = Encounter(balls, 2 * record.table.ball_radius, record.reach_sigma)
            found.append(_weighed(asked, one, record.ids[two], t))
        except ValueError:  # too few samples to weigh: what the run says of it stands
            found.append(_as_told(record, one, two, t))
    return found


def cushion_moments(record: Record, one: int) -> list[Moment]:
    """Every moment at which a ball met a cushion, weighed."""
    events, found = record.events, []
    for e in range(len(events)):
        if events.kind[e] != "cushion" or events.a[e] != record.ids[one]:
            continue
        side, t = CUSHIONS.index(events.b[e]), float(events.t[e])
        inward = INWARD[side]
        nose = -float(cushion_distances(np.zeros(2), record.table)[side]) + record.table.ball_radius
        told = Moment(one, events.b[e], t, float(events.t_sigma[e]), float(events.probability[e]),
                      float(events.gap[e]), float(events.gap_sigma[e]))  # fmt: skip
        try:
            balls = (watched(record, t, one, {record.ids[one], events.b[e]}),)
            asked = Encounter(balls, record.table.ball_radius, record.nose_sigma, Cushion(inward, nose))
            found.append(_weighed(asked, one, events.b[e], t))
        except ValueError:
            found.append(told)
    return found


def _weighed(asked: Encounter, one: int, other: str, t: float) -> Moment:
    verdict = weigh(asked, t)
    probability = float(np.clip(verdict.probability, NEVER, ALWAYS))
    return Moment(one, other, verdict.t, verdict.t_sigma, probability, verdict.gap, verdict.gap_sigma)


def _as_told(record: Record, one: int, two: int, t: float) -> Moment:
    """What the events of the run, or else the fitted paths alone, say of a moment."""
    events, names = record.events, {record.ids[one], record.ids[two]}
    for e in range(len(events)):
        if events.kind[e] == "ball" and {events.a[e], events.b[e]} == names and abs(events.t[e] - t) < SAME:
            return Moment(one, record.ids[two], t, *(float(v[e]) for v in (
                events.t_sigma, events.probability, events.gap, events.gap_sigma)))  # fmt: skip
    k = int(np.argmin(np.abs(record.moments - t)))
    gap = float(np.hypot(*(record.path[k, two] - record.path[k, one]))) - 2 * record.table.ball_radius
    sigma = float(np.hypot(np.hypot(*record.path_sigma[k, [one, two]]), record.reach_sigma))
    return Moment(one, record.ids[two], t, float("nan"), float(ndtr(-gap / sigma)), gap, sigma)


def _candidates(record: Record, one: int, two: int) -> list[float]:
    """Moments (s) of events between two balls, and of near passes of their paths."""
    events, names = record.events, {record.ids[one], record.ids[two]}
    found = [float(events.t[e]) for e in range(len(events))
             if events.kind[e] == "ball" and {events.a[e], events.b[e]} == names]  # fmt: skip
    apart = np.linalg.norm(record.path[:, two] - record.path[:, one], axis=1) - 2 * record.table.ball_radius
    pace = np.hypot(*(record.velocity[:, two] - record.velocity[:, one]).T)
    near = np.flatnonzero((apart < NEAR_PASS * record.table.ball_radius) & (pace > RESTS))
    for group in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        if len(group):
            t = float(record.moments[group[np.argmin(apart[group])]])
            if all(abs(t - known) > SAME for known in found):
                found.append(t)
    return sorted(found)


def watched(record: Record, t: float, ball: int, who: set[str]) -> Watched:
    """A ball around t (s), from its last event before to its next one after; `who` are the parties of this one."""
    events, end = record.events, t + WINDOW
    begin = max(t - WINDOW, float(record.moments[0]))
    for e in range(len(events)):
        parties = {events.a[e], events.b[e]} - {""}
        if record.ids[ball] not in parties or events.kind[e] == "rest":
            continue
        if events.kind[e] in ("ball", "cushion") and parties == who and abs(events.t[e] - t) < SAME:
            continue
        guard = GUARD * float(events.t_sigma[e])
        if events.t[e] <= t:
            begin = max(begin, min(float(events.t[e]) + guard, t))
        else:
            end = min(end, max(float(events.t[e]) - guard, t))
    samples = record.samples(ball, begin, end)
    return watch(samples, t, begin, record.state(ball, begin))
