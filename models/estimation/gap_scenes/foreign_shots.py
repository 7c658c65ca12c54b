"""Billiards with the user's own simulator: what it predicts, and how that differs from our engine under equal physics.

Shots of a user's engine cannot be differentiated, and it lacks what is looked for. A prediction is therefore that of
the other engine, under all that it can hold, plus what our engine adds for the rest: ours with everything, minus ours
with what the other holds. Without further effects it is the other's alone. Derivatives are those of our engine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from models.core.scene import Table
from models.core.typing import BoolArray, FloatArray
from models.estimation.whole_shot.shot_windows import ShotWindows, frame_times
from models.estimation.whole_shot.window_simulation import ObservedStates, WindowRun
from models.physics.billiards.simulation.parametrised_shot import (
    NEUTRAL_SHOT_PARAMETERS,
    SHOT_PARAMETERS,
    ContactModels,
    build_balls,
)
from models.physics.effect import Effect

# Change of a deviation, as a part of the least standard deviation, below which one that was simulated nearby serves.
_ENOUGH = 0.02
# m: length of a shot. A deviation changes by its share of this where the shot itself changes.
_USUAL_PATH = 1.0


class BilliardsSimulator(Protocol):
    """An engine of billiards from outside."""

    @property
    def name(self) -> str:
        """For sentences."""

    @property
    def laws(self) -> ContactModels:
        """Our contact models that are its own, or come nearest."""

    @property
    def stated(self) -> Mapping[str, float]:
        """Values of the parameters `effect.parameter` that it has."""

    @property
    def nose_height(self) -> float:
        """Height of its cushions over the radius of a ball."""

    def holds(self, laws: ContactModels) -> frozenset[str]:
        """Name the parameters that it can hold with these contact models."""

    def simulate(
        self, states: FloatArray, table: Table, values: Mapping[str, float], laws: ContactModels, t: FloatArray
    ) -> FloatArray | None:
        """Simulate a shot.

        Args:
            states: (N, 7) x, y, vx, vy, wx, wy, wz in m, m/s and rad/s.
            table: Table with radius and mass of all balls.
            values: Values of the parameters that it holds.
            laws: Contact models.
            t: (T,) s, increasing from 0 on.

        Returns:
            Places (T, N, 2) m; None where it fails.
        """


def state_effects(effects: tuple[Effect, ...], simulator: BilliardsSimulator) -> tuple[Effect, ...]:
    """Write the values that a simulator states into the priors of its effects."""
    stated = simulator.stated
    return tuple(
        replace(
            effect,
            parameters=tuple(
                replace(
                    one,
                    value=(value := stated.get(f"{effect.name}.{one.name}", one.value)),
                    bounds=(min(one.bounds[0], value), max(one.bounds[1], value)),
                )
                for one in effect.parameters
            ),
        )
        for effect in effects
    )


@dataclass(frozen=True)
class ForeignShotWindows(ShotWindows):
    """Segments of shots as another engine plays them."""

    simulator: BilliardsSimulator = field(kw_only=True)
    deviations: dict[int, tuple[FloatArray, FloatArray | None]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """By window: path (T, N, 2) of our engine, and what the other adds to it there."""

    def without_shared_jacobian(self) -> ForeignShotWindows:
        """Return the model without Jacobians by the unknown parameters; both share what was simulated."""
        narrow = super().without_shared_jacobian()
        assert isinstance(narrow, ForeignShotWindows)
        object.__setattr__(narrow, "deviations", self.deviations)
        return narrow

    def predict_observed_path(self, window: int, start: FloatArray, shared: FloatArray) -> FloatArray:
        """Predict where balls would be observed at all times of a window, also where they were not."""
        path = super().predict_observed_path(window, start, shared)
        deviation = self._find_deviation(window, start, self.fill_values(shared))
        return np.full_like(path, np.nan) if deviation is None else path + deviation

    def _simulate_observations(
        self, window: int, start: FloatArray, values: FloatArray
    ) -> tuple[WindowRun, ObservedStates] | None:
        simulated = super()._simulate_observations(window, start, values)
        if simulated is None or (deviation := self._find_deviation(window, start, values)) is None:
            return None
        run, observed = simulated
        segment = self.segments[window]
        off = deviation[segment.observation_indices]
        residual = observed.residual + (segment.observation_whitening @ off[..., None])[..., 0]
        return run, replace(observed, xy=observed.xy + off, residual=residual)

    @cached_property
    def _is_held(self) -> BoolArray:
        """(Q,) parameters that the other engine holds."""
        return np.isin(SHOT_PARAMETERS, list(self.simulator.holds(self.laws)))

    def _find_deviation(self, window: int, start: FloatArray, values: FloatArray) -> FloatArray | None:
        """Find what the other engine adds (T, N, 2) to ours under what it holds; None where it fails."""
        segment, assumed = self.segments[window], np.where(self._is_held, values, NEUTRAL_SHOT_PARAMETERS)
        t = np.maximum(frame_times(segment, values), 0.0)
        run = self._simulate_possible_start(window, start, assumed, float(t[-1]) + 1.0)
        if run is None:
            return None
        ours = run.states_at(t)[..., :2]
        before, deviation = self.deviations.get(window, (ours, None))
        if deviation is not None:
            share = float(np.abs(deviation).max()) / _USUAL_PATH
            least = 1.0 / float(np.nanmax(segment.whitening))
            if float(np.nanmax(np.abs(ours - before), initial=0.0)) * share <= _ENOUGH * least:
                return deviation
        given = {SHOT_PARAMETERS[k]: float(assumed[k]) for k in np.flatnonzero(self._is_held)}
        states = build_balls(start, segment.moving, self.table, assumed).state
        theirs = self.simulator.simulate(states, self.table, given, self.laws, t)
        # a ball in a pocket of ours, which the other has not, stays there
        self.deviations[window] = ours, None if theirs is None else np.nan_to_num(theirs - ours)
        return self.deviations[window][1]
