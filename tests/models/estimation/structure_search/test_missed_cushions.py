"""Revisions of cushion contacts hold whatever else was revised before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import fixed_step_table as truth
from support.contact_graphs import moving, resting, start_search
from support.filmed_shots import DELAY, RADIUS, film, scene

from models.core.contact_graph import ClothFriction, Contact, ContactGraph, JointSolution, Segment
from models.estimation.structure_search.missed_cushions import refit_rebounds, split_corner_contacts
from models.estimation.structure_search.structure_trials import StructureSearch


def corner() -> JointSolution:
    """A ball that turns at the left cushion and, within the same frame, at the top one; and a strike before."""
    inside = RADIUS + 1e-4
    states = [np.array([*place, *v, *np.zeros(4)]) for place, v in (
        ((0.3, 0.3), (0.0, 0.0)), ((0.3, 0.3), (-1.0, -1.0)), ((inside, inside), (0.8, 0.8)),
    )]  # fmt: skip
    segments = (
        Segment(0, True, None, 0, 0.0, states[0]), Segment(0, False, 0, 1, 0.1, states[1]),
        Segment(0, False, 1, None, 0.4, states[2]),
    )  # fmt: skip
    contacts = (Contact("strike", 0.1, (0,), (1,)), Contact("cushion", 0.4, (1,), (2,), "left"))
    friction = ClothFriction(0.2, 0.01)
    return JointSolution(
        ContactGraph(segments, contacts), friction, 1.0, np.zeros(4), np.zeros(3), 0.0, np.empty((0, 0))
    )


def test_a_corner_holds_two_contacts() -> None:
    solution, table = corner(), scene().table
    graph = split_corner_contacts(solution, solution.graph, table)
    assert sorted(c.cushion for c in graph.contacts) == ["", "left", "top"]


def test_a_graph_that_was_shortened_meanwhile_is_left_alone() -> None:
    solution, table = corner(), scene().table
    shorter = solution.graph.remove_contact(0)
    assert split_corner_contacts(solution, shorter, table) == shorter
    nothing = replace(shorter, contacts=())
    assert split_corner_contacts(solution, nothing, table) == nothing


def make_slow_rebound(seed: int, slip: float) -> tuple[JointSolution, StructureSearch]:
    """A slow ball off a nose that grips; in the graph it leaves with `slip` times its true slip."""
    start, v = np.array([[1.8, 0.4]]), np.array([[1.0, 0.25]])
    rolling = np.array([[-v[0, 1] / RADIUS, v[0, 0] / RADIUS, 0.0]])
    shot = film(start, v, rolling, np.random.default_rng(seed), noise_px=0.8, law=truth.GRIPPING, seconds=3.0)
    t = next(t for t, kind, _, _ in shot.contacts if kind == "cushion")
    segments = [
        resting(0, (1.8, 0.4), 0), moving(0, 0, 1, DELAY, (1.8, 0.4), (1.0, 0.25)),
        moving(0, 1, None, t, (2.51, 0.57), (-0.45, 0.2)),
    ]  # fmt: skip
    segments[2].state[4:6] = slip * np.array([-1.3, 0.0])
    contacts = [Contact("strike", DELAY, (0,), (1,)), Contact("cushion", t, (1,), (2,), "right")]
    return start_search(shot, segments, contacts)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_refitted_rebounds_reach_the_best_fit_from_a_wrong_rebound(seed: int) -> None:
    right, search = make_slow_rebound(seed, 1.0)
    altered, _ = make_slow_rebound(seed, 0.02)
    segments = list(altered.graph.segments)
    segments[2] = replace(segments[2], state=np.array([2.51, 0.57, -0.3, 0.2, 0.0, 0.0, 0.05, 0.0]))
    wrong = search.refine(ContactGraph(tuple(segments), altered.graph.contacts), altered, iterations=0)
    refitted = refit_rebounds(wrong, search)
    assert refitted.chi2 < wrong.chi2 - 100
    assert refitted.chi2 == pytest.approx(right.chi2, abs=0.5)
    assert refitted.graph.contacts[1].t == pytest.approx(right.graph.contacts[1].t, abs=5e-4)


def test_a_graph_without_cushions_has_no_rebounds_to_refit() -> None:
    solution, search = make_slow_rebound(4, 1.0)
    without = replace(solution, graph=solution.graph.remove_contact(1))
    assert refit_rebounds(without, search) is without
