"""Second thoughts about a refined story: contacts that were missed, misnamed or never happened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import SLOW
from models.estimation.joint_fit.fit_solution import Data, Solution, end_state, owners
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.segmentation.contact_graph import Contact, Story
from models.estimation.structure_search.ball_encounters import (
    NEAR_IN_TIME,
    Answers,
    Encounter,
    doubtful,
    encounters,
    interval_of,
    total_cost,
    with_encounters,
)
from models.estimation.structure_search.contact_chains import with_rows
from models.estimation.structure_search.contact_removal import released
from models.estimation.structure_search.corner_cushions import with_corners
from models.estimation.structure_search.missed_cushions import doubled, inserted, renamed
from models.estimation.structure_search.simultaneous_starts import opened
from models.physics.billiards.cloth.closed_form_motion import kinematics

TOUCHING = 0.5
"""ball radii: two balls may be so far from touching where one of them breaks, and have met."""
NEAR_THE_END = 0.03
"""s: a touch so shortly before a change of velocity is its cause."""
CERTAIN = 3000.0
"""chi2: a contact that improves so much is not questioned again."""
ENOUGH = 20.0
"""chi2: a contact without which the whole clip is told worse improves at least so much."""
GRACE = 3.0
"""prices that the whole clip may lose by second thoughts about single contacts, until needless ones are removed."""
MOST_ENCOUNTERS = 6
"""in a row: one contact often shows the next."""


def revise(solution: Solution, data: Data, table: Table, price: float, dear: float, rounds: int = 3) -> Solution:
    """The solution after misnamed contacts are renamed, missed ones inserted and needless ones removed."""
    asked = Answers()
    for _ in range(rounds):
        solution = _acquainted(solution, data, table, price, dear, asked)
        story = renamed(solution, table)
        story = _paired(solution, story, data, table)
        story = _vanished(solution, story, data, table)
        story = doubled(solution, story, table)
        story = inserted(solution, story, data, table)
        before, solution = solution, _reconsidered(solution, story, data, table, (price, dear))
        solution = opened(solution, data, table, (price, dear))
        solution = with_corners(solution, data, table, (price, dear))
        solution = with_rows(solution, data, table, (price, dear), asked)
        solution = released(solution, data, table, (price, dear), asked)
        changed = solution is not before
        gains = _gains(solution, data, table, asked)
        fewer = _pruned(solution, gains, data, table, (price, dear))
        done = len(fewer.story.contacts) == len(gains) and not changed
        solution = fewer
        if done:
            break
    return solution


def _reconsidered(solution: Solution, story: Story, data: Data, table: Table, tolls: tuple[float, float]) -> Solution:
    """The solution of a changed story; the old one where the whole clip contradicts."""
    if story is solution.story:
        return solution
    tried = refine(story, data, table, start=solution)
    pays = total_cost(tried, tolls) < total_cost(solution, tolls) + GRACE * tolls[0]
    return tried if pays else solution


def _acquainted(solution: Solution, data: Data, table: Table, price: float, dear: float, asked: Answers) -> Solution:
    """The solution with the contacts of passing balls, as long as new ones come up."""
    fresh: frozenset[int] | None = None
    for _ in range(MOST_ENCOUNTERS):
        found = encounters(solution, data, table, (price, dear), asked, fresh)
        solution, fresh = _with_those_that_pay(solution, found, data, table, (price, dear))
        if not fresh:
            break
    return solution


def _with_those_that_pay(
    solution: Solution, found: list[Encounter], data: Data, table: Table, tolls: tuple[float, float]
) -> tuple[Solution, frozenset[int]]:
    """The solution with those encounters that the whole clip pays for, and the spans that changed.

    Where all together do not pay, half of them are tried, then the others: what is right around a contact alone may
    be wrong for what comes before or after.
    """
    if not found:
        return solution, frozenset()
    story, touched = with_encounters(solution, data, found, NEAR_IN_TIME * interval_of(data))
    if not touched:
        return solution, touched
    tried = refine(story, data, table, start=solution)
    if total_cost(tried, tolls) < total_cost(solution, tolls):
        return tried, touched
    if len(found) == 1:
        return solution, frozenset()
    half = len(found) // 2
    solution, one = _with_those_that_pay(solution, found[:half], data, table, tolls)
    rest = [other for other in found[half:] if not other.spans & one]
    solution, two = _with_those_that_pay(solution, rest, data, table, tolls)
    return solution, one | two


def without_doubts(solution: Solution, data: Data, table: Table, dear: float) -> Solution:
    """The solution without contacts that have no cause and improve less than `dear`, unless the whole clip misses them;
    nothing else is reconsidered."""
    return _pruned(solution, _gains(solution, data, table, Answers()), data, table, (0.0, dear))


def _pruned(solution: Solution, gains: FloatArray, data: Data, table: Table, tolls: tuple[float, float]) -> Solution:
    """The solution without contacts that the samples do not ask for; `gains` (C,) are kept in the others.

    Where the whole clip misses them, the more needed half of them stays, and so on. Those that stay are needed by more
    than their own spans: they gain what the whole clip loses without them where that is known, else what one must.
    """
    gone = _needless(solution, gains, tolls)
    believed = gains.copy()
    believed[gone] = np.maximum(gains[gone], ENOUGH)
    story = _with_gains(solution.story, gains).with_pushes()
    while gone:
        fewer = refine(_without(story, gone), data, table, start=solution)
        if total_cost(fewer, tolls) < total_cost(solution, tolls):
            return fewer
        if len(gone) == 1:
            believed[gone] = np.maximum(believed[gone], fewer.chi2 - solution.chi2)
        gone = gone[: len(gone) // 2]
    return replace(solution, story=_with_gains(solution.story, believed).with_pushes())


def _needless(solution: Solution, gains: FloatArray, tolls: tuple[float, float]) -> list[int]:
    """Contacts that gain less than they cost, the most needless first; no two of the same span."""
    contacts = solution.story.contacts
    price = np.array([tolls[doubtful(solution, c)] for c in contacts])
    touched: set[int] = set()
    gone = []
    for k in (int(k) for k in np.argsort(gains) if gains[k] < price[k]):
        around = {*contacts[k].before, *contacts[k].after}
        if not touched & around:  # neighbours wait: without this one they may be needed
            touched |= around
            gone.append(k)
    return gone


def _with_gains(story: Story, gains: FloatArray) -> Story:
    return Story(story.spans, tuple(replace(c, gain=float(g)) for c, g in zip(story.contacts, gains, strict=True)))


def _without(story: Story, contacts: list[int]) -> Story:
    for k in sorted(contacts, reverse=True):
        story = story.without(k)
    return story.with_pushes()


def _gains(solution: Solution, data: Data, table: Table, asked: Answers) -> FloatArray:
    """chi2 (C,) that every contact improves; `asked` keeps the answers for when nothing has changed."""
    owner, story, gains = owners(solution.story, data), solution.story, []
    for number, contact in enumerate(story.contacts):
        question = (contact.kind, contact.cushion, *story.told((*contact.before, *contact.after)))
        if question not in asked.gains:
            asked.gains[question] = _gain(solution, data, owner, table, number)
        gains.append(asked.gains[question])
    return np.array(gains)


def _gain(solution: Solution, data: Data, owner: NDArray[np.int64], table: Table, number: int) -> float:
    """chi2 that a contact improves on the spans that it joins."""
    contact, spans = solution.story.contacts[number], solution.story.spans
    if contact.gain > CERTAIN:
        return contact.gain
    if any(spans[k].static for k in (*contact.before, *contact.after)):
        return max(contact.gain, 1e3)
    part, chosen = solution.story.excerpt(number)
    rows = np.isin(owner, chosen)
    if contact.kind != "ball" and min(int((owner == k).sum()) for k in chosen) <= 1:
        return refine(solution.story.without(number), data, table, iterations=10, start=solution).chi2 - solution.chi2
    if rows.sum() < 3:
        return max(contact.gain, 1e3)
    local = Data(data.ball[rows], data.t[rows], data.xy[rows], data.whiten[rows])
    whole = part.without(0)
    states = [_joined(solution, part, local, k) for k in range(len(contact.before))]
    whole = Story(tuple(replace(s, state=state) for s, state in zip(whole.spans, states, strict=True)), ())
    split = refine(part, local, table, iterations=12, start=solution)
    joined = min(refine(w, local, table, iterations=12, start=solution).chi2 for w in (whole, part.without(0)))
    return joined - split.chi2


def _joined(solution: Solution, part: Story, local: Data, k: int) -> FloatArray:
    """First guess of the state of a span without the contact at its end: straight through its samples."""
    span = part.spans[k]
    rows = local.ball == span.ball
    t, xy = local.t[rows] - span.t0, local.xy[rows]
    if len(t) < 3:
        return span.state
    line = np.polynomial.polynomial.polyfit(t, xy, 2 if len(t) > 3 else 1)
    state = span.state.copy()
    state[:4] = [*line[0], *line[1]]
    state[4:6] = 0.05 * line[1]
    return state


def _paired(solution: Solution, story: Story, data: Data, table: Table) -> Story:
    """Balls that start or turn without a cause while another one passes: they met."""
    if story is not solution.story:
        return story
    interval = interval_of(data)
    for number, contact in enumerate(story.contacts):
        if contact.kind == "strike":
            shorter = _without_double_start(story, data, number, interval) or _one_strike(
                solution, data, number, interval, table
            )
            if shorter is not None:
                return shorter
        if contact.kind not in ("strike", "free"):
            continue
        met = _passer(solution, contact, table, interval)
        if met is not None:
            return _joined_contact(solution, number, met, table)
    return story


def _vanished(solution: Solution, story: Story, data: Data, table: Table) -> Story:
    """Balls at rest that are gone once another one has come: they were hit, and were too fast to be seen again."""
    if story is not solution.story:
        return story
    times = np.unique(data.t)
    interval = float(np.median(np.diff(times)))
    for ball in np.unique(data.ball):
        k = story.of_ball(int(ball))[-1]
        gone = float(data.t[data.ball == ball].max()) + 0.5 * interval
        if not story.spans[k].static or story.spans[k].end is not None or gone > times[-1] - 1.5 * interval:
            continue
        probe = Contact("free", gone, (k,), (k,))
        met = _passer(solution, probe, table, interval)
        if met is not None:
            return _hit_away(solution, k, met)
    return story


def _hit_away(solution: Solution, resting: int, met: tuple[int, float]) -> Story:
    """The resting ball leaves along the line of centres with what the other one brings."""
    story, (k, t) = solution.story, met
    end = story.spans[k].end
    ends_here = end is not None and story.contacts[end].kind == "free" and story.finish(k) - t < NEAR_THE_END
    if ends_here:
        t = story.finish(k)
    elif min(t - story.begin(k), story.finish(k) - t) < 2e-3:
        return story
    moving = kinematics(story.spans[k].state[None], np.array([t - story.begin(k)]), solution.friction)[0]
    place = story.spans[resting].state
    line = place[:2] - moving[:2]
    line /= np.hypot(*line)
    given = 0.95 * max(float(moving[2:4] @ line), SLOW) * line
    if ends_here and end is not None:
        grown = story.split(
            Contact("free", t, (resting,), ()), (np.concatenate([place[:2], given, given, np.zeros(2)]),)
        )
        one, two = grown.contacts[-1], grown.contacts[end]
        hit = Contact("ball", t, (*one.before, *two.before), (*one.after, *two.after), gain=max(100.0, two.gain))
        return grown.merged(end, len(grown.contacts) - 1, hit)
    states = (np.concatenate([place[:2], given, given, np.zeros(2)]), np.concatenate([moving, np.zeros(2)]))
    states[1][2:6] -= np.tile(given, 2)
    return story.split(Contact("ball", t, (resting, k), (), gain=100.0), states)


def _without_double_start(story: Story, data: Data, number: int, interval: float) -> Story | None:
    """A ball that is hit by another one was not struck within the picture before."""
    first = story.contacts[number].after[0]
    end = story.spans[first].end
    if end is None or story.contacts[end].kind != "ball":
        return None
    hit = story.contacts[end]
    others = [k for k in hit.before if k != first]
    rested = all(story.spans[k].static for k in story.contacts[number].before)
    ran = not any(story.spans[k].static for k in others)
    seen = (data.ball == story.spans[first].ball) & (data.t > story.begin(first)) & (data.t < hit.t)
    if rested and ran and (seen.sum() <= 1 or hit.t - story.contacts[number].t < 1.5 * interval):
        return story.without(number)
    return None


def _one_strike(solution: Solution, data: Data, number: int, interval: float, table: Table) -> Story | None:
    """A cue pushes for a moment: a second change of velocity within the next picture is the same strike."""
    story = solution.story
    first = story.contacts[number].after[0]
    end = story.spans[first].end
    if end is None or story.contacts[end].kind != "free" or story.finish(first) - story.begin(first) > 2.2 * interval:
        return None
    seen = (data.ball == story.spans[first].ball) & (data.t > story.begin(first)) & (data.t < story.finish(first))
    way = np.linalg.norm(end_state(solution, first)[:2] - story.spans[first].state[:2])
    onward = not story.spans[story.contacts[end].after[0]].static
    if seen.sum() > 1 or way > table.ball_radius or not onward:
        return None
    shorter = story.without(number)
    place = end if end < number else end - 1
    contacts = tuple(replace(c, kind="strike") if k == place else c for k, c in enumerate(shorter.contacts))
    return Story(shorter.spans, contacts)


def _passer(solution: Solution, contact: Contact, table: Table, interval: float) -> tuple[int, float] | None:
    """The span of another ball that comes within touch at a contact, and when."""
    story = solution.story
    place = story.spans[contact.after[0]].state[:2]
    best: tuple[float, int, float] | None = None
    for k, span in enumerate(story.spans):
        if span.static or span.ball == story.spans[contact.before[0]].ball:
            continue
        begin, end = max(story.begin(k), contact.t - 1.5 * interval), min(story.finish(k), contact.t + 1.5 * interval)
        if end - begin < 1e-3:
            continue
        t = np.linspace(begin, end, 61)
        path = kinematics(np.repeat(span.state[None], len(t), axis=0), t - story.begin(k), solution.friction)
        miss = np.abs(np.linalg.norm(path[:, :2] - place, axis=1) - 2 * table.ball_radius)
        # the moment of touch nearest to the known one
        cost = miss / (TOUCHING * table.ball_radius) + 0.5 * np.abs(t - contact.t) / interval
        least = int(np.argmin(cost))
        speed = float(np.hypot(*path[least, 2:4]))
        inner = 0 < least < len(t) - 1 or abs(t[least] - contact.t) < 1.5 * interval
        if (
            miss[least] < TOUCHING * table.ball_radius
            and inner
            and speed > SLOW
            and (best is None or cost[least] < best[0])
        ):
            best = (float(cost[least]), k, float(t[least]))
    return None if best is None else (best[1], best[2])


def _joined_contact(solution: Solution, number: int, met: tuple[int, float], table: Table) -> Story:
    """One contact of two balls in the place of a break of one of them."""
    story, (k, t) = solution.story, met
    contact = story.contacts[number]
    span = story.spans[k]
    near_start = span.start is not None and t - story.begin(k) < 2e-3
    near_end = span.end is not None and story.finish(k) - t < 2e-3
    other = span.start if near_start else span.end if near_end else None
    if other is not None:
        partner = story.contacts[other]
        if partner.kind not in ("free", "strike") or other == number:
            return story
        joined = Contact("ball", contact.t, (*contact.before, *partner.before), (*contact.after, *partner.after))
        return story.merged(number, other, replace(joined, gain=contact.gain + partner.gain))
    at = kinematics(span.state[None], np.array([t - story.begin(k)]), solution.friction)[0]
    change = story.spans[contact.after[0]].state[2:4] - end_state(solution, contact.before[0])[2:4]
    after = np.concatenate([at, np.zeros(2)])
    after[2:4] -= change
    after[4:6] -= change
    grown = story.split(Contact("free", t, (k,), (), gain=contact.gain), (after,))
    last = len(grown.contacts) - 1
    fresh = grown.contacts[last]
    joined = Contact("ball", t, (*contact.before, *fresh.before), (*contact.after, *fresh.after), gain=contact.gain)
    return grown.merged(number, last, joined)
