"""Damped least squares: known minima, steps that are not feasible, and equations without a single solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.numerics.least_squares import (
    Minimum,
    NormalEquations,
    SearchOptions,
    invert_semidefinite,
    measure_log_determinant,
    minimize_cost,
    minimize_residuals,
    solve_damped,
    solve_normal_equations,
)
from models.numerics.statistics import evaluate_huber_loss

OPTIONS = SearchOptions(iterations=200, attempts=30, min_gain=1e-20)


def rosenbrock(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals and Jacobian of Rosenbrock's valley, whose minimum is 0 at (1, 1)."""
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def test_the_minimum_of_a_curved_valley_is_found() -> None:
    best = minimize_residuals(np.array([-1.2, 1.0]), rosenbrock, OPTIONS)
    assert best.outcome == "converged"
    np.testing.assert_allclose(best.point, 1.0, atol=1e-8)
    assert best.cost < 1e-16


def test_a_search_that_ends_early_says_so_and_never_raises_the_cost() -> None:
    best = minimize_residuals(np.array([-1.2, 1.0]), rosenbrock, replace(OPTIONS, iterations=3))
    assert best.outcome == "interrupted"
    assert best.cost < float((rosenbrock(np.array([-1.2, 1.0]))[0] ** 2).sum())


def test_no_step_leads_where_the_model_is_undefined() -> None:
    """The logarithm exists right of 0 only; the first full step would lead far to the left."""
    tried = []

    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        tried.append(x[0])
        return (np.log(x), np.diag(1 / x)) if x[0] > 0 else None

    best = minimize_residuals(np.array([20.0]), evaluate, OPTIONS)
    assert min(tried) < 0
    np.testing.assert_allclose(best.point, 1.0, atol=1e-8)
    with pytest.raises(ValueError, match="not possible"):
        minimize_residuals(np.array([-1.0]), evaluate, OPTIONS)


def test_steps_keep_within_their_limit() -> None:
    visited = []

    def limit(old: FloatArray, new: FloatArray) -> FloatArray:
        visited.append(np.clip(new, old - 0.1, old + 0.1))
        return visited[-1]

    best = minimize_residuals(np.array([-1.2, 1.0]), rosenbrock, OPTIONS, limit)
    np.testing.assert_allclose(best.point, 1.0, atol=1e-6)
    assert np.abs(np.diff(visited, axis=0)).max() <= 0.2 + 1e-12


def test_a_combination_that_no_row_constrains_does_not_move() -> None:
    """Only the sum of the first two is observed, and nothing of the third."""
    jacobian = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]])
    best = minimize_residuals(np.array([0.0, 1.0, 5.0]), lambda x: (jacobian @ x - [3.0, 6.0], jacobian), OPTIONS)
    np.testing.assert_allclose(best.point, [1.0, 2.0, 5.0], atol=1e-6)


def minimize_line(
    start: float, options: SearchOptions, *, slope: float | None = 1.0
) -> Minimum[float, NormalEquations]:
    """Minimize (x - 3)^2; `slope` is a factor on its derivative, None where there is none."""
    return minimize_cost(
        start,
        (start - 3) ** 2,
        lambda x: None if slope is None else NormalEquations(np.eye(1), np.array([slope * (x - 3)])),
        solve_normal_equations,
        lambda x, step: (x + step[0], (x + step[0] - 3) ** 2),
        options,
    )


def test_the_outcome_tells_why_a_search_ended() -> None:
    stalled, undefined = minimize_line(0.0, OPTIONS, slope=-1.0), minimize_line(0.0, OPTIONS, slope=None)
    assert (stalled.outcome, stalled.point) == ("stalled", 0.0)
    assert stalled.linear is not None
    assert (undefined.outcome, undefined.point) == ("undefined", 0.0)
    assert minimize_line(0.0, replace(OPTIONS, min_gain=0.0, min_step=0.5)).outcome == "converged"


def test_equations_without_a_solution_raise_the_damping() -> None:
    dampings = []

    def solve(equations: NormalEquations, damping: float) -> FloatArray | None:
        dampings.append(damping)
        return solve_normal_equations(equations, damping) if damping > 1.0 else None

    options = SearchOptions(iterations=1, attempts=9, damping=0.1, raising=2.0, raising_offset=0.1, largest_damping=1.2)
    best = minimize_cost(
        0.0, 9.0, lambda x: NormalEquations(np.eye(1), np.array([x - 3])), solve,
        lambda x, step: (x + step[0], (x + step[0] - 3) ** 2), options,
    )  # fmt: skip
    np.testing.assert_allclose(dampings, [0.1, 0.3, 0.7, 1.2])
    assert best.point == pytest.approx(3 / 2.2)


def test_weights_that_are_updated_after_each_step_fit_a_line_through_outliers() -> None:
    rng = np.random.default_rng(0)
    design = np.column_stack([np.ones(60), np.linspace(-1, 1, 60)])
    measured = design @ [1.0, 2.0] + 0.01 * rng.standard_normal(60)
    measured[::6] += 5.0

    def weigh(x: FloatArray, *_: float) -> tuple[tuple[FloatArray, FloatArray], float]:
        weight, cost = evaluate_huber_loss((design @ x - measured)[:, None] / 0.01)
        return (x, weight), cost

    best = minimize_cost(
        *weigh(np.zeros(2)),
        lambda now: NormalEquations(
            design.T @ (now[1][:, None] * design), design.T @ (now[1] * (design @ now[0] - measured))
        ),
        solve_normal_equations,
        lambda now, step: weigh(now[0] + step),
        replace(OPTIONS, min_gain=1e-9),
        refresh=lambda now, *_: weigh(now[0]),
    )
    plain = np.linalg.lstsq(design, measured, rcond=None)[0]
    assert np.abs(best.point[0] - [1.0, 2.0]).max() < 0.02
    assert np.abs(plain - [1.0, 2.0]).max() > 0.5


def test_an_unconstrained_parameter_does_not_move() -> None:
    assert np.allclose(solve_damped(np.diag([4.0, 0.0]), np.array([2.0, 0.0]), 0.0), [0.5, 0.0])


def test_equations_that_are_not_finite_are_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="not finite"):
        solve_damped(np.full((2, 2), np.nan), np.ones(2), 0.0)


@pytest.mark.parametrize("lower", [False, True])
def test_damped_equations_are_solved_in_any_unit(lower: bool) -> None:
    rng, scale = np.random.default_rng(1), 10.0 ** np.arange(-4, 5)
    jacobian = rng.standard_normal((40, 9))
    normal, right = jacobian.T @ jacobian, rng.standard_normal((9, 3))
    expected = np.linalg.solve(normal + 0.3 * np.diag(np.diag(normal)), right)
    solved = solve_damped(normal * scale * scale[:, None] * 100, right * scale[:, None], 0.3, lower=lower)
    np.testing.assert_allclose(solved * scale[:, None] * 100, expected, rtol=1e-6)


@pytest.mark.parametrize("lower", [False, True])
def test_negative_rounding_errors_leave_the_rest_solved(lower: bool) -> None:
    """Two indistinguishable parameters, with slightly negative information about their difference: the sum is known."""
    normal = np.array([[1.0, 1.0 + 1e-9, 0.0], [1.0 + 1e-9, 1.0, 0.0], [0.0, 0.0, 4.0]])
    result = solve_damped(normal, np.array([1.0, 1.0, 8.0]), 0.0, lower=lower)
    assert np.allclose([result[0] + result[1], result[2]], [1.0, 2.0], atol=1e-6)
    assert solve_damped(normal, np.eye(3), 0.0, lower=lower).shape == (3, 3)


def test_a_covariance_follows_the_units_of_its_parameters() -> None:
    jacobian, scale = np.random.default_rng(2).standard_normal((40, 9)), 10.0 ** np.arange(-16, 20, 4)
    inverse = invert_semidefinite(jacobian.T @ jacobian * scale * scale[:, None])
    np.testing.assert_allclose(inverse * scale * scale[:, None], np.linalg.inv(jacobian.T @ jacobian), rtol=1e-9)


def test_no_variance_is_negative_where_parameters_replace_each_other() -> None:
    """A third of the directions is missing; without scaling, rounding decides the signs of the small variances."""
    rng = np.random.default_rng(3)
    for exponent in range(12):
        jacobian = rng.standard_normal((40, 6)) @ rng.standard_normal((6, 9)) * np.geomspace(1, 10.0**-exponent, 9)
        assert (np.diag(invert_semidefinite(jacobian.T @ jacobian)) > 0).all()
    nothing = invert_semidefinite(np.diag([0.0, 1.0]))
    assert np.isfinite(nothing).all()
    assert nothing[0, 0] > 1e200
    certain = invert_semidefinite(np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 4.0]]))
    assert certain[2, 2] == pytest.approx(0.25)
    assert certain[0, 0] > 1e6  # the sum is known, the parts are not


def test_the_determinant_of_a_badly_conditioned_information_keeps_its_small_eigenvalues():
    sizes = np.array([1e12, 1.0, 1e-3])
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    jacobian = np.vstack([np.diag(sizes) @ turn, np.zeros((2, 3))])
    assert measure_log_determinant(jacobian) == pytest.approx(2 * np.log(sizes).sum(), abs=1e-2)
    assert abs(np.linalg.slogdet(jacobian.T @ jacobian)[1] - 2 * np.log(sizes).sum()) > 1


def test_dependent_columns_have_no_determinant():
    assert measure_log_determinant(np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])) == -np.inf
    columns = np.random.default_rng(6).normal(size=(40, 3))
    assert np.isfinite(measure_log_determinant(columns))
    assert measure_log_determinant(columns[:, [0, 1, 1]]) == -np.inf
    assert measure_log_determinant(np.column_stack([columns, columns @ [1.0, 2.0, 3.0]])) == -np.inf
