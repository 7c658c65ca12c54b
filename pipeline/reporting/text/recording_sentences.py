"""Sentences about the shots of a recording: which one was used, and which there are besides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ShotSpan:
    """A shot of a recording."""

    number: int
    """From 1."""
    first: int
    last: int
    """Its last frame."""
    begins: float
    """s"""
    ends: float
    """s"""
    has_motion: bool


def format_used_span(shot: ShotSpan, count: int, duration: float, is_default: bool) -> str:
    """Say which seconds of a recording are used, and why.

    Args:
        shot: The shot that is used.
        count: Number of shots of the recording.
        duration: Length of the recording, s.
        is_default: Whether the user asked for no particular shot.

    Returns:
        A sentence without a full stop.
    """
    if count == 1:
        why = "the only shot" if shot.has_motion else "the longest view, in which nothing moves"
    else:
        why = f"the longest of {count} shots" if is_default else f"shot {shot.number} of {count}"
    return f"{_format_span(shot)} of {duration:.2f} s are used, frames {shot.first} to {shot.last}: {why}"


def format_other_shot(shot: ShotSpan) -> str:
    """Offer another shot of the recording.

    Args:
        shot: The other shot.

    Returns:
        Its seconds, and the options that choose it.
    """
    middle = (shot.begins + shot.ends) / 2
    return f"shot {shot.number}, {_format_span(shot)}: --shot {shot.number} or --at {middle:.1f}"


def _format_span(shot: ShotSpan) -> str:
    return f"seconds {shot.begins:.2f} to {shot.ends:.2f}"
