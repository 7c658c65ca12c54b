"""A model whose residuals are whitened where the noise of neighbouring frames is correlated.

Noise with a correlation rho from frame to frame is a first-order autoregression: the residual minus rho times the
previous one is white (Prais and Winsten 1954). Jacobians are transformed alike, so that a fit needs no change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray
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
class NoiseChain:
    """Autoregression of the noise of a window with K observations: the previous observation of each body."""

    previous: IntArray
    """(K,) index of the previous observation of the same body; the own index where there is none."""
    correlation: FloatArray
    """(K,) correlation with the previous observation, 0 where there is none."""

    def whiten(self, values: FloatArray) -> FloatArray:
        """Whiten values (K, ...) whose errors have unit variance."""
        scale = 1 / np.sqrt(1 - self.correlation**2)
        return np.asarray(((values.T - self.correlation * values[self.previous].T) * scale).T)


def build_noise_chain(segment: Recording, correlation: float) -> NoiseChain:
    """Build the chain of the observations of a segment, in the order of its rows."""
    rows, bodies = np.nonzero(segment.is_observed)
    before, correlations = np.arange(len(rows)), np.zeros(len(rows))
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(bodies == body)
        before[own[1:]] = own[:-1]
        correlations[own[1:]] = correlation ** np.diff(segment.frame[rows[own]])
    return NoiseChain(before, correlations)


@dataclass(frozen=True, slots=True)
class WhitenedModel:
    """A model with whitened residuals, by one chain per window."""

    model: ShootingModel
    chains: tuple[NoiseChain, ...]

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of the shared parameters."""
        return self.model.unknowns

    @property
    def windows(self) -> tuple[Window, ...]:
        """Windows of the model."""
        return self.model.windows

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Linearise a window and whiten its residuals and Jacobians."""
        return self._whiten_window(window, self.model.linearize(window, start, shared))

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow | LinearizedWindow:
        """Simulate a window and whiten its residuals."""
        simulated = predict_window(self.model, window, start, shared)
        if isinstance(simulated, LinearizedWindow):
            return self._whiten_window(window, simulated)
        return replace(simulated, residual=self.chains[window].whiten(simulated.residual))

    def without_shared_jacobian(self) -> WhitenedModel:
        """Return the model without derivatives by the shared parameters."""
        return replace(self, model=drop_shared_jacobian(self.model))

    def _whiten_window(self, window: int, flow: LinearizedWindow) -> LinearizedWindow:
        """Whiten residuals and Jacobians of a linearised window."""
        own = self.chains[window]
        return replace(
            flow,
            residual=own.whiten(flow.residual),
            start_jacobian=own.whiten(flow.start_jacobian),
            shared_jacobian=own.whiten(flow.shared_jacobian),
        )
