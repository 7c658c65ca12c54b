"""Stories told by hand of filmed shots, refined: where second thoughts about them begin."""

from __future__ import annotations

import numpy as np
from support.filmed_shots import Filmed

from models.estimation.joint_fit.fit_solution import Data, Solution, gather
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.segmentation.contact_graph import Contact, Span, Story

PRICES = (20.0, 150.0)
"""Of contacts with a cause and without."""


def resting(ball: int, place: tuple[float, float], end: int | None) -> Span:
    """From the beginning of the clip until contact `end`."""
    return Span(ball, True, None, end, 0.0, np.array([*place, *np.zeros(6)]))


def moving(
    ball: int, start: int, end: int | None, t: float, place: tuple[float, float], v: tuple[float, float]
) -> Span:
    """From contact `start` at t (s) on; it rolls."""
    return Span(ball, False, start, end, t, np.array([*place, *v, 0.1 * v[0], 0.1 * v[1], 0.0, 0.0]))


def refined(shot: Filmed, spans: list[Span], contacts: list[Contact]) -> tuple[Solution, Data]:
    """The best solution of a story, and what was seen."""
    data = gather(shot.tracks)
    return refine(Story(tuple(spans), tuple(contacts)).with_pushes(), data, shot.scene.table), data


def named(solution: Solution) -> list[tuple[str, ...]]:
    """Kinds of the contacts of a story with who takes part, in the order of time."""
    story = solution.story
    return [
        (one.kind, *sorted(map(str, story.balls_at(one))), *([one.cushion] if one.cushion else []))
        for one in sorted(story.contacts, key=lambda one: one.t)
    ]
