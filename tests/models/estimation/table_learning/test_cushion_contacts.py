"""States around a cushion contact: their errors, and what the joint fit assumes about rubber."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations, Segment, layout_parameters
from models.core.scene import Table
from models.estimation.joint_fit.joint_refinement import add_covariance, refine_graph
from models.estimation.table_learning.cushion_contacts import evaluate_segment_state, extract_cushion_contacts

R, NOISE, CONTACT_TIME = 0.03, 5e-4, 0.5
TABLE = Table("carom", "carom", 2.84, 1.42, R, 0.21, False)


def film_rebound(restitution: float, after_frames: int = 50) -> tuple[JointSolution, Observations]:
    """Fit a ball that rolls straight at the left cushion at 1 m/s and leaves it rolling, filmed at 100 Hz."""
    place, t = np.array([R + 0.5, 0.7]), np.arange(50 + after_frames) / 100
    x = np.where(t < CONTACT_TIME, place[0] - t, R + restitution * (t - CONTACT_TIME))
    xy = np.stack([x, np.full_like(x, place[1])], axis=1) + np.random.default_rng(2).normal(0, NOISE, (len(t), 2))
    states = [np.array([*place, -1.0, 0, 0, 0, 0, 0]), np.array([R, place[1], restitution, 0, 0, 0, 0, 0])]
    graph = ContactGraph(
        (Segment(0, False, None, 0, 0.0, states[0]), Segment(0, False, 0, None, CONTACT_TIME, states[1])),
        (Contact("cushion", CONTACT_TIME, (0,), (1,), "left"),),
    )
    whitening = np.broadcast_to(np.eye(2) / NOISE, (len(t), 2, 2)).copy()
    observations = Observations(np.zeros(len(t), np.int64), t, xy, whitening)
    return add_covariance(refine_graph(graph, observations, TABLE), observations, TABLE), observations


def test_the_state_at_a_contact_shares_the_error_of_its_time() -> None:
    solution, _ = film_rebound(0.85)
    layout, step = layout_parameters(solution.graph), 1e-5
    at, jacobian = evaluate_segment_state(solution, 0, solution.graph.contacts[0].t, 0)
    late, _ = evaluate_segment_state(solution, 0, solution.graph.contacts[0].t + step, 0)
    np.testing.assert_allclose(jacobian[:, layout.contact], (late - at) / step, atol=1e-3)
    assert np.abs(jacobian[:2, layout.contact]).max() == pytest.approx(1.0, abs=0.05)  # m per s at 1 m/s
    _, start = evaluate_segment_state(solution, 1, solution.graph.contacts[0].t, 0)
    np.testing.assert_allclose(start[:, layout.contact], 0.0, atol=1e-12)  # the state after it is a parameter


def test_what_the_fit_assumes_about_rubber_is_not_part_of_a_contact() -> None:
    """Restitution far below its prior: few frames after the contact let the prior pull; taking it out undoes that."""
    solution, observations = film_rebound(0.5, 8)
    contacts, _ = extract_cushion_contacts(solution, TABLE)
    free = -contacts.after[0, 0] / contacts.before[0, 0]
    with_prior = float(solution.graph.segments[1].state[2]) / contacts.before[0, 0]
    assert abs(free - 0.5) < abs(with_prior - 0.5)
    sigma = float(np.sqrt(contacts.covariance[0, 4, 4]))
    layout = layout_parameters(solution.graph)
    column = int(layout.segment[1]) + 2
    assert sigma > np.sqrt(solution.covariance[column, column])
    assert abs(free - 0.5) < 4 * sigma
    precise = replace(observations, whiten=20 * observations.whiten)
    exact = add_covariance(solution, precise, TABLE)
    np.testing.assert_allclose(  # exact paths leave nothing to take out
        extract_cushion_contacts(exact, TABLE)[0].covariance[0, 4, 4], exact.covariance[column, column], rtol=0.1
    )
