"""Contact graph of a shot: segments of motion, joined by contacts; and the solution of its joint fit."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray

# `free`: a velocity change without a known cause nearby; `jump`: a path that does not continue where it ended, because
# frames are missing or something else was tracked; `break`: the last contact of a ball in a simulated break shot.
ContactKind = Literal["strike", "ball", "cushion", "free", "jump", "break"]
# Kinds of contacts that another ball may have caused.
CAUSELESS_KINDS = ("strike", "free", "jump")


@dataclass(frozen=True, slots=True)
class Segment:
    """Motion of one ball between two contacts."""

    ball: int
    static: bool
    start: int | None
    """Contact that begins it; None at the start of the track."""
    end: int | None
    """Contact that ends it; None at the end of the track."""
    t0: float
    """s: start of the track where `start` is None; else an initial guess, since the contact's time counts."""
    state: FloatArray
    """(8,) at the start, see `models.physics.billiards.cloth.closed_form_motion`."""


@dataclass(frozen=True, slots=True)
class Contact:
    """One moment at which the velocities of one or two balls change."""

    kind: ContactKind
    t: float
    before: tuple[int, ...]
    """Segments that end here, one per ball involved."""
    after: tuple[int, ...]
    """Segments that begin here, in the same order."""
    cushion: str = ""
    driven: bool = False
    """The balls touched while one of them was struck: momentum is not conserved."""
    pushed: bool = False
    """A strike that no cue can have caused, since other balls move: the spin is kept as in a contact of balls."""
    gain: float = 0.0
    """chi2 that the contact improves, over one segment without it."""
    break_start: float = field(default=np.nan, compare=False)
    """s, of a break: the ball's first contact, where t is its last."""
    exit_state: FloatArray = field(default_factory=lambda: np.zeros(6), compare=False)
    """(6,) place, velocity and slip with which the ball leaves a simulated break."""
    exit_whitening: FloatArray = field(default_factory=lambda: np.zeros((6, 6)), compare=False)
    """(6, 6): takes the deviation from `exit_state` to standard deviations."""


@dataclass(frozen=True, slots=True)
class ContactGraph:
    """All segments and contacts; indices point into the tuples."""

    segments: tuple[Segment, ...]
    contacts: tuple[Contact, ...]

    def segments_of_ball(self, ball: int) -> list[int]:
        """Return the segments of a ball in the order of time."""
        rows = [k for k, segment in enumerate(self.segments) if segment.ball == ball]
        return sorted(rows, key=self.start_time)

    def balls_at(self, contact: Contact) -> set[int]:
        """Return the balls that take part in a contact."""
        return {self.segments[k].ball for k in contact.before}

    def start_time(self, segment: int) -> float:
        """Return the start of a segment, s."""
        start = self.segments[segment].start
        return self.segments[segment].t0 if start is None else self.contacts[start].t

    def end_time(self, segment: int) -> float:
        """Return the end of a segment, s; infinite where it runs to the end of the track."""
        end = self.segments[segment].end
        return np.inf if end is None else self.contacts[end].t

    def cache_key(self, segments: Iterable[int]) -> tuple[Hashable, ...]:
        """Return a rounded description of some segments, equal for graphs with the same fit."""
        return tuple(
            (
                self.segments[k].ball,
                self.segments[k].static,
                round(self.start_time(k), 4),
                round(self.end_time(k), 4),
                *np.round(self.segments[k].state[:4], 3).tolist(),
            )
            for k in segments
        )

    def mark_pushed_strikes(self) -> ContactGraph:
        """Mark the strikes that no cue can have caused: none strikes while balls move."""
        runs = [
            (self.start_time(k), self.end_time(k), segment.ball)
            for k, segment in enumerate(self.segments)
            if not segment.static
        ]
        contacts = []
        for one in self.contacts:
            ball = self.segments[one.before[0]].ball
            pushed = any(begin < one.t < end and other != ball for begin, end, other in runs)
            contacts.append(replace(one, pushed=pushed and one.kind == "strike"))
        return ContactGraph(self.segments, tuple(contacts))

    def remove_contact(self, contact: int) -> ContactGraph:
        """Remove a contact: every segment before it continues."""
        removed = self.contacts[contact]
        successor = dict(zip(removed.after, removed.before, strict=True))
        keep = [k for k in range(len(self.segments)) if k not in successor]
        order = {old: new for new, old in enumerate(keep)}
        order |= {old: order[predecessor] for old, predecessor in successor.items()}
        ends = {predecessor: self.segments[old].end for old, predecessor in successor.items()}

        def earlier(index: int | None) -> int | None:
            return index if index is None or index < contact else index - 1

        segments = []
        for k in keep:
            segment = self.segments[k]
            segments.append(replace(segment, start=earlier(segment.start), end=earlier(ends.get(k, segment.end))))
        contacts = [
            replace(c, before=tuple(order[k] for k in c.before), after=tuple(order[k] for k in c.after))
            for i, c in enumerate(self.contacts)
            if i != contact
        ]
        return ContactGraph(tuple(segments), tuple(contacts))

    def replace_contact(self, number: int, contact: Contact) -> ContactGraph:
        """Replace a contact by one that joins the same segments."""
        return ContactGraph(self.segments, (*self.contacts[:number], contact, *self.contacts[number + 1 :]))

    def replace_segment(self, k: int, segment: Segment) -> ContactGraph:
        """Replace a segment by one that joins the same contacts."""
        return ContactGraph((*self.segments[:k], segment, *self.segments[k + 1 :]), self.contacts)

    def insert_contact(self, contact: Contact, states: tuple[FloatArray, ...]) -> ContactGraph:
        """Insert a contact that cuts the segments `contact.before`; `states` (8,) are those after it.

        `contact.after` is ignored: the new segments get indices of their own.
        """
        segments, contacts, number = list(self.segments), list(self.contacts), len(self.contacts)
        after = []
        for k, state in zip(contact.before, states, strict=True):
            old = segments[k]
            new_index = len(segments)
            after.append(new_index)
            static = not bool(np.any(state[2:6]))
            segments.append(Segment(old.ball, static, number, old.end, contact.t, state))
            segments[k] = replace(old, end=number)
            if old.end is not None:
                next_one = contacts[old.end]
                contacts[old.end] = replace(next_one, before=tuple(new_index if q == k else q for q in next_one.before))
        contacts.append(replace(contact, after=tuple(after)))
        return ContactGraph(tuple(segments), tuple(contacts))

    def merge_contacts(self, keep: int, drop: int, contact: Contact) -> ContactGraph:
        """Replace the contacts `keep` and `drop` by `contact`; later ones move up by one."""

        def place(index: int | None) -> int | None:
            return None if index is None else index_after_merge(index, keep, drop)

        segments = tuple(
            replace(segment, start=place(segment.start), end=place(segment.end)) for segment in self.segments
        )
        contacts = [contact if k == keep else c for k, c in enumerate(self.contacts) if k != drop]
        return ContactGraph(segments, tuple(contacts))

    def select_segments(self, selection: list[int]) -> ContactGraph:
        """Select some segments, in this order, and the contacts that join no others."""
        place = {k: number for number, k in enumerate(selection)}
        inside = [i for i, c in enumerate(self.contacts) if place.keys() >= {*c.before, *c.after}]
        order = {i: number for number, i in enumerate(inside)}
        segments = [
            replace(
                self.segments[k], t0=self.start_time(k),
                start=None if (first := self.segments[k].start) is None else order.get(first),
                end=None if (last := self.segments[k].end) is None else order.get(last),
            )
            for k in selection
        ]  # fmt: skip
        contacts = [
            replace(c, before=tuple(place[k] for k in c.before), after=tuple(place[k] for k in c.after))
            for c in (self.contacts[i] for i in inside)
        ]
        return ContactGraph(tuple(segments), tuple(contacts))

    def extract_contact(self, contact: int) -> tuple[ContactGraph, tuple[int, ...]]:
        """Extract the segments that meet at a contact, as contact 0, and return their indices here."""
        one = self.contacts[contact]
        chosen = (*one.before, *one.after)
        segments = []
        for k in chosen:
            segment = self.segments[k]
            segments.append(
                replace(
                    segment,
                    start=0 if segment.start == contact else None,
                    end=0 if segment.end == contact else None,
                    t0=self.start_time(k),
                )
            )
        count = len(one.before)
        local = replace(one, before=tuple(range(count)), after=tuple(range(count, 2 * count)))
        return ContactGraph(tuple(segments), (local,)), chosen


def index_after_merge(contact: int, keep: int, drop: int) -> int:
    """Return the index of a contact after `ContactGraph.merge_contacts`.

    Args:
        contact: Index before the merge.
        keep: Index of the merged contact before the merge.
        drop: Index of the contact that was dropped.

    Returns:
        Index after the merge.
    """
    target = keep if contact == drop else contact
    return target - 1 if target > drop else target


# Numbers at the start of a segment, see `models.physics.billiards.cloth.closed_form_motion`.
SEGMENT_STATE_SIZE = 8


@dataclass(frozen=True, slots=True)
class ClothFriction:
    """Coefficients of friction of the cloth; decelerations are mu g."""

    sliding: float
    rolling: float


@dataclass(frozen=True, slots=True)
class Observations:
    """Observed places, one row per observation, sorted by ball and time."""

    ball: IntArray
    t: FloatArray
    xy: FloatArray
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""

    @property
    def frame_interval(self) -> float:
        """Median time between two frames, s."""
        return float(np.median(np.diff(np.unique(self.t))))

    def select_rows(self, rows: BoolArray) -> Observations:
        """Return the observations of a mask (K,)."""
        return Observations(self.ball[rows], self.t[rows], self.xy[rows], self.whiten[rows])


@dataclass(frozen=True, slots=True)
class JointSolution:
    """A refined contact graph."""

    graph: ContactGraph
    friction: ClothFriction
    diameter_factor: float
    """Factor on two radii."""
    nose_offsets: FloatArray
    """(4,) m, distance of the contact line from one radius inside each nose; > 0 towards the table."""
    rubber: FloatArray
    """(3,) of all cushions: restitution of a slow ball, its change with speed in s/m, and grip: how far the nose stops
    the spin about the line of the cushion, 0 not at all, 1 until it does not slip.
    """
    chi2: float
    """Robust, with pseudo-observations."""
    covariance: FloatArray
    """(P, P) of the packed parameters, see `ParameterLayout`; empty until `joint_refinement.add_covariance` adds it."""


@dataclass(frozen=True, slots=True)
class ParameterLayout:
    """Columns of the packed parameters."""

    segment: IntArray
    """(S,) first column; a static segment has two parameters, a moving one eight."""
    contact: int
    """Column of the time of the first contact."""
    shared: int
    """First column of ln mu_sliding, ln mu_rolling, diameter, four noses, three of the rubber."""
    size: int


# Parameters that all segments and contacts share.
SHARED_COUNT = 10


def layout_parameters(graph: ContactGraph) -> ParameterLayout:
    """Lay out the packed parameters of a contact graph.

    Args:
        graph: The contact graph.

    Returns:
        Columns of its parameters.
    """
    sizes = np.array([2 if segment.static else SEGMENT_STATE_SIZE for segment in graph.segments], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    contact = int(starts[-1])
    return ParameterLayout(
        starts[:-1], contact, contact + len(graph.contacts), contact + len(graph.contacts) + SHARED_COUNT
    )
