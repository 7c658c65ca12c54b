"""A model with some of its shared numbers held at given values: what is left can be fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.core.typing import BoolArray, FloatArray
from models.estimation.multiple_shooting.shooting_windows import Flow, Glance, Model, Window, glance, narrowed
from models.physics.effect import Prior


@dataclass(frozen=True, slots=True)
class Held:
    """The unknowns of `model` that are `free`, the others at the values `shared`."""

    model: Model
    shared: FloatArray
    """(P,) values; those of free numbers are not used."""
    free: BoolArray
    """(P,)"""
    priors: tuple[Prior, ...]
    """(P,) what is known of all numbers beforehand."""

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        return tuple(prior for prior, free in zip(self.priors, self.free, strict=True) if free)

    @property
    def windows(self) -> tuple[Window, ...]:
        return self.model.windows

    def whole(self, shared: FloatArray) -> FloatArray:
        """(P,) all numbers, from the free ones."""
        values = self.shared.copy()
        values[self.free] = shared
        return values

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        return self._freed(self.model.flow(window, start, self.whole(shared)))

    def glance(self, window: int, start: FloatArray, shared: FloatArray) -> Glance | Flow:
        found = glance(self.model, window, start, self.whole(shared))
        return found if isinstance(found, Glance) else self._freed(found)

    def narrowed(self) -> Held:
        return replace(self, model=narrowed(self.model))

    def _freed(self, flow: Flow) -> Flow:
        """Its slopes by the free numbers, where it has slopes by shared ones."""
        if flow.by_shared.shape[-1] == 0:
            return flow
        return replace(flow, by_shared=flow.by_shared[..., self.free], end_by_shared=flow.end_by_shared[..., self.free])
