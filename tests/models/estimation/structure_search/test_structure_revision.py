"""Revisions of the contact graph: which ball a velocity change without a cause may have met."""

from __future__ import annotations

import numpy as np
import pytest
from support.filmed_shots import RADIUS, scene

from models.core.contact_graph import ClothFriction, Contact, ContactGraph, JointSolution, Segment
from models.core.typing import FloatArray
from models.estimation.structure_search import structure_revision


def state(x: float, y: float, v_x: float, v_y: float) -> FloatArray:
    return np.array([x, y, v_x, v_y, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("radii", "meets"), [(2.0, True), (2.42, True), (2.58, False)])
def test_a_ball_that_passes_within_half_a_radius_of_touching_may_be_the_cause(radii: float, meets: bool) -> None:
    """Tracks of fast balls err by as much between two frames."""
    segments = (
        Segment(0, False, None, 0, 0.0, state(0.7, 0.6, 1.0, 0.0)),
        Segment(0, False, 0, None, 0.5, state(1.2, 0.6, 0.5, -0.5)),
        Segment(1, False, None, None, 0.0, state(0.96, 0.6 + radii * RADIUS, 0.5, 0.0)),
    )
    contact = Contact("free", 0.5, (0,), (1,))
    solution = JointSolution(
        ContactGraph(segments, (contact,)),
        ClothFriction(0.2, 0.01),
        1.0,
        np.zeros(4),
        np.zeros(3),
        0.0,
        np.empty((0, 0)),
    )
    found = structure_revision._find_passing_segment(solution, contact, scene().table, 1 / 30)
    assert (found is not None) == meets
    assert found is None or (found[0] == 2 and abs(found[1] - 0.5) < 0.05)
