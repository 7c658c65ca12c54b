"""What a contact sets off within a picture is told with it."""

from __future__ import annotations

import numpy as np
from support.contact_graphs import PRICES, moving, named, refined, resting
from support.filmed_shots import DELAY, RADIUS, Filmed, film

from models.estimation.joint_fit.fit_solution import Data, Solution
from models.estimation.segmentation.contact_graph import Contact
from models.estimation.structure_search.ball_encounters import Answers, total_cost
from models.estimation.structure_search.contact_chains import with_rows
from models.estimation.structure_search.contact_removal import released


def onto_a_pair(seed: int, told: int) -> tuple[Filmed, Solution, Data]:
    """Ball 0 runs into 1, which all but touches 2. As it is told, 0 meets ball `told`, and the other one is set off by
    nothing."""
    pitch = 2 * RADIUS + 2e-4
    x = np.array([[0.6, 0.6], [1.0, 0.6], [1.0 + pitch, 0.6]])
    v = np.array([[1.5, 0.0], [0.0, 0.0], [0.0, 0.0]])
    rolling = np.array([[0.0, 1.5 / RADIUS, 0.0], np.zeros(3), np.zeros(3)])
    shot = film(x, v, rolling, np.random.default_rng(seed), noise_px=0.5, seconds=2.0)
    t = min(t for t, kind, _, _ in shot.contacts if kind == "ball")
    other = 3 - told
    speeds = {1: (0.05, 0.0), 2: (1.3, 0.0)}
    spans = [
        resting(0, (0.6, 0.6), 0), moving(0, 0, 1, DELAY, (0.6, 0.6), (1.5, 0.0)),
        moving(0, 1, None, t, (1.0 - 2 * RADIUS, 0.6), (0.03, 0.0)),
        resting(told, tuple(x[told]), 1), moving(told, 1, None, t, tuple(x[told]), speeds[told]),
        resting(other, tuple(x[other]), 2), moving(other, 2, None, t + 1e-3, tuple(x[other]), speeds[other]),
    ]  # fmt: skip
    contacts = [
        Contact("strike", DELAY, (0,), (1,)), Contact("ball", t, (1, 3), (2, 4)),
        Contact("strike", t + 1e-3, (5,), (6,)),
    ]  # fmt: skip
    return shot, *refined(shot, spans, contacts)


def test_the_last_of_a_row_is_sent_off_by_the_one_before() -> None:
    shot, solution, data = onto_a_pair(1, 1)
    found = with_rows(solution, data, shot.scene.table, PRICES, Answers())
    assert named(found) == [("strike", "0"), ("ball", "0", "1"), ("ball", "1", "2")]
    assert total_cost(found, PRICES) < total_cost(solution, PRICES)


def test_a_row_that_is_told_is_not_told_again() -> None:
    shot, solution, data = onto_a_pair(2, 1)
    found = with_rows(solution, data, shot.scene.table, PRICES, Answers())
    assert with_rows(found, data, shot.scene.table, PRICES, Answers()) is found


def test_a_contact_with_the_wrong_ball_is_let_go() -> None:
    shot, solution, data = onto_a_pair(3, 2)
    found = released(solution, data, shot.scene.table, PRICES, Answers())
    assert ("ball", "0", "2") in named(solution)
    assert ("ball", "0", "2") not in named(found)
    assert total_cost(found, PRICES) < total_cost(solution, PRICES)


def test_a_right_contact_is_kept_and_not_asked_for_twice() -> None:
    shot, solution, data = onto_a_pair(4, 1)
    found = with_rows(solution, data, shot.scene.table, PRICES, Answers())
    asked = Answers()
    assert released(found, data, shot.scene.table, PRICES, asked) is found
    known = len(asked.needed)
    assert released(found, data, shot.scene.table, PRICES, asked) is found
    assert len(asked.needed) == known
