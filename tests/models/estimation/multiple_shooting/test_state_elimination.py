"""Eliminating the states of shots equals solving for everything at once."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.state_elimination import ChainBlock, eliminate_states, log_determinant
from models.numerics.statistics import correlation_factor

SHARED, STATES = 3, (4, 6)


def rows(rng: np.random.Generator) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Jacobians by states and by shared parameters, and residuals, of two shots."""
    return [
        (rng.standard_normal((30, size)), rng.standard_normal((30, SHARED)), rng.standard_normal(30))
        for size in STATES
    ]  # fmt: skip


def blocks(shots: list[tuple[FloatArray, FloatArray, FloatArray]]) -> list[ChainBlock]:
    result = []
    for by_states, by_shared, residual in shots:
        block = ChainBlock.empty(by_states.shape[1], SHARED)
        for part in (slice(0, 11), slice(11, None)):
            block.add_rows(slice(None), by_states[part], by_shared[part], residual[part])
        result.append(block)
    return result


def dense(shots: list[tuple[FloatArray, FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """The whole Jacobian, states first, and all residuals."""
    whole = np.zeros((60, sum(STATES) + SHARED))
    whole[:30, :4], whole[30:, 4:10] = shots[0][0], shots[1][0]
    whole[:30, 10:], whole[30:, 10:] = shots[0][1], shots[1][1]
    return whole, np.concatenate([shots[0][2], shots[1][2]])


def test_steps_equal_those_of_the_dense_equations() -> None:
    shots, prior = rows(np.random.default_rng(0)), np.diag([1.0, 2.0, 3.0])
    gradient = np.array([0.3, -0.2, 0.1])
    step, inner = eliminate_states(blocks(shots), prior, gradient, 0.0, np.zeros(3, bool))
    whole, residual = dense(shots)
    normal, right = whole.T @ whole, -whole.T @ residual
    normal[10:, 10:] += prior
    right[10:] -= gradient
    assert np.allclose(np.concatenate([*inner, step]), np.linalg.solve(normal, right), rtol=1e-6)


def test_a_fixed_parameter_does_not_move_and_the_others_account_for_it() -> None:
    shots, prior = rows(np.random.default_rng(1)), np.eye(3)
    step, inner = eliminate_states(blocks(shots), prior, np.zeros(3), 0.0, np.array([False, True, False]))
    whole, residual = dense(shots)
    free = np.delete(np.arange(13), 11)
    normal = whole[:, free].T @ whole[:, free] + np.diag([0.0] * 10 + [1.0, 1.0])
    expected = np.linalg.solve(normal, -whole[:, free].T @ residual)
    assert step[1] == 0
    assert np.allclose(np.concatenate([*inner, step[[0, 2]]]), expected, rtol=1e-6)


def test_information_about_shared_parameters_is_the_schur_complement() -> None:
    shots = rows(np.random.default_rng(2))
    whole, _ = dense(shots)
    fitted = sum(block.schur_complement() for block in blocks(shots))
    assert np.allclose(np.linalg.inv(fitted), np.linalg.inv(whole.T @ whole)[10:, 10:], rtol=1e-6)
    whole_log = np.linalg.slogdet(whole.T @ whole)[1]
    parts = sum(log_determinant(block.states) for block in blocks(shots))
    assert np.isclose(whole_log, parts + np.linalg.slogdet(fitted)[1])


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_the_correlation_factor_equals_that_of_an_autoregression(rho: float) -> None:
    rng, series = np.random.default_rng(3), []
    for _ in range(20):
        noise = rng.standard_normal((400, 2))
        for k in range(1, len(noise)):
            noise[k] += rho * noise[k - 1]
        series.append(noise)
    assert np.isclose(correlation_factor(series), (1 + rho) / (1 - rho), rtol=0.15)


def test_states_follow_a_bounded_step() -> None:
    shots, prior = rows(np.random.default_rng(2)), np.eye(3)
    least, most = np.full(3, -0.01), np.full(3, 0.02)
    step, inner = eliminate_states(blocks(shots), prior, np.zeros(3), 0.0, np.zeros(3, bool), (least, most))
    assert np.all((step >= least) & (step <= most))
    assert np.any((step == least) | (step == most))
    whole, residual = dense(shots)
    states = whole[:, :10]
    expected = np.linalg.solve(states.T @ states, -states.T @ (residual + whole[:, 10:] @ step))
    assert np.allclose(np.concatenate(inner), expected, rtol=1e-6)
