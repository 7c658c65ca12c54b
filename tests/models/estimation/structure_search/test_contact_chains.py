"""Contacts that follow from one within a frame are inserted with it."""

from __future__ import annotations

import numpy as np
from support.contact_graphs import list_contact_names, moving, resting, start_search
from support.filmed_shots import DELAY, RADIUS, film

from models.core.contact_graph import Contact, JointSolution
from models.estimation.structure_search.ball_encounters import complete_chains, remove_false_contacts
from models.estimation.structure_search.structure_trials import StructureSearch


def onto_a_pair(seed: int, partner: int) -> tuple[JointSolution, StructureSearch]:
    """Ball 0 runs into 1, which almost touches 2. In the graph, 0 meets ball `partner`, and the other one starts
    without a cause.
    """
    pitch = 2 * RADIUS + 2e-4
    x = np.array([[0.6, 0.6], [1.0, 0.6], [1.0 + pitch, 0.6]])
    v = np.array([[1.5, 0.0], [0.0, 0.0], [0.0, 0.0]])
    rolling = np.array([[0.0, 1.5 / RADIUS, 0.0], np.zeros(3), np.zeros(3)])
    shot = film(x, v, rolling, np.random.default_rng(seed), noise_px=0.5, seconds=2.0)
    t = min(t for t, kind, _, _ in shot.contacts if kind == "ball")
    other = 3 - partner
    speeds = {1: (0.05, 0.0), 2: (1.3, 0.0)}
    segments = [
        resting(0, (0.6, 0.6), 0), moving(0, 0, 1, DELAY, (0.6, 0.6), (1.5, 0.0)),
        moving(0, 1, None, t, (1.0 - 2 * RADIUS, 0.6), (0.03, 0.0)),
        resting(partner, tuple(x[partner]), 1), moving(partner, 1, None, t, tuple(x[partner]), speeds[partner]),
        resting(other, tuple(x[other]), 2), moving(other, 2, None, t + 1e-3, tuple(x[other]), speeds[other]),
    ]  # fmt: skip
    contacts = [
        Contact("strike", DELAY, (0,), (1,)), Contact("ball", t, (1, 3), (2, 4)),
        Contact("strike", t + 1e-3, (5,), (6,)),
    ]  # fmt: skip
    return start_search(shot, segments, contacts)


def test_the_last_of_a_row_is_sent_off_by_the_one_before() -> None:
    solution, search = onto_a_pair(1, 1)
    result = complete_chains(solution, search)
    assert list_contact_names(result) == [("strike", "0"), ("ball", "0", "1"), ("ball", "1", "2")]
    assert search.cost(result) < search.cost(solution)


def test_a_complete_chain_is_not_inserted_again() -> None:
    solution, search = onto_a_pair(2, 1)
    result = complete_chains(solution, search)
    assert complete_chains(result, search.restart(search.observations)) is result


def test_a_contact_with_the_wrong_ball_is_removed() -> None:
    solution, search = onto_a_pair(3, 2)
    result = remove_false_contacts(solution, search)
    assert ("ball", "0", "2") in list_contact_names(solution)
    assert ("ball", "0", "2") not in list_contact_names(result)
    assert search.cost(result) < search.cost(solution)


def test_a_right_contact_is_kept_and_not_tried_twice() -> None:
    solution, search = onto_a_pair(4, 1)
    result = complete_chains(solution, search)
    again = search.restart(search.observations)
    assert remove_false_contacts(result, again) is result
    count = len(again.required)
    assert remove_false_contacts(result, again) is result
    assert len(again.required) == count
