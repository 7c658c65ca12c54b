"""A model whose misfits are made independent where the noise of neighbouring pictures is alike.

Noise that decays with a correlation rho from picture to picture is a first-order autoregression: the misfit less rho
times the one before it is white (Prais and Winsten 1954). Slopes are treated alike, so that a fit need not know.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import Recording
from models.estimation.multiple_shooting.shooting_windows import Flow, Glance, Model, Window, glance, narrowed
from models.physics.effect import Prior


@dataclass(frozen=True, slots=True)
class Chain:
    """Of the K observations of a window: which one of the same body came before, and what it tells of this one."""

    before: IntArray
    """(K,) number of the observation before; the own one where there is none."""
    told: FloatArray
    """(K,) correlation with it, 0 where there is none."""

    def whitened(self, values: FloatArray) -> FloatArray:
        """Of values (K, ...) with correlated errors of size 1."""
        column = (-1, *[1] * (values.ndim - 1))
        fresh = 1 / np.sqrt(1 - self.told**2)
        return np.asarray((values - self.told.reshape(column) * values[self.before]) * fresh.reshape(column))


def chain(piece: Recording, correlation: float) -> Chain:
    """Of the observations of a piece, row by row."""
    rows, bodies = np.nonzero(piece.seen)
    before, told = np.arange(len(rows)), np.zeros(len(rows))
    for body in range(len(piece.bodies)):
        own = np.flatnonzero(bodies == body)
        before[own[1:]] = own[:-1]
        told[own[1:]] = correlation ** np.diff(piece.frame[rows[own]])
    return Chain(before, told)


@dataclass(frozen=True, slots=True)
class Decorrelated:
    """`model` with misfits made independent, by one chain per window."""

    model: Model
    chains: tuple[Chain, ...]

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        return self.model.unknowns

    @property
    def windows(self) -> tuple[Window, ...]:
        return self.model.windows

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        return self._independent(window, self.model.flow(window, start, shared))

    def glance(self, window: int, start: FloatArray, shared: FloatArray) -> Glance | Flow:
        found = glance(self.model, window, start, shared)
        if isinstance(found, Flow):
            return self._independent(window, found)
        return replace(found, misfit=self.chains[window].whitened(found.misfit))

    def narrowed(self) -> Decorrelated:
        return replace(self, model=narrowed(self.model))

    def _independent(self, window: int, flow: Flow) -> Flow:
        own = self.chains[window]
        return replace(
            flow,
            misfit=own.whitened(flow.misfit),
            by_start=own.whitened(flow.by_start),
            by_shared=own.whitened(flow.by_shared),
        )
