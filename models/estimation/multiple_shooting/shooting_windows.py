"""Windows of a recording, the simulation of a window, and the protocol of a model that simulates windows."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.physics.effect import Prior

MAX_SENSITIVITY = 40.0
"""|dx/dx0| beyond which a window should have ended: 1 mm at its start becomes 4 cm there."""


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
    `linearize`, and `without_shared_jacobian()`, which returns a model whose Jacobians by the shared parameters are
    empty.
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
        The simulated or linearized window.
    """
    look: Callable[[int, FloatArray, FloatArray], SimulatedWindow | LinearizedWindow] = getattr(
        model, "simulate", model.linearize
    )
    return look(window, start, shared)


def copy_contiguous(prediction: LinearizedWindow | SimulatedWindow) -> LinearizedWindow | SimulatedWindow:
    """Copy a window with arrays that are contiguous in memory, as another process would return them.

    The memory layout decides the order of summation: with it, results are bit-identical with any executor.
    """
    if isinstance(prediction, SimulatedWindow):
        return SimulatedWindow(
            np.ascontiguousarray(prediction.residual), np.ascontiguousarray(prediction.end), prediction.event_order
        )
    return LinearizedWindow(
        np.ascontiguousarray(prediction.residual),
        np.ascontiguousarray(prediction.start_jacobian),
        np.ascontiguousarray(prediction.shared_jacobian),
        np.ascontiguousarray(prediction.end),
        np.ascontiguousarray(prediction.end_start_jacobian),
        np.ascontiguousarray(prediction.end_shared_jacobian),
        prediction.event_order,
    )


def find_sensitive_observation(start_jacobian: FloatArray, limit: float = MAX_SENSITIVITY) -> int:
    """Find the first observation that depends too strongly on the start state.

    Args:
        start_jacobian: (K, d, S') derivative of the observations with respect to the start state.
        limit: Largest acceptable spectral norm of one observation's derivative.

    Returns:
        Index of the first observation above the limit; K if there is none.
    """
    if start_jacobian.size == 0:
        return len(start_jacobian)
    size = np.linalg.norm(start_jacobian, axis=(1, 2), ord=2)
    over = np.flatnonzero(~(size <= limit))
    return int(over[0]) if len(over) else len(start_jacobian)
