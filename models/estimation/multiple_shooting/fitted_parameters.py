"""A model of which some parameters are fitted: one value for all windows, or one for those of every body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import (
    LinearizedWindow,
    ShootingModel,
    SimulatedWindow,
    Window,
    drop_shared_jacobian,
    predict_window,
)
from models.physics.effect import Prior


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
