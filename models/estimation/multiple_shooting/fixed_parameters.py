"""A model with some of its shared parameters fixed at given values, so that the others can be fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.core.typing import BoolArray, FloatArray
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
class FixedParameterModel:
    """A model whose unknowns are the `free` parameters of another model; the others are fixed."""

    model: ShootingModel
    shared: FloatArray
    """(P,) values of the fixed parameters; those of free parameters are not used."""
    free: BoolArray
    """(P,) whether a parameter is fitted."""
    priors: tuple[Prior, ...]
    """(P,) priors of all parameters."""

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of the free parameters."""
        return tuple(prior for prior, free in zip(self.priors, self.free, strict=True) if free)

    @property
    def windows(self) -> tuple[Window, ...]:
        """Windows of the underlying model."""
        return self.model.windows

    def fill_values(self, shared: FloatArray) -> FloatArray:
        """Insert the free parameters into all (P,) parameters."""
        values = self.shared.copy()
        values[self.free] = shared
        return values

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Linearize a window; Jacobians by the shared parameters have columns of the free ones only."""
        return self._select_free_columns(self.model.linearize(window, start, self.fill_values(shared)))

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow | LinearizedWindow:
        """Simulate a window without Jacobians where the underlying model can."""
        simulated = predict_window(self.model, window, start, self.fill_values(shared))
        return simulated if isinstance(simulated, SimulatedWindow) else self._select_free_columns(simulated)

    def without_shared_jacobian(self) -> FixedParameterModel:
        """Return the model for steps of the start states alone."""
        return replace(self, model=drop_shared_jacobian(self.model))

    def _select_free_columns(self, prediction: LinearizedWindow) -> LinearizedWindow:
        """Select the columns of the free parameters in the Jacobians, where there are any."""
        if prediction.shared_jacobian.shape[-1] == 0:
            return prediction
        return replace(
            prediction,
            shared_jacobian=prediction.shared_jacobian[..., self.free],
            end_shared_jacobian=prediction.end_shared_jacobian[..., self.free],
        )
