"""Second thoughts about cushions stand whatever else was reconsidered before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import fixed_step_table as truth
from support.contact_graphs import moving, refined, resting
from support.filmed_shots import DELAY, RADIUS, Filmed, film, scene

from models.estimation.joint_fit.fit_solution import Data, Solution
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.segmentation.contact_graph import Contact, Span, Story
from models.estimation.structure_search.missed_cushions import doubled, with_rebounds_retold
from models.physics.billiards.cloth.closed_form_motion import Friction


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


def bounced(seed: int, slip: float) -> tuple[Filmed, Solution, Data]:
    """A slow ball off a nose that grips, told to leave with `slip` times the slip that it has."""
    start, v = np.array([[1.8, 0.4]]), np.array([[1.0, 0.25]])
    rolling = np.array([[-v[0, 1] / RADIUS, v[0, 0] / RADIUS, 0.0]])
    shot = film(start, v, rolling, np.random.default_rng(seed), noise_px=0.8, law=truth.GRIPPING, seconds=3.0)
    t = next(t for t, kind, _, _ in shot.contacts if kind == "cushion")
    spans = [
        resting(0, (1.8, 0.4), 0), moving(0, 0, 1, DELAY, (1.8, 0.4), (1.0, 0.25)),
        moving(0, 1, None, t, (2.51, 0.57), (-0.45, 0.2)),
    ]  # fmt: skip
    spans[2].state[4:6] = slip * np.array([-1.3, 0.0])
    contacts = [Contact("strike", DELAY, (0,), (1,)), Contact("cushion", t, (1,), (2,), "right")]
    return shot, *refined(shot, spans, contacts)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rebounds_retold_lead_to_the_best_fit_from_a_rebound_that_was_told_wrongly(seed: int) -> None:
    shot, right, data = bounced(seed, 1.0)
    _, told, _ = bounced(seed, 0.02)
    spans = list(told.story.spans)
    spans[2] = replace(spans[2], state=np.array([2.51, 0.57, -0.3, 0.2, 0.0, 0.0, 0.05, 0.0]))
    wrong = refine(Story(tuple(spans), told.story.contacts), data, shot.scene.table, iterations=0, start=told)
    found = with_rebounds_retold(wrong, data, shot.scene.table)
    assert found.chi2 < wrong.chi2 - 100
    assert found.chi2 == pytest.approx(right.chi2, abs=0.5)
    assert found.story.contacts[1].t == pytest.approx(right.story.contacts[1].t, abs=5e-4)


def test_a_story_without_cushions_has_no_rebounds_to_retell() -> None:
    shot, solution, data = bounced(4, 1.0)
    without = replace(solution, story=solution.story.without(1))
    assert with_rebounds_retold(without, data, shot.scene.table) is without
