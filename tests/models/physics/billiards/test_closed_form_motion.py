"""Closed-form motion against independent integration, its own derivatives, and textbook physics."""

from __future__ import annotations

import numpy as np
import pytest
from support import fixed_step_table as truth

from models.core.contact_graph import ClothFriction
from models.physics.billiards.cloth.closed_form_motion import (
    differentiate_kinematics,
    duration_until_rest,
    evaluate_kinematics,
    sliding_duration,
    spin_from_slip,
    split_into_polynomials,
)

CLOTH = ClothFriction(0.2, 0.01)
RADIUS = 0.028575


def states(count: int = 60) -> np.ndarray:
    """Draw initial states of segments (count, 8)."""
    rng = np.random.default_rng(1)
    return rng.normal(size=(count, 8)) * np.array([1, 1, 1, 1, 1, 1, 0.01, 0.01])


def test_a_ball_struck_without_spin_rolls_at_five_sevenths_of_its_speed() -> None:
    state = np.array([0, 0, 2.0, 0, 2.0, 0, 0, 0])  # slip equals velocity: no spin
    rolling = evaluate_kinematics(state[None], sliding_duration(state[None], CLOTH), CLOTH)[0]
    assert rolling[2] == pytest.approx(2.0 * 5 / 7)
    assert sliding_duration(state, CLOTH) == pytest.approx(2 / 7 * 2.0 / (0.2 * 9.81))


def test_a_rolling_ball_stops_after_v_squared_over_two_mu_g() -> None:
    state = np.array([[0, 0, 0.6, 0.8, 0, 0, 0, 0]])
    far = evaluate_kinematics(state, np.array([60.0]), CLOTH)[0]
    assert np.hypot(far[0], far[1]) == pytest.approx(1 / (2 * 0.01 * 9.81), rel=1e-4)
    assert duration_until_rest(state, CLOTH)[0] == pytest.approx(1 / (0.01 * 9.81), rel=1e-4)
    assert np.all(far[2:] == 0)


def test_derivatives_agree_with_finite_differences() -> None:
    state, tau = states(), np.random.default_rng(2).uniform(0, 3, 60)
    _, jacobian = differentiate_kinematics(state, tau, CLOTH)
    step = 1e-6
    for k in range(8):
        shift = step * np.eye(8)[k]
        numeric = (evaluate_kinematics(state + shift, tau, CLOTH) - evaluate_kinematics(state - shift, tau, CLOTH)) / (
            2 * step
        )
        np.testing.assert_allclose(jacobian[:, :, k], numeric, atol=2e-7)
    late, early = evaluate_kinematics(state, tau + step, CLOTH), evaluate_kinematics(state, tau - step, CLOTH)
    np.testing.assert_allclose(jacobian[:, :, 8], (late - early) / (2 * step), atol=2e-6)
    for k, (up, down) in enumerate(
        ((ClothFriction(0.2 * (1 + step), 0.01), ClothFriction(0.2 * (1 - step), 0.01)),
         (ClothFriction(0.2, 0.01 * (1 + step)), ClothFriction(0.2, 0.01 * (1 - step))))
    ):  # fmt: skip
        numeric = (evaluate_kinematics(state, tau, up) - evaluate_kinematics(state, tau, down)) / (2 * step)
        np.testing.assert_allclose(jacobian[:, :, 9 + k], numeric, atol=2e-6)


def test_polynomial_pieces_are_the_same_motion() -> None:
    for state in states(20):
        length = float(duration_until_rest(state, CLOTH)) + 0.3
        pieces = split_into_polynomials(state, length, CLOTH)
        assert [piece[0] for piece in pieces] == ["slide", "roll", "rest"]
        for _, start, stop, position, slip in pieces:
            tau = np.linspace(0, stop - start, 5)[1:-1]
            powers = tau[:, None] ** np.arange(4)
            whole = evaluate_kinematics(np.repeat(state[None], 3, axis=0), start + tau, CLOTH)
            np.testing.assert_allclose(powers @ position, whole[:, :2], atol=1e-5)
            np.testing.assert_allclose(powers[:, :2] @ slip, whole[:, 4:], atol=1e-5)


def test_motion_agrees_with_fixed_steps() -> None:
    v, w = np.array([[1.2, 0.4]]), np.array([[8.0, -20.0, 15.0]])
    t, path, _ = truth.play(np.array([[0.3, 0.3]]), v, w, seconds=1.2, fps=100)
    slip = v[0] + np.array([-w[0, 1], w[0, 0]]) * RADIUS
    state = np.concatenate([[0.3, 0.3], v[0], slip, [0, 0]])
    ours = evaluate_kinematics(np.repeat(state[None], len(t), axis=0), t, CLOTH)
    np.testing.assert_allclose(ours[:, :2], path[:, 0], atol=1e-4)


def test_a_ball_that_rolls_towards_x_turns_about_y() -> None:
    spin = spin_from_slip(np.array([1.0, 2.0]), np.zeros(2), RADIUS)
    np.testing.assert_allclose(spin, [-2.0 / RADIUS, 1.0 / RADIUS])
