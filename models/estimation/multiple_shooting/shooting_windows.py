"""Windows of a recording, their simulation, and models that simulate them, of which some parameters may be fixed."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.numerics.jit import compile_kernel
from models.physics.effect import Prior

# |dx/dx0| beyond which a window should have ended: 1 mm at its start becomes 4 cm there.
MAX_SENSITIVITY = 40.0
# Residual of an observation that cannot be simulated, standard deviations: beyond any finite one of real data (3 m in
# steps of a micrometre), and small enough that the cost of all other observations keeps nine digits beside it.
LOST_RESIDUAL = 1e7
# Standard deviations beside which the cost of another observation vanishes in rounding errors.
_MAX_RESIDUAL = 1 / float(np.finfo(np.float64).eps)
# Ratio to the first derivative of a window by its start from which an observation determines nothing: in normal
# equations, its rounding errors are as large as the information of the others.
_MAX_AMPLIFICATION = float(np.finfo(np.float64).eps) ** -0.5


@dataclass(frozen=True, slots=True)
class Window:
    """A part of a recording that is simulated from a start state of its own; S state variables, K observations."""

    shot: int
    """Windows of one shot are neighbours, in the order of time."""
    t: FloatArray
    """(K,) s, time of each observation, increasing."""
    body: IntArray
    """(K,) index of the observed body: residuals of one body are neighbours in time."""
    start: FloatArray
    """(S,) initial guess of the start state, and the mean of its prior."""
    sigma: FloatArray
    """(S,) standard deviation of the prior of the start state; infinite where nothing is known."""
    link_sigma: FloatArray | None = None
    """(S,) standard deviation of the change of state since the end of the previous window, infinite where the state
    may change arbitrarily; None where a shot begins."""
    alternative_starts: tuple[FloatArray, ...] = ()
    """(S,) each: further initial guesses, where unobserved quantities leave several; the best-fitting one is used."""

    def __post_init__(self) -> None:
        if self.start.shape != self.sigma.shape or (
            self.link_sigma is not None and self.link_sigma.shape != self.start.shape
        ):
            raise ValueError(f"start, sigma and link_sigma need one shape; got {self.start.shape} and others")
        if self.t.shape != self.body.shape or np.any(np.diff(self.t) < 0):
            raise ValueError("a window needs one body per observation, and increasing times")


@dataclass(frozen=True, slots=True)
class LinearizedWindow:
    """The prediction for one window with its Jacobians; d coordinates per observation, P shared parameters."""

    residual: FloatArray
    """(K, d) predicted minus observed, in standard deviations."""
    start_jacobian: FloatArray
    """(K, d, S) derivative of the residual with respect to the start state."""
    shared_jacobian: FloatArray
    """(K, d, P) derivative of the residual with respect to the shared parameters."""
    end: FloatArray
    """(S',) state at the start of the next window of the shot, in the coordinates of that window."""
    end_start_jacobian: FloatArray
    """(S', S) derivative of `end` with respect to the start state."""
    end_shared_jacobian: FloatArray
    """(S', P) derivative of `end` with respect to the shared parameters."""
    event_order: Hashable = ()
    """Sequence of contacts; where it differs between two simulations, the derivatives of one do not predict the
    other."""


@dataclass(frozen=True, slots=True)
class SimulatedWindow:
    """The prediction for one window without Jacobians: enough to evaluate the cost of a trial step."""

    residual: FloatArray
    """(K, d) predicted minus observed, in standard deviations."""
    end: FloatArray
    """(S',) state at the start of the next window."""
    event_order: Hashable = ()
    """As in `LinearizedWindow`."""


class ShootingModel(Protocol):
    """A scene that multiple shooting can fit.

    It may also have the methods `simulate(window, start, shared)`, which returns a `SimulatedWindow` and is faster than
    `linearize`; `without_shared_jacobian()`, which returns a model whose Jacobians by the shared parameters are empty;
    and, where `simulates_together` is true, `simulate_ahead`, for which see the function of this name.
    """

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of the P parameters that all windows share."""
        ...

    @property
    def windows(self) -> tuple[Window, ...]:
        """All windows, shot by shot, in the order of time."""
        ...

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Simulate window number `window` from `start` (S,) with the parameters `shared` (P,), with derivatives."""
        ...


def drop_shared_jacobian(model: ShootingModel) -> ShootingModel:
    """Return a model for steps of the start states alone.

    Args:
        model: Model to simplify, with an optional method `without_shared_jacobian`.

    Returns:
        The model whose Jacobians by the shared parameters may be empty, (K, d, 0) and (S', 0); the same one without
        that method.
    """
    narrow: Callable[[], ShootingModel] | None = getattr(model, "without_shared_jacobian", None)
    return model if narrow is None else narrow()


def simulate_ahead(
    model: ShootingModel,
    windows: Sequence[int],
    starts: Sequence[FloatArray],
    shared: Sequence[FloatArray],
    has_jacobians: bool,
) -> ShootingModel:
    """Let a model simulate windows together that are about to be predicted, where it can and that is faster.

    Args:
        model: Model, with a method `simulate_ahead` where it `simulates_together`.
        windows: Indices of windows.
        starts: (S,) start state of each of them.
        shared: (P,) shared parameters for each of them.
        has_jacobians: Whether the windows will be linearized.

    Returns:
        The model for these windows, starts and parameters alone; the same one without that method.
    """
    if not getattr(model, "simulates_together", False):
        return model
    together: ShootingModel = model.simulate_ahead(windows, starts, shared, has_jacobians)  # type: ignore[attr-defined]
    return together


def simulate_window(
    model: ShootingModel, window: int, start: FloatArray, shared: FloatArray
) -> SimulatedWindow | LinearizedWindow:
    """Predict one window without Jacobians where the model can.

    Args:
        model: Model with an optional method `simulate`; without it, the window is linearized.
        window: Index of the window.
        start: (S,) start state.
        shared: (P,) shared parameters.

    Returns:
        The simulated or linearized window; all its numbers are finite, see `linearize_window`.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        prediction = predict_window(model, window, start, shared)
    if isinstance(prediction, LinearizedWindow):
        return _limit_jacobians(prediction)
    residual = _price_lost_observations(prediction.residual)
    if residual is prediction.residual and np.isfinite(prediction.end).all():
        return prediction
    return replace(prediction, residual=residual, end=np.nan_to_num(prediction.end))


def predict_window(
    model: ShootingModel, window: int, start: FloatArray, shared: FloatArray
) -> SimulatedWindow | LinearizedWindow:
    """Predict one window as `simulate_window` does, but with the numbers of the model: they may be infinite.

    Args:
        model: Model with an optional method `simulate`.
        window: Index of the window.
        start: (S,) start state.
        shared: (P,) shared parameters.

    Returns:
        The simulated window, or the linearized one of a model without that method.
    """
    simulate: Callable[[int, FloatArray, FloatArray], SimulatedWindow | LinearizedWindow] = getattr(
        model, "simulate", model.linearize
    )
    return simulate(window, start, shared)


def linearize_window(model: ShootingModel, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
    """Predict one window with its Jacobians.

    A simulation that overflows ends what it predicts, not the fit: observations without a finite prediction have a
    residual of `LOST_RESIDUAL`. They, and those whose derivatives are beyond the precision of numbers, determine
    nothing: their derivatives are 0.

    Args:
        model: Model of the windows.
        window: Index of the window.
        start: (S,) start state.
        shared: (P,) shared parameters.

    Returns:
        The linearized window; all its numbers are finite.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return _limit_jacobians(model.linearize(window, start, shared))


def is_lost(residual: FloatArray) -> BoolArray:
    """Find the observations of a window that could not be simulated.

    Args:
        residual: (K, d) residuals.

    Returns:
        (K,) mask.
    """
    return np.asarray((residual == LOST_RESIDUAL).all(axis=1))


def _price_lost_observations(residual: FloatArray) -> FloatArray:
    """Replace the residuals (K, d) of observations without a finite prediction."""
    is_possible = np.abs(residual) < _MAX_RESIDUAL
    return residual if is_possible.all() else np.where(is_possible.all(axis=1, keepdims=True), residual, LOST_RESIDUAL)


def _limit_jacobians(flow: LinearizedWindow) -> LinearizedWindow:
    """Replace what is not finite in a linearized window, and derivatives that determine nothing."""
    usable = np.empty(len(flow.residual), np.bool_)
    ends = (flow.end, flow.end_start_jacobian, flow.end_shared_jacobian)
    is_sound = _mark_usable_rows(flow.residual, flow.start_jacobian, flow.shared_jacobian, _MAX_AMPLIFICATION, usable)
    if is_sound and all(np.abs(one).max(initial=0.0) < _MAX_AMPLIFICATION for one in ends):
        return flow
    rows = usable[:, None, None]
    by_start, by_shared = (np.where(rows, one, 0.0) for one in (flow.start_jacobian, flow.shared_jacobian))
    end, end_by_start, end_by_shared = (np.where(np.abs(one) < _MAX_AMPLIFICATION, one, 0.0) for one in ends)
    residual = _price_lost_observations(flow.residual)
    return LinearizedWindow(residual, by_start, by_shared, end, end_by_start, end_by_shared, flow.event_order)


@compile_kernel
def _mark_usable_rows(residual, by_start, by_shared, amplification, usable):  # type: ignore[no-untyped-def]
    """Mark the rows (K,) with finite residuals (K, d) and moderate Jacobians (K, d, S), (K, d, P).

    `amplification` limits their entries relative to the first row of `by_start` that is not 0: later ones shrink where
    a body comes to rest on another. Returns whether all are usable.
    """
    sizes = np.zeros(len(residual))
    first = np.inf
    for k in range(len(residual)):
        for i in range(residual.shape[1]):
            for j in range(by_start.shape[2]):
                sizes[k] = max(sizes[k], abs(by_start[k, i, j]))
        if first == np.inf and sizes[k] > 0:
            first = sizes[k]
    sound = True
    for k in range(len(residual)):
        fine = sizes[k] < amplification * first
        for i in range(residual.shape[1]):
            fine &= abs(residual[k, i]) < _MAX_RESIDUAL
            for j in range(by_start.shape[2]):
                fine &= np.isfinite(by_start[k, i, j])
            for j in range(by_shared.shape[2]):
                fine &= abs(by_shared[k, i, j]) < amplification * first
        usable[k] = fine
        sound &= fine
    return sound


def copy_contiguous(prediction: LinearizedWindow | SimulatedWindow) -> LinearizedWindow | SimulatedWindow:
    """Copy a window with arrays that are contiguous in memory, as another process would return them.

    The memory layout decides the order of summation: with it, results are bit-identical with any executor.
    """
    arrays = {one.name: np.ascontiguousarray(getattr(prediction, one.name)) for one in fields(prediction)[:-1]}
    return replace(prediction, **arrays)  # type: ignore[arg-type]


def find_sensitive_observation(start_jacobian: FloatArray) -> int:
    """Find the first observation that depends too strongly on the start state.

    Args:
        start_jacobian: (K, d, S') derivative of the observations with respect to the start state.

    Returns:
        Index of the first observation whose derivative exceeds `MAX_SENSITIVITY`; K if there is none.
    """
    if start_jacobian.size == 0:
        return len(start_jacobian)
    finite = np.isfinite(start_jacobian).all(axis=(1, 2))
    size = np.full(len(start_jacobian), np.inf)
    size[finite] = np.linalg.norm(start_jacobian[finite], axis=(1, 2), ord=2)
    over = np.flatnonzero(~(size <= MAX_SENSITIVITY))
    return int(over[0]) if len(over) else len(start_jacobian)


@dataclass(frozen=True, slots=True)
class FittedModel:
    """A model of P parameters with C common unknowns, and Q unknowns of each of B bodies; the others are fixed."""

    model: ShootingModel
    """Model of all P parameters."""
    fixed: FloatArray
    """(P,) values of the parameters that are not fitted; those of the others are not used."""
    common: BoolArray
    """(P,) whether all windows share a fitted parameter."""
    own: BoolArray
    """(P,) whether every body has a value of its own."""
    body: IntArray
    """(W,) index of the body of each window; 0 where no body has parameters of its own."""
    unknowns: tuple[Prior, ...]
    """(C + B Q,) priors of the common parameters, then of those of each body."""

    @property
    def windows(self) -> tuple[Window, ...]:
        """Windows of the underlying model."""
        return self.model.windows

    def fill_values(self, body: int, shared: FloatArray) -> FloatArray:
        """Insert the common parameters and those of a body into all (P,) parameters."""
        values = self.fixed.copy()
        values[self.common] = shared[: int(self.common.sum())]
        values[self.own] = shared[self._own_columns(body)]
        return values

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Linearize a window; the columns of other bodies are 0."""
        body = int(self.body[window])
        return self._spread_columns(body, self.model.linearize(window, start, self.fill_values(body, shared)))

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow | LinearizedWindow:
        """Simulate a window without Jacobians where the underlying model can."""
        body = int(self.body[window])
        simulated = predict_window(self.model, window, start, self.fill_values(body, shared))
        return simulated if isinstance(simulated, SimulatedWindow) else self._spread_columns(body, simulated)

    @property
    def simulates_together(self) -> bool:
        """Whether the underlying model simulates windows together."""
        return bool(getattr(self.model, "simulates_together", False))

    def simulate_ahead(
        self, windows: Sequence[int], starts: Sequence[FloatArray], shared: Sequence[FloatArray], has_jacobians: bool
    ) -> FittedModel:
        """Let the underlying model simulate windows together where it can."""
        values = [self.fill_values(int(self.body[k]), one) for k, one in zip(windows, shared, strict=True)]
        return replace(self, model=simulate_ahead(self.model, windows, starts, values, has_jacobians))

    def without_shared_jacobian(self) -> FittedModel:
        """Return the model for steps of the start states alone."""
        return replace(self, model=drop_shared_jacobian(self.model))

    def _own_columns(self, body: int) -> slice:
        """Return the columns of the parameters of a body."""
        first, size = int(self.common.sum()), int(self.own.sum())
        return slice(first + body * size, first + (body + 1) * size)

    def _spread_columns(self, body: int, prediction: LinearizedWindow) -> LinearizedWindow:
        """Spread the columns of the Jacobians by all P parameters over the unknowns, where there are any."""
        if prediction.shared_jacobian.shape[-1] == 0:
            return prediction
        return replace(
            prediction,
            shared_jacobian=self._spread(body, prediction.shared_jacobian),
            end_shared_jacobian=self._spread(body, prediction.end_shared_jacobian),
        )

    def _spread(self, body: int, jacobian: FloatArray) -> FloatArray:
        spread = np.zeros((*jacobian.shape[:-1], len(self.unknowns)))
        spread[..., : int(self.common.sum())] = jacobian[..., self.common]
        spread[..., self._own_columns(body)] = jacobian[..., self.own]
        return spread


def fix_parameters(model: ShootingModel, values: FloatArray, free: BoolArray, priors: tuple[Prior, ...]) -> FittedModel:
    """Fix some parameters of a model, so that the others can be fitted.

    Args:
        model: Model of all P parameters.
        values: (P,) values of the fixed parameters; those of free ones are not used.
        free: (P,) whether a parameter is fitted.
        priors: (P,) priors of all parameters.

    Returns:
        The model whose unknowns are the free parameters.
    """
    unknowns = tuple(prior for prior, is_free in zip(priors, free, strict=True) if is_free)
    body = np.zeros(len(model.windows), np.int64)
    return FittedModel(model, values, free, np.zeros(len(free), bool), body, unknowns)
