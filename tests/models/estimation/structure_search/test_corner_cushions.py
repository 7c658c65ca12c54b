"""Two cushions within a frame or two are both found, and none that a ball never met."""

from __future__ import annotations

import numpy as np
import pytest
from support import fixed_step_table as truth
from support.contact_graphs import list_contact_names, moving, resting, start_search
from support.filmed_shots import DELAY, Filmed, film

from models.core.contact_graph import Contact, JointSolution
from models.estimation.structure_search.missed_cushions import insert_corner_cushions
from models.estimation.structure_search.structure_trials import StructureSearch


def into_a_corner(seed: int, beside: float, seconds: float = 2.5) -> tuple[Filmed, JointSolution, StructureSearch]:
    """A ball runs to the right cushion and, `beside` m farther on, to the top one; the graph has only the first of
    them.
    """
    start, v = np.array([[1.6, 0.6]]), np.array([[1.8, -1.2]])
    reach = (2.54 - 0.028575 - start[0, 0]) / v[0, 0]
    start[0, 1] = 0.028575 + beside - reach * v[0, 1]
    shot = film(
        start, v, np.zeros((1, 3)), np.random.default_rng(seed), noise_px=0.5, law=truth.MIRROR, seconds=seconds
    )
    t, place = DELAY + reach, (2.51, 0.028575 + beside)
    segments = [
        resting(0, tuple(start[0]), 0), moving(0, 0, 1, DELAY, tuple(start[0]), tuple(v[0])),
        moving(0, 1, None, t, place, (-1.3, 0.9)),
    ]  # fmt: skip
    contacts = [Contact("strike", DELAY, (0,), (1,)), Contact("cushion", t, (1,), (2,), "right")]
    return shot, *start_search(shot, segments, contacts)


@pytest.mark.parametrize("beside", [0.01, 0.03, 0.05])
def test_the_other_cushion_of_a_corner_is_found_in_its_time(beside: float) -> None:
    shot, solution, search = into_a_corner(1, beside)
    result = insert_corner_cushions(solution, search)
    assert list_contact_names(result) == [("strike", "0"), ("cushion", "0", "right"), ("cushion", "0", "top")]
    true = [t for t, kind, _, _ in shot.contacts if kind == "cushion"]
    times = sorted(one.t for one in result.graph.contacts if one.kind == "cushion")
    assert times == pytest.approx(true[:2], abs=4e-3)


def test_no_cushion_is_inserted_that_raises_the_total_cost() -> None:
    _, solution, search = into_a_corner(2, 0.04)
    result = insert_corner_cushions(solution, search)
    again = insert_corner_cushions(result, search)
    assert search.cost(result) < search.cost(solution)
    assert list_contact_names(again) == list_contact_names(result)


def test_a_ball_far_from_other_cushions_met_one_only() -> None:
    _, solution, search = into_a_corner(3, 0.6, 1.6)
    assert insert_corner_cushions(solution, search) is solution
