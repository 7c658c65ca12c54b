"""Course of each shot in a contact graph: the struck ball, its segments until the next strike, and its first ball."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from models.core.contact_graph import ContactGraph


@dataclass(frozen=True, slots=True)
class FirstMeeting:
    """First contact of the struck ball with another one; all numbers are indices of segments."""

    other: int
    """Index of the other ball."""
    contact: int
    cue_before: int
    cue_after: int
    other_before: int
    other_after: int


@dataclass(frozen=True, slots=True)
class ShotCourse:
    """One shot, from its strike to the next."""

    cue: int
    """Index of the struck ball."""
    is_struck: bool
    """Whether the clip shows the strike."""
    begin: float
    """s."""
    end: float
    """s, the next strike; infinite for the last shot."""
    segments: dict[int, tuple[int, ...]]
    """Moving segments of each ball that begin in this time, in the order of time."""
    meeting: FirstMeeting | None
    """None if the struck ball meets no other, or a rack."""


def list_shot_courses(
    graph: ContactGraph, cue: int | None, is_stroke: Callable[[int, float], bool], moving: Collection[int] = ()
) -> tuple[ShotCourse, ...]:
    """List the shots of a clip.

    Args:
        graph: Contact graph of the clip.
        cue: Index of the cue ball, which was struck before the clip where it moves from the start; None if unknown.
        is_stroke: Whether a ball was struck at a time, s, by the events: a start may be that of a rack that bursts.
        moving: Indices of the balls that move when they are first detected.

    Returns:
        Shots by time. Where the clip begins in motion, the first shot has no strike. None where nothing moves.
    """
    struck = [
        k
        for k, one in enumerate(graph.segments)
        if not one.static
        and (start := graph.segments[k].start) is not None
        and graph.contacts[start].kind == "strike"
        and is_stroke(graph.segments[k].ball, graph.contacts[start].t)
    ]
    begun = [k for k, one in enumerate(graph.segments) if one.start is None and not one.static and one.ball in moving]
    begun.sort(key=lambda k: (graph.segments[k].ball != cue, graph.start_time(k)))
    starts = sorted(struck, key=graph.start_time)
    if begun and (not starts or graph.start_time(starts[0]) > min(map(graph.start_time, begun)) + 1e-9):
        starts = [begun[0], *starts]
    times = [graph.start_time(k) for k in starts]
    return tuple(
        _follow_shot(graph, k, begin, end)
        for k, begin, end in zip(starts, times, [*times, float("inf")][1:], strict=True)
    )


def _follow_shot(graph: ContactGraph, first: int, begin: float, end: float) -> ShotCourse:
    own: dict[int, tuple[int, ...]] = {}
    for ball in sorted({one.ball for one in graph.segments}):
        rows = [
            k
            for k in graph.segments_of_ball(ball)
            if not graph.segments[k].static and begin - 1e-9 <= graph.start_time(k) < end
        ]
        if rows:
            own[ball] = tuple(rows)
    start, cue = graph.segments[first].start, graph.segments[first].ball
    return ShotCourse(cue, start is not None, begin, end, own, _find_meeting(graph, own.get(cue, ())))


def _find_meeting(graph: ContactGraph, segments: tuple[int, ...]) -> FirstMeeting | None:
    for k in segments:
        number = graph.segments[k].end
        if number is None:
            return None
        contact = graph.contacts[number]
        if contact.kind == "break":
            return None
        if contact.kind == "ball" and len(contact.before) == 2:
            place = contact.before.index(k)
            other = contact.before[1 - place]
            return FirstMeeting(
                graph.segments[other].ball, number, k, contact.after[place], other, contact.after[1 - place]
            )
    return None
