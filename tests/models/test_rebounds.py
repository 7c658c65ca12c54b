"""Second thoughts about cushions stand whatever else was reconsidered before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from filmed_shots import RADIUS, scene

from models.billiards.motion import Friction
from models.fitting.rebounds import doubled
from models.fitting.solution import Solution
from models.fitting.story import Contact, Span, Story


def corner() -> Solution:
    """A ball that turns at the left cushion and, within the same picture, at the top one; and a strike before."""
    inside = RADIUS + 1e-4
    states = [np.array([*place, *v, *np.zeros(4)]) for place, v in (
        ((0.3, 0.3), (0.0, 0.0)), ((0.3, 0.3), (-1.0, -1.0)), ((inside, inside), (0.8, 0.8)),
    )]  # fmt: skip
    spans = (
        Span(0, True, None, 0, 0.0, states[0]), Span(0, False, 0, 1, 0.1, states[1]),
        Span(0, False, 1, None, 0.4, states[2]),
    )  # fmt: skip
    contacts = (Contact("strike", 0.1, (0,), (1,)), Contact("cushion", 0.4, (1,), (2,), "left"))
    friction = Friction(0.2, 0.01)
    return Solution(Story(spans, contacts), friction, 1.0, np.zeros(4), np.zeros(3), 0.0, np.empty((0, 0)))


def test_a_corner_holds_two_contacts() -> None:
    solution, table = corner(), scene().table
    story = doubled(solution, solution.story, table)
    assert sorted(c.cushion for c in story.contacts) == ["", "left", "top"]


def test_a_story_that_was_shortened_meanwhile_is_left_alone() -> None:
    solution, table = corner(), scene().table
    shorter = solution.story.without(0)
    assert doubled(solution, shorter, table) == shorter
    nothing = replace(shorter, contacts=())
    assert doubled(solution, nothing, table) == nothing
