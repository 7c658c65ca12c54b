"""Interface between the diagnosis of the sim-to-real gap and a scene: effects and models of windows.

The diagnosis knows no scene and no effect. A scene offers a catalogue of effects, including those that the user's
simulator has, and a model whose shared unknowns are the parameters of *all* of them. An absent effect has its neutral
parameter values; the derivative by its parameters there is its signature, from the same simulation as everything else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.multiple_shooting.shooting_windows import ShootingModel
from models.physics.effect import Effect


@dataclass(frozen=True, slots=True)
class Alternatives:
    """A choice between published contact models, such as those of a cushion."""

    name: str
    """Named like an effect: cushion_law, ball_law."""
    forms: tuple[str, ...]
    simulator_form: str
    """The one of `forms` that the user's simulator has."""
    phases: tuple[str, ...]
    companions: tuple[str, ...] = ()
    """Effects that belong to another form: it is incomplete where the simulator lacks them."""
    standard_values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """By form, parameters `effect.parameter` whose neutral value is that of the form, and those values."""


@dataclass(frozen=True, slots=True)
class Covariates:
    """Position, phase and velocity of the K observations of a window, in the order of its observations."""

    phase: tuple[str, ...]
    """(K,) free_roll, after_strike, ball_contact, cushion_contact, rest; wall_contact, flight, swing, slide."""
    position: FloatArray
    """(K, D) in the unit of the scene."""
    velocity: FloatArray
    """(K, D) in the unit of the scene per s."""
    since_contact: FloatArray
    """(K,) s since the last contact of the body; NaN where there was none."""
    image: FloatArray | None
    """(K, 2) px to the right of and below the image centre; None without an image."""


class GapScene(Protocol):
    """A scene under diagnosis, for one set of recordings and one simulator of the user.

    The observations of a window are the observed (row, body) pairs of its segment, row by row, the bodies of a row in
    order.
    """

    @property
    def name(self) -> str:
        """One of billiards, flight, pendulum, slide, mechanism."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The catalogue: effects that these recordings allow to test, including those of the simulator."""

    @property
    def simulator_effects(self) -> tuple[str, ...]:
        """Names of the effects that the user's simulator has; their parameters are fitted as well."""

    @property
    def alternatives(self) -> tuple[Alternatives, ...]:
        """Choices between published contact models."""

    @property
    def gauges(self) -> tuple[str, ...]:
        """Quantities that no data of this kind can identify, such as the frame rate."""

    @property
    def not_tested(self) -> tuple[str, ...]:
        """Effects of the library that these recordings cannot test, such as lens distortion without an image."""

    @property
    def is_smooth(self) -> bool:
        """Whether fits need no measures against jumps of the cost: no wall, no standstill and no chaos in a window."""

    @property
    def has_stated_values(self) -> bool:
        """Whether the priors of the effects that the simulator has are what its file states."""

    @property
    def least_gain(self) -> float:
        """Relative gain of a step below which a fit ends."""

    def split_recording(self, recording: Recording) -> tuple[Recording, ...]:
        """Split a recording at external interventions (a strike, a hand), between which the motion is autonomous."""

    def build_model(
        self, segments: tuple[Recording, ...], forms: tuple[str, ...], jacobian_mask: BoolArray | None = None
    ) -> ShootingModel:
        """Build a model with one window per segment, in their order, each started at its first row.

        Consecutive segments of one shot may be linked. `unknowns` are the P parameters of all effects, in the order of
        the catalogue, named `effect.parameter`. Residuals are predicted minus observed, divided by the sigmas of the
        segments.

        Args:
            segments: Segments of recordings.
            forms: One form per entry of `alternatives`.
            jacobian_mask: (P,) parameters whose Jacobian is needed; that of others may be 0. None: all.

        Returns:
            The model.
        """

    def observation_covariates(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> Covariates:
        """Compute the covariates of the observations of a segment.

        Args:
            segment: Segment of a recording.
            start: (S,) start state.
            shared: (P,) parameters of all effects.
            forms: One form per entry of `alternatives`.

        Returns:
            Covariates of the K observations, from a simulation.
        """

    def predict_positions(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> FloatArray:
        """Predict where every body would be observed at every row of a segment, also where it was not.

        Args:
            segment: Segment of a recording.
            start: (S,) start state.
            shared: (P,) parameters of all effects.
            forms: One form per entry of `alternatives`.

        Returns:
            (T, N, D) in the unit of the scene.
        """


@runtime_checkable
class ContactRichScene(Protocol):
    """A scene with so many contacts that the fit of a long segment does not converge from an initial guess alone."""

    @property
    def initial_window_length(self) -> float:
        """s, duration of segments whose fit converges; longer ones are fitted by continuation."""

    def find_bridged_rows(self, segment: Recording) -> tuple[int, ...]:
        """Find the rows at which an effect may act at once: it shows only in a window that reaches across.

        Args:
            segment: Segment of a recording.

        Returns:
            The first row after each such moment.
        """


@runtime_checkable
class PartlyObservedScene(Protocol):
    """A scene that may have joints without a sensor."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Joints without a sensor, whose start other joints hardly show; empty where there are none."""


def neutral_values(scene: GapScene, forms: tuple[str, ...] | None = None) -> FloatArray:
    """Collect the parameter values of a catalogue with every effect absent.

    Args:
        scene: Scene with a catalogue of effects.
        forms: One form per entry of `alternatives`; those of the simulator where not given.

    Returns:
        (P,) neutral values.
    """
    standard: dict[str, float] = {}
    forms = tuple(choice.simulator_form for choice in scene.alternatives) if forms is None else forms
    for choice, form in zip(scene.alternatives, forms, strict=True):
        standard |= choice.standard_values.get(form, {})
    return np.array(
        [
            standard.get(f"{effect.name}.{prior.name}", value)
            for effect in scene.effects
            for prior, value in zip(effect.parameters, effect.neutral, strict=True)
        ],
        dtype=np.float64,
    )


def effect_parameter_mask(scene: GapScene, names: tuple[str, ...]) -> BoolArray:
    """Mark the parameters of the named effects.

    Args:
        scene: Scene with a catalogue of effects.
        names: Names of effects.

    Returns:
        (P,) True for a parameter of one of these effects.
    """
    return np.array([effect.name in names for effect in scene.effects for _ in effect.parameters], dtype=bool)
