"""What a refinement says of the numbers that it seeks has the derivatives that it gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_shots import RADIUS, scene

from models.estimation.joint_fit.fit_arrays import begins, numbers_of, skeleton_of, solution_with
from models.estimation.joint_fit.fit_solution import Data, Solution, owners_among
from models.estimation.joint_fit.joint_refinement import _in_order, _linearise, _moved
from models.estimation.joint_fit.physics_priors import RUBBER, Rows, known
from models.estimation.segmentation.contact_graph import Contact, Span, Story
from models.physics.billiards.cloth.closed_form_motion import Friction


def state(x: float, y: float, vx: float, vy: float) -> np.ndarray:
    """A ball that slides, on a cloth that leans a little."""
    return np.array([x, y, vx, vy, 0.4 * vx + 0.05, 0.3 * vy - 0.04, 0.01, -0.02])


def story(driven: bool = False) -> Story:
    """A strike, a cushion, a contact of two balls, a push, a break for no reason, a jump: balls 0 and 1."""
    still = np.array([1.2, 0.5, *np.zeros(6)])
    spans = (
        Span(0, True, None, 0, 0.0, np.array([0.3, 0.3, *np.zeros(6)])),
        Span(0, False, 0, 1, 0.1, state(0.3, 0.3, 1.0, -1.4)),
        Span(0, False, 1, 2, 0.3, state(0.5, RADIUS, 0.9, 1.1)),
        Span(1, True, None, 2, 0.0, still),
        Span(0, False, 2, 4, 0.7, state(1.2 - 2 * RADIUS, 0.5, 0.2, 0.5)),
        Span(1, False, 2, 3, 0.7, state(1.2, 0.5, 0.6, 0.1)),
        Span(1, False, 3, None, 0.9, state(1.3, 0.52, 0.7, 0.2)),
        Span(0, False, 4, 5, 1.0, state(1.2, 0.65, 0.3, 0.3)),
        Span(0, False, 5, None, 1.2, state(1.4, 0.7, 0.2, 0.3)),
    )
    contacts = (
        Contact("strike", 0.1, (0,), (1,)), Contact("cushion", 0.3, (1,), (2,), "top"),
        Contact("ball", 0.7, (2, 3), (4, 5), driven=driven), Contact("strike", 0.9, (5,), (6,), pushed=True),
        Contact("free", 1.0, (4,), (7,)), Contact("jump", 1.2, (7,), (8,)),
    )  # fmt: skip
    return Story(spans, contacts)


def solution(told: Story) -> Solution:
    nose, rubber = np.array([1e-3, 0.0, -2e-3, 0.0]), RUBBER + np.array([0.02, -0.01, 0.1])
    return Solution(told, Friction(0.21, 0.011), 1.01, nose, rubber, np.inf, np.empty((0, 0)))


def samples() -> Data:
    rng = np.random.default_rng(3)
    ball, t = np.repeat([0, 1], 45), np.tile(0.012 + np.arange(45) / 30, 2)
    return Data(ball, t, rng.uniform(0, 1, (90, 2)), rng.normal(0, 300, (90, 2, 2)))


def dense(slope: np.ndarray, columns: np.ndarray, rows: Rows, size: int) -> np.ndarray:
    """All derivatives (2K + M, P)."""
    matrix = np.zeros((2 * len(slope) + len(rows.residual), size))
    for k, axis, i in zip(*np.nonzero(slope), strict=True):
        if columns[k, i] >= 0:
            matrix[2 * k + axis, columns[k, i]] += slope[k, axis, i]
    for row in range(len(rows.residual)):
        for i in range(rows.first[row], rows.first[row + 1]):
            matrix[2 * len(slope) + row, rows.column[i]] += rows.slope[i]
    return matrix


@pytest.mark.parametrize("driven", [False, True])
def test_derivatives_are_those_of_finite_differences(driven: bool) -> None:
    told, data, table = story(driven), samples(), scene().table
    bones, now = skeleton_of(told), numbers_of(solution(told), told)
    frame = now._replace(state=now.state * 1.1, t=now.t + 1e-3)
    linear = _linearise(bones, now, data, table, frame)
    given = dense(linear.slope, linear.columns, linear.known, bones.size)
    for column in range(bones.size):
        step = np.zeros(bones.size)
        step[column] = 1e-6
        ahead, behind = (_linearise(bones, _moved(bones, now, way * step), data, table, frame) for way in (1, -1))
        measured = (ahead.residual - behind.residual) / 2e-6
        assert np.allclose(given[:, column], measured, rtol=1e-4, atol=1e-5 * np.abs(given[:, column]).max() + 1e-6)


def test_a_meeting_that_obeys_the_laws_surprises_nobody() -> None:
    """Equal masses, usual restitution, spin that survives: only priors of strikes and cushions speak."""
    e, before, after = 0.95, np.array([1.0, 0.0]), None
    come = np.array([0.5 - 2 * RADIUS, 0.5, *before, 0.0, 0.0, 0.0, 0.0])
    push = (1 + e) / 2 * before
    after = (np.array([*come[:2], *(before - push), *-push, 0.0, 0.0]), np.array([0.5, 0.5, *push, *push, 0.0, 0.0]))
    start = come.copy()
    start[0] -= 0.1
    spans = (
        Span(0, False, None, 0, 0.0, start), Span(1, True, None, 0, 0.0, np.array([0.5, 0.5, *np.zeros(6)])),
        Span(0, False, 0, None, 0.1, after[0]), Span(1, False, 0, None, 0.1, after[1]),
    )  # fmt: skip
    told = Story(spans, (Contact("ball", 0.1, (0, 1), (2, 3)),))
    at = replace(solution(told), friction=Friction(0.2, 1e-9), diameter=1.0)
    bones, now = skeleton_of(told), numbers_of(at, told)
    said = known(bones, now, now, scene().table).residual[:14]
    assert np.abs(said).max() < 0.2
    other = now._replace(state=now.state + np.array([0, 0, 0.3, 0, 0, 0, 0, 0]) * (np.arange(4) == 3)[:, None])
    assert np.abs(known(bones, other, now, scene().table).residual[:14]).max() > 3


def test_samples_belong_to_the_spans_in_which_they_were_taken() -> None:
    told, data = story(), samples()
    bones = skeleton_of(told)
    now = numbers_of(solution(told), told)
    spans = {ball: told.of_ball(ball) for ball in (0, 1)}
    expected = [
        max((k for k in spans[ball] if told.begin(k) <= t), key=told.begin, default=spans[ball][0])
        for ball, t in zip(data.ball.tolist(), data.t.tolist(), strict=True)
    ]
    assert owners_among(bones.ball, begins(bones, now.t), data.ball, data.t).tolist() == expected


def test_steps_keep_contacts_of_a_ball_in_order() -> None:
    told = story()
    bones, now = skeleton_of(told), numbers_of(solution(told), told)
    close = now._replace(t=np.array([0.1, 0.101, 0.7, 0.9, 1.0, 1.2]))
    step = np.zeros(bones.size)
    step[bones.first_contact], step[bones.first_contact + 1] = 0.02, -0.02
    moved = _moved(bones, close, step)
    assert _in_order(bones, moved.t)
    assert moved.t[0] > 0.1


def test_a_solution_survives_being_taken_apart() -> None:
    told = story()
    at = solution(told)
    again = solution_with(at, told, numbers_of(at, told))
    assert again.friction == at.friction
    assert np.array_equal(again.rubber, at.rubber)
    assert np.array_equal(again.nose, at.nose)
    assert again.story.contacts == told.contacts
