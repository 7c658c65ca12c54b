"""The derivatives of the joint refinement equal finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_shots import RADIUS, scene

from models.core.contact_graph import ClothFriction, Contact, ContactGraph, JointSolution, Observations, Segment
from models.estimation.joint_fit.fit_solution import (
    apply_parameters,
    assign_sorted_observations,
    build_graph_arrays,
    extract_parameters,
    start_times,
)
from models.estimation.joint_fit.joint_refinement import _apply_step, _has_valid_order, _linearize_fit
from models.estimation.joint_fit.pseudo_observations import RUBBER_PRIOR, PriorRows, evaluate_priors


def state(x: float, y: float, vx: float, vy: float) -> np.ndarray:
    """A ball that slides, on a cloth with a small slope."""
    return np.array([x, y, vx, vy, 0.4 * vx + 0.05, 0.3 * vy - 0.04, 0.01, -0.02])


def make_graph(driven: bool = False) -> ContactGraph:
    """A strike, a cushion, a contact of two balls, a push, an unexplained change, a jump: balls 0 and 1."""
    still = np.array([1.2, 0.5, *np.zeros(6)])
    segments = (
        Segment(0, True, None, 0, 0.0, np.array([0.3, 0.3, *np.zeros(6)])),
        Segment(0, False, 0, 1, 0.1, state(0.3, 0.3, 1.0, -1.4)),
        Segment(0, False, 1, 2, 0.3, state(0.5, RADIUS, 0.9, 1.1)),
        Segment(1, True, None, 2, 0.0, still),
        Segment(0, False, 2, 4, 0.7, state(1.2 - 2 * RADIUS, 0.5, 0.2, 0.5)),
        Segment(1, False, 2, 3, 0.7, state(1.2, 0.5, 0.6, 0.1)),
        Segment(1, False, 3, None, 0.9, state(1.3, 0.52, 0.7, 0.2)),
        Segment(0, False, 4, 5, 1.0, state(1.2, 0.65, 0.3, 0.3)),
        Segment(0, False, 5, None, 1.2, state(1.4, 0.7, 0.2, 0.3)),
    )
    contacts = (
        Contact("strike", 0.1, (0,), (1,)), Contact("cushion", 0.3, (1,), (2,), "top"),
        Contact("ball", 0.7, (2, 3), (4, 5), driven=driven), Contact("strike", 0.9, (5,), (6,), pushed=True),
        Contact("free", 1.0, (4,), (7,)), Contact("jump", 1.2, (7,), (8,)),
    )  # fmt: skip
    return ContactGraph(segments, contacts)


def solution(graph: ContactGraph) -> JointSolution:
    nose, rubber = np.array([1e-3, 0.0, -2e-3, 0.0]), RUBBER_PRIOR + np.array([0.02, -0.01, 0.1])
    return JointSolution(graph, ClothFriction(0.21, 0.011), 1.01, nose, rubber, np.inf, np.empty((0, 0)))


def samples() -> Observations:
    rng = np.random.default_rng(3)
    ball, t = np.repeat([0, 1], 45), np.tile(0.012 + np.arange(45) / 30, 2)
    return Observations(ball, t, rng.uniform(0, 1, (90, 2)), rng.normal(0, 300, (90, 2, 2)))


def dense(slope: np.ndarray, columns: np.ndarray, rows: PriorRows, size: int) -> np.ndarray:
    """All derivatives (2K + M, P)."""
    matrix = np.zeros((2 * len(slope) + len(rows.residual), size))
    for k, axis, i in zip(*np.nonzero(slope), strict=True):
        if columns[k, i] >= 0:
            matrix[2 * k + axis, columns[k, i]] += slope[k, axis, i]
    for row in range(len(rows.residual)):
        for i in range(rows.first[row], rows.first[row + 1]):
            matrix[2 * len(slope) + row, rows.column[i]] += rows.derivative[i]
    return matrix


@pytest.mark.parametrize("driven", [False, True])
def test_derivatives_are_those_of_finite_differences(driven: bool) -> None:
    graph, data, table = make_graph(driven), samples(), scene().table
    arrays, parameters = build_graph_arrays(graph), extract_parameters(solution(graph), graph)
    frame = parameters._replace(state=parameters.state * 1.1, t=parameters.t + 1e-3)
    linear = _linearize_fit(arrays, parameters, data, table, frame)
    jacobian = dense(linear.jacobian, linear.columns, linear.priors, arrays.size)
    for column in range(arrays.size):
        step = np.zeros(arrays.size)
        step[column] = 1e-6
        ahead, behind = (
            _linearize_fit(arrays, _apply_step(arrays, parameters, way * step), data, table, frame) for way in (1, -1)
        )
        measured = (ahead.residual - behind.residual) / 2e-6
        assert np.allclose(
            jacobian[:, column], measured, rtol=1e-4, atol=1e-5 * np.abs(jacobian[:, column]).max() + 1e-6
        )


def test_a_contact_that_obeys_the_laws_has_small_residuals() -> None:
    """Equal masses, usual restitution, spin that survives: only priors of strikes and cushions contribute."""
    e, before, after = 0.95, np.array([1.0, 0.0]), None
    come = np.array([0.5 - 2 * RADIUS, 0.5, *before, 0.0, 0.0, 0.0, 0.0])
    push = (1 + e) / 2 * before
    after = (np.array([*come[:2], *(before - push), *-push, 0.0, 0.0]), np.array([0.5, 0.5, *push, *push, 0.0, 0.0]))
    start = come.copy()
    start[0] -= 0.1
    segments = (
        Segment(0, False, None, 0, 0.0, start), Segment(1, True, None, 0, 0.0, np.array([0.5, 0.5, *np.zeros(6)])),
        Segment(0, False, 0, None, 0.1, after[0]), Segment(1, False, 0, None, 0.1, after[1]),
    )  # fmt: skip
    graph = ContactGraph(segments, (Contact("ball", 0.1, (0, 1), (2, 3)),))
    at = replace(solution(graph), friction=ClothFriction(0.2, 1e-9), diameter_factor=1.0)
    arrays, parameters = build_graph_arrays(graph), extract_parameters(at, graph)
    residual = evaluate_priors(arrays, parameters, parameters, scene().table).residual[:14]
    assert np.abs(residual).max() < 0.2
    other = parameters._replace(
        state=parameters.state + np.array([0, 0, 0.3, 0, 0, 0, 0, 0]) * (np.arange(4) == 3)[:, None]
    )
    assert np.abs(evaluate_priors(arrays, other, parameters, scene().table).residual[:14]).max() > 3


def test_samples_belong_to_the_segments_in_which_they_were_measured() -> None:
    graph, data = make_graph(), samples()
    arrays = build_graph_arrays(graph)
    parameters = extract_parameters(solution(graph), graph)
    segments = {ball: graph.segments_of_ball(ball) for ball in (0, 1)}
    expected = [
        max((k for k in segments[ball] if graph.start_time(k) <= t), key=graph.start_time, default=segments[ball][0])
        for ball, t in zip(data.ball.tolist(), data.t.tolist(), strict=True)
    ]
    assert (
        assign_sorted_observations(arrays.ball, start_times(arrays, parameters.t), data.ball, data.t).tolist()
        == expected
    )


def test_steps_keep_contacts_of_a_ball_in_order() -> None:
    graph = make_graph()
    arrays, parameters = build_graph_arrays(graph), extract_parameters(solution(graph), graph)
    close = parameters._replace(t=np.array([0.1, 0.101, 0.7, 0.9, 1.0, 1.2]))
    step = np.zeros(arrays.size)
    step[arrays.first_contact], step[arrays.first_contact + 1] = 0.02, -0.02
    moved = _apply_step(arrays, close, step)
    assert _has_valid_order(arrays, moved.t)
    assert moved.t[0] > 0.1


def test_a_solution_survives_conversion_to_parameters_and_back() -> None:
    graph = make_graph()
    at = solution(graph)
    again = apply_parameters(at, graph, extract_parameters(at, graph))
    assert again.friction == at.friction
    assert np.array_equal(again.rubber, at.rubber)
    assert np.array_equal(again.nose_offsets, at.nose_offsets)
    assert again.graph.contacts == graph.contacts
