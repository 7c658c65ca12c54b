"""What is thought to have happened in a clip: spans of motion, and the contacts between them."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from models.core.typing import FloatArray

ContactKind = Literal["strike", "ball", "cushion", "free", "jump", "burst"]
"""`free`: a ball changed its velocity and nothing known was near; `jump`: its path does not go on where it ended,
because pictures are missing or something else was followed; `burst`: what a ball met together with many others was
played, and it goes on from there."""


@dataclass(frozen=True, slots=True)
class Span:
    """One ball between two contacts."""

    ball: int
    static: bool
    start: int | None
    """Contact that begins it; None at the start of the track."""
    end: int | None
    """Contact that ends it; None at the end of the track."""
    t0: float
    """s: start of the track where `start` is None; else a first guess, the contact's time counts."""
    state: FloatArray
    """(8,) at the start, see `models.physics.billiards.cloth.closed_form_motion.STATE`."""


@dataclass(frozen=True, slots=True)
class Contact:
    """One moment at which the velocities of one or two balls change."""

    kind: ContactKind
    t: float
    before: tuple[int, ...]
    """Spans that end here, one per ball involved."""
    after: tuple[int, ...]
    """Spans that begin here, in the same order."""
    cushion: str = ""
    driven: bool = False
    """Balls that touched while one of them was struck: momentum is not conserved."""
    pushed: bool = False
    """A strike that no cue can have given, since other balls move: it keeps the spin as contacts of balls do."""
    gain: float = 0.0
    """chi2 that the break improves, over one span without it."""
    since: float = field(default=np.nan, compare=False)
    """s, of a burst: its first contact, where t is its last."""
    leaves: FloatArray = field(default_factory=lambda: np.zeros(6), compare=False)
    """(6,) place, velocity and slip with which the ball leaves a burst, as it was played."""
    whiten: FloatArray = field(default_factory=lambda: np.zeros((6, 6)), compare=False)
    """Takes what another state (6,) is off to standard deviations of the play."""


@dataclass(frozen=True, slots=True)
class Story:
    """All spans and contacts; indices point into the tuples."""

    spans: tuple[Span, ...]
    contacts: tuple[Contact, ...]

    def of_ball(self, ball: int) -> list[int]:
        """Spans of a ball in the order of time."""
        rows = [k for k, span in enumerate(self.spans) if span.ball == ball]
        return sorted(rows, key=self.begin)

    def balls_at(self, contact: Contact) -> set[int]:
        """Who takes part in a contact."""
        return {self.spans[k].ball for k in contact.before}

    def begin(self, span: int) -> float:
        """s."""
        start = self.spans[span].start
        return self.spans[span].t0 if start is None else self.contacts[start].t

    def finish(self, span: int) -> float:
        """s; infinite where the span runs to the end of the track."""
        end = self.spans[span].end
        return np.inf if end is None else self.contacts[end].t

    def told(self, spans: Iterable[int]) -> tuple[Hashable, ...]:
        """What is told of some spans, to what matters: stories that differ by less ask the same of the samples."""
        return tuple(
            (
                self.spans[k].ball, self.spans[k].static, round(self.begin(k), 4), round(self.finish(k), 4),
                *np.round(self.spans[k].state[:4], 3).tolist(),
            )
            for k in spans
        )  # fmt: skip

    def with_pushes(self) -> Story:
        """The story in which every strike says whether it can be a cue's: none strikes while balls move."""
        runs = [(self.begin(k), self.finish(k), span.ball) for k, span in enumerate(self.spans) if not span.static]
        contacts = []
        for one in self.contacts:
            ball = self.spans[one.before[0]].ball
            pushed = any(begin < one.t < end and other != ball for begin, end, other in runs)
            contacts.append(replace(one, pushed=pushed and one.kind == "strike"))
        return Story(self.spans, tuple(contacts))

    def without(self, contact: int) -> Story:
        """The story in which `contact` did not happen: every span before it goes on."""
        gone = self.contacts[contact]
        successor = dict(zip(gone.after, gone.before, strict=True))
        keep = [k for k in range(len(self.spans)) if k not in successor]
        order = {old: new for new, old in enumerate(keep)}
        order |= {old: order[kept] for old, kept in successor.items()}
        ends = {kept: self.spans[old].end for old, kept in successor.items()}

        def earlier(index: int | None) -> int | None:
            return index if index is None or index < contact else index - 1

        spans = []
        for k in keep:
            span = self.spans[k]
            spans.append(replace(span, start=earlier(span.start), end=earlier(ends.get(k, span.end))))
        contacts = [
            replace(c, before=tuple(order[k] for k in c.before), after=tuple(order[k] for k in c.after))
            for i, c in enumerate(self.contacts)
            if i != contact
        ]
        return Story(tuple(spans), tuple(contacts))

    def split(self, contact: Contact, states: tuple[FloatArray, ...]) -> Story:
        """The story with one more contact, which cuts the spans `contact.before`; `states` (8,) are those after it.

        `contact.after` is ignored: the new spans get numbers of their own.
        """
        spans, contacts, number = list(self.spans), list(self.contacts), len(self.contacts)
        after = []
        for k, state in zip(contact.before, states, strict=True):
            old = spans[k]
            fresh = len(spans)
            after.append(fresh)
            static = not bool(np.any(state[2:6]))
            spans.append(Span(old.ball, static, number, old.end, contact.t, state))
            spans[k] = replace(old, end=number)
            if old.end is not None:
                next_one = contacts[old.end]
                contacts[old.end] = replace(next_one, before=tuple(fresh if q == k else q for q in next_one.before))
        contacts.append(replace(contact, after=tuple(after)))
        return Story(tuple(spans), tuple(contacts))

    def merged(self, keep: int, drop: int, contact: Contact) -> Story:
        """The story in which `contact` stands for the contacts `keep` and `drop`; later ones move up by one."""

        def place(index: int | None) -> int | None:
            return None if index is None else after_merging(index, keep, drop)

        spans = tuple(replace(span, start=place(span.start), end=place(span.end)) for span in self.spans)
        contacts = [contact if k == keep else c for k, c in enumerate(self.contacts) if k != drop]
        return Story(spans, tuple(contacts))

    def part(self, spans: list[int]) -> Story:
        """Only some spans, in this order, and the contacts that join no others."""
        place = {k: number for number, k in enumerate(spans)}
        inside = [i for i, c in enumerate(self.contacts) if place.keys() >= {*c.before, *c.after}]
        order = {i: number for number, i in enumerate(inside)}
        kept = [
            replace(
                self.spans[k], t0=self.begin(k),
                start=None if (first := self.spans[k].start) is None else order.get(first),
                end=None if (last := self.spans[k].end) is None else order.get(last),
            )
            for k in spans
        ]  # fmt: skip
        contacts = [
            replace(c, before=tuple(place[k] for k in c.before), after=tuple(place[k] for k in c.after))
            for c in (self.contacts[i] for i in inside)
        ]
        return Story(tuple(kept), tuple(contacts))

    def excerpt(self, contact: int) -> tuple[Story, tuple[int, ...]]:
        """Only the spans that meet at a contact, as contact 0, and their numbers here."""
        one = self.contacts[contact]
        chosen = (*one.before, *one.after)
        spans = []
        for k in chosen:
            span = self.spans[k]
            spans.append(
                replace(span, start=0 if span.start == contact else None, end=0 if span.end == contact else None,
                        t0=self.begin(k))
            )  # fmt: skip
        count = len(one.before)
        local = replace(one, before=tuple(range(count)), after=tuple(range(count, 2 * count)))
        return Story(tuple(spans), (local,)), chosen


def after_merging(contact: int, keep: int, drop: int) -> int:
    """Number of a contact once `keep` stands for `drop` as well, and later ones have moved up."""
    target = keep if contact == drop else contact
    return target - 1 if target > drop else target
