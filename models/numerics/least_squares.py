"""Damped least squares (Levenberg 1944, doi:10.1090/qam/10666; Marquardt 1963, doi:10.1137/0111030).

One search for all fits: linearize at a point, solve for a step, accept it where it lowers the cost, otherwise raise the
damping. What a point is, how its equations are built and solved, and how far a step may go are the caller's:
`minimize_cost` takes them as functions, `minimize_residuals` has them for dense residuals and Jacobians. Every fit
keeps stopping rules of its own, as `SearchOptions`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Generic, Literal, ParamSpec, TypeVar

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from models.core.typing import FloatArray

# 1/variance of a variable that no row constrains, in its own unit.
MIN_INFORMATION = 1e-6
# Relative ridge on the diagonal: a thousand times the rounding errors of a large fit.
RIDGE = 1e-10
# Diagonal that stands for zero, so that its inverse over `RIDGE` is finite.
_LEAST_SCALE = 1e-280

Point = TypeVar("Point")
Linear = TypeVar("Linear")
Step = TypeVar("Step")
Request = TypeVar("Request")
Answer = TypeVar("Answer")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")
Outcome = Literal["converged", "stalled", "undefined", "interrupted"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchOptions:
    """When a search stops, and how its damping changes. The cost is chi2 unless the caller says otherwise."""

    iterations: int
    """Largest number of steps; guess."""
    attempts: int
    """Number of dampings that are tried for a step before the search stops; guess."""
    min_gain: float = 0.0
    """Unit of the cost: decrease by a step below which the search is converging, far below what matters; guess."""
    min_relative_gain: float = 0.0
    """The same, relative to the cost before the step, as `ftol` of MINPACK; guess."""
    quiet_steps: int = 1
    """Number of successive steps that gain as little before the search has converged; guess."""
    min_iterations: int = 0
    """Number of steps before the search can have converged; guess."""
    min_step: float = 0.0
    """Unit of the parameters: largest component of an accepted step (array) that ends the search; guess."""
    damping: float = 1e-3
    """Initial damping, relative to a unit diagonal; Marquardt 1963 starts at 1e-2."""
    lowering: float = 0.15
    """Factor on the damping after a step; 0.1 in Marquardt 1963."""
    least_damping: float = 0.0
    """Lower bound of the damping after a step; guess."""
    raising: float = 6.0
    """Factor on the damping after an attempt that failed; 10 in Marquardt 1963."""
    raising_offset: float = 0.0
    """Added to the damping after an attempt that failed; guess."""
    least_raised: float = 0.0
    """Lower bound of the damping after an attempt that failed; guess."""
    largest_damping: float = np.inf
    """Upper bound of the damping; guess."""

    def raise_damping(self, damping: float) -> float:
        """Return the damping after an attempt that failed."""
        return min(max(damping * self.raising + self.raising_offset, self.least_raised), self.largest_damping)


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """Dense normal equations of P parameters."""

    normal: FloatArray
    """(P, P)"""
    gradient: FloatArray
    """(P,)"""
    ridge: float = RIDGE
    """Relative ridge on the diagonal."""


@dataclass(frozen=True, slots=True)
class Minimum(Generic[Point, Linear]):
    """The best point of a search."""

    point: Point
    cost: float
    outcome: Outcome
    """Converged: steps gain too little. Stalled: no attempt lowers the cost. Undefined: the derivatives are not
    usable. Interrupted: the iterations ended first."""
    linear: Linear | None
    """The last linearization: at `point` where the search stalled."""


def minimize_cost(
    point: Point,
    cost: float,
    linearize: Callable[[Point], Linear | None],
    solve: Callable[[Linear, float], Step | None],
    move: Callable[[Point, Step], tuple[Point, float] | None],
    options: SearchOptions,
    *,
    is_negligible: Callable[[Point, Linear, Step], bool] | None = None,
    refresh: Callable[[Point, float, int, bool], tuple[Point, float]] | None = None,
) -> Minimum[Point, Linear]:
    """Minimize a cost by damped steps.

    Args:
        point: Where to start.
        cost: Cost of this point.
        linearize: Builds the equations at a point; None where the derivatives are not usable, which ends the search.
        solve: Solves the equations with a damping for a step; None where they have no solution, which counts as a
            failed attempt.
        move: Applies a step within its limits; returns the new point and its cost, or None where it is not feasible.
        options: Stopping rules.
        is_negligible: Whether the first step of an iteration is too small to be tried, which ends the search.
        refresh: Updates what is constant during a step (weights, standard deviations) after one was accepted: from the
            point, its cost, the index of the iteration and whether the step gained little, to the point and its cost.

    Returns:
        The point of the lowest cost.
    """
    search = search_minimum(
        point,
        cost,
        _answer_at_once(linearize),
        solve,
        _answer_at_once(move),
        options,
        is_negligible=is_negligible,
        refresh=refresh,
    )
    try:
        next(search)
    except StopIteration as end:
        best: Minimum[Point, Linear] = end.value
        return best
    raise RuntimeError("a search whose functions answer at once waits for nothing")


def _answer_at_once(function: Callable[Arguments, Result]) -> Callable[Arguments, Generator[None, None, Result]]:
    """Return a function that `search_minimum` need not wait for."""

    def answer(*arguments: Arguments.args, **named: Arguments.kwargs) -> Generator[None, None, Result]:
        yield from ()
        return function(*arguments, **named)

    return answer


def search_minimum(
    point: Point,
    cost: float,
    linearize: Callable[[Point], Generator[Request, Answer, Linear | None]],
    solve: Callable[[Linear, float], Step | None],
    move: Callable[[Point, Step], Generator[Request, Answer, tuple[Point, float] | None]],
    options: SearchOptions,
    *,
    is_negligible: Callable[[Point, Linear, Step], bool] | None = None,
    refresh: Callable[[Point, float, int, bool], tuple[Point, float]] | None = None,
) -> Generator[Request, Answer, Minimum[Point, Linear]]:
    """Minimize a cost as `minimize_cost` does, where `linearize` and `move` may wait for something.

    Several searches can go on side by side so that what they wait for is computed together.

    Yields:
        What `linearize` and `move` ask for.

    Returns:
        The point of the lowest cost.
    """
    damping, quiet, linear = options.damping, 0, None
    for iteration in range(options.iterations):
        linear = yield from linearize(point)
        if linear is None:
            return Minimum(point, cost, "undefined", None)
        for attempt in range(options.attempts):
            step = solve(linear, damping)
            if step is not None:
                if is_negligible is not None and attempt == 0 and is_negligible(point, linear, step):
                    return Minimum(point, cost, "converged", linear)
                trial = yield from move(point, step)
                if trial is not None and trial[1] < cost:
                    break
            damping = options.raise_damping(damping)
        else:
            return Minimum(point, cost, "stalled", linear)
        is_quiet = cost - trial[1] < options.min_gain + options.min_relative_gain * cost
        quiet = quiet + 1 if is_quiet else 0
        point, cost = trial
        damping = max(damping * options.lowering, options.least_damping)
        if quiet >= options.quiet_steps and iteration + 1 >= options.min_iterations:
            return Minimum(point, cost, "converged", linear)
        if options.min_step > 0 and np.abs(step).max() < options.min_step:  # type: ignore[call-overload]
            return Minimum(point, cost, "converged", linear)
        if refresh is not None:
            point, cost = refresh(point, cost, iteration, is_quiet)
    return Minimum(point, cost, "interrupted", linear)


# Parameters, residuals and Jacobian.
_DensePoint = tuple[FloatArray, FloatArray, FloatArray]


def minimize_residuals(
    parameters: FloatArray,
    evaluate: Callable[[FloatArray], tuple[FloatArray, FloatArray] | None],
    options: SearchOptions,
    limit: Callable[[FloatArray, FloatArray], FloatArray] | None = None,
    ridge: float = RIDGE,
) -> Minimum[FloatArray, NormalEquations]:
    """Minimize the sum of squared residuals with dense Jacobians.

    Args:
        parameters: (P,) initial values.
        evaluate: From (P,) to residuals (R,) and their Jacobian (R, P); None where the parameters are not possible.
        options: Stopping rules.
        limit: From the old and the wanted parameters to those that the step may reach.
        ridge: Relative ridge on the diagonal of the normal equations.

    Returns:
        The parameters of the lowest cost.

    Raises:
        ValueError: The initial parameters are not possible.
    """

    def assess(values: FloatArray) -> tuple[_DensePoint, float] | None:
        rows = evaluate(values)
        return None if rows is None else ((values, *rows), float(rows[0] @ rows[0]))

    def move(now: _DensePoint, step: FloatArray) -> tuple[_DensePoint, float] | None:
        moved = now[0] + step
        return assess(moved if limit is None else limit(now[0], moved))

    first = assess(parameters)
    if first is None:
        raise ValueError("the initial parameters of a fit are not possible")
    best = minimize_cost(
        *first,
        lambda now: NormalEquations(now[2].T @ now[2], now[2].T @ now[1], ridge),
        solve_normal_equations,
        move,
        options,
    )
    return Minimum(best.point[0], best.cost, best.outcome, best.linear)


def invert_semidefinite(matrix: FloatArray) -> FloatArray:
    """Invert an information matrix or a covariance whose variables have different units.

    The matrix is scaled to a unit diagonal first: unscaled, rounding of the largest variable can leave a negative
    variance of the smallest. A direction that others replace to rounding keeps `RIDGE` of information.

    Args:
        matrix: (P, P) positive semidefinite but for rounding.

    Returns:
        (P, P) positive definite.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), _LEAST_SCALE))
    sizes, axes = np.linalg.eigh(matrix * scale * scale[:, None])
    half = axes / np.sqrt(np.maximum(sizes, RIDGE)) * scale[:, None]
    return np.asarray(half @ half.T)


def measure_log_determinant(jacobian: FloatArray) -> float:
    """Return the natural logarithm of the determinant of the information J^T J of a Jacobian (R, P).

    It is computed from J, since rounding J^T J loses the small eigenvalues of a badly conditioned problem: a
    determinant of zero would make the least determined fit the most probable one.

    Returns:
        The logarithm; -inf where the columns are dependent, but for rounding.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    if len(jacobian) < jacobian.shape[1] or not scale.all():
        return -np.inf
    diagonal = np.abs(np.diag(np.linalg.qr(jacobian / scale, mode="r")))
    # what rounding leaves of a column that others replace: the rule for ranks of Golub and Van Loan, section 5.5.8
    if diagonal.min() <= np.finfo(np.float64).eps * max(jacobian.shape):
        return -np.inf
    return 2 * float((np.log(diagonal) + np.log(scale)).sum())


def count_determined(jacobian: FloatArray) -> int:
    """Count the directions of parameters that residuals determine.

    Args:
        jacobian: (R, P) derivatives of the residuals.

    Returns:
        The rank, by the eigenvalues of the normal equations scaled to a unit diagonal: far cheaper than singular
        values where there are many more residuals than parameters.
    """
    normal = jacobian.T @ jacobian
    is_known = np.diag(normal) > MIN_INFORMATION
    scale = 1 / np.sqrt(np.diag(normal)[is_known])
    sizes = np.linalg.eigvalsh(normal[np.ix_(is_known, is_known)] * scale * scale[:, None])
    return int((sizes > RIDGE).sum())


def solve_normal_equations(equations: NormalEquations, damping: float) -> FloatArray:
    """Solve dense damped normal equations.

    Args:
        equations: Normal matrix (P, P), gradient (P,) and ridge.
        damping: Added to the diagonal, which is scaled to 1.

    Returns:
        (P,) step.
    """
    return solve_damped(equations.normal, -equations.gradient, damping, ridge=equations.ridge, lower=True)


def solve_damped(
    normal: FloatArray, right: FloatArray, damping: float, *, ridge: float = RIDGE, lower: bool = False
) -> FloatArray:
    """Solve damped normal equations by Cholesky's method, also where nothing constrains a variable.

    The matrix is scaled to a unit diagonal, so that one small ridge far above rounding makes every finite matrix
    invertible: contacts known to a nanosecond stand beside unobserved accelerations.

    Args:
        normal: (M, M) normal matrix.
        right: (M, ...) right-hand sides.
        damping: Added to the unit diagonal.
        ridge: Added to it as well.
        lower: Which of the two factorizations is used. They differ in the last bits, on which a fit beside a kink of
            its loss depends: each caller keeps to one.

    Returns:
        (M, ...) solution.

    Raises:
        LinAlgError: The matrix contains numbers that are not finite.
    """
    if not np.isfinite(normal).all():
        raise np.linalg.LinAlgError("the normal equations of a fit contain numbers that are not finite")
    if len(normal) == 0:
        return np.asarray(right, dtype=np.float64)
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), MIN_INFORMATION))
    scaled = normal * scale * scale[:, None]
    scaled.flat[:: len(scaled) + 1] += damping + ridge
    columns = (right.T * scale).T
    factor, failed = dpotrf(scaled.T if lower else scaled, lower=lower, clean=0)
    if not failed:
        solved = dpotrs(factor, columns, lower=lower)[0].reshape(right.shape)
    else:  # a parameter that others nearly replace leaves only rounding errors, possibly negative
        sizes, axes = np.linalg.eigh((scaled + scaled.T) / 2)
        turned = axes.T @ columns.reshape(len(normal), -1) / np.maximum(sizes, damping + ridge)[:, None]
        solved = (axes @ turned).reshape(right.shape)
    return np.asarray((solved.T * scale).T, dtype=np.float64)
