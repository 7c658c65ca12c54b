"""What the diagnosis of the gap asks of a scene: recordings go in, effects are offered, windows can be simulated.

The diagnosis knows no scene and no effect. A scene offers a catalogue of effects, those that the user's simulator has
among them, and a model whose shared unknowns are the parameters of *all* of them. An absent effect stands at its
neutral values; the derivative by its parameters there is its signature, from the same simulation as everything else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import Model
from models.physics.effect import Effect


@dataclass(frozen=True, slots=True)
class Recording:
    """What was seen of one shot, or of a piece of it: T rows in time, N bodies, D coordinates."""

    shot: int
    frame: IntArray
    """(T,) pictures, growing."""
    t: FloatArray
    """(T,) s, growing."""
    bodies: tuple[str, ...]
    """N names, the same ones in every piece of a shot."""
    places: FloatArray
    """(T, N, D) in the unit of the scene; NaN where a body was not seen, in all of its coordinates."""
    sigma: FloatArray
    """(T, N) standard deviation of each coordinate; the scene whitens with it."""

    def __post_init__(self) -> None:
        rows, bodies = self.places.shape[:2]
        if self.t.shape != (rows,) or self.frame.shape != (rows,) or self.sigma.shape != (rows, bodies):
            raise ValueError("a recording needs one time and frame per row, and one sigma per row and body")
        if len(self.bodies) != bodies or np.any(np.diff(self.t) <= 0):
            raise ValueError("a recording needs one name per body, and times that grow")

    @property
    def seen(self) -> BoolArray:
        """(T, N)"""
        return np.asarray(np.isfinite(self.places).all(axis=2))

    def rows(self, first: int, last: int) -> Recording:
        """The piece of rows `first` to `last`, the last one left out."""
        part = slice(first, last)
        return replace(self, frame=self.frame[part], t=self.t[part], places=self.places[part], sigma=self.sigma[part])


@dataclass(frozen=True, slots=True)
class Alternatives:
    """A choice between published forms, such as of the cushion's law."""

    name: str
    """As an effect: cushion_law, ball_law."""
    forms: tuple[str, ...]
    assumed: str
    """What the user's simulator has; one of `forms`."""
    phases: tuple[str, ...]
    brings: tuple[str, ...] = ()
    """Effects that belong to another form: it is not itself where the simulator lacks them."""


@dataclass(frozen=True, slots=True)
class Covariates:
    """Where, when and how fast the K observations of a window were, in the order of its observations."""

    phase: tuple[str, ...]
    """(K,) free_roll, after_strike, ball_contact, cushion_contact, rest, flight, swing, slide, ..."""
    place: FloatArray
    """(K, D)"""
    velocity: FloatArray
    """(K, D)"""
    since_contact: FloatArray
    """(K,) s since the body last touched anything; NaN where it has not."""
    image: FloatArray | None
    """(K, 2) px right of and below the middle of the picture; None without a picture."""


class GapScene(Protocol):
    """A scene under diagnosis, for one set of recordings and one simulator of the user.

    Observations of a window are the seen (row, body) pairs of its piece, row by row, the bodies of a row in order.
    """

    @property
    def name(self) -> str:
        """billiards, flight, pendulum, slide."""
        ...

    @property
    def unit(self) -> str:
        """Of a coordinate: m or rad."""
        ...

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The catalogue: what these recordings allow to test, what the simulator already has included."""
        ...

    @property
    def assumed(self) -> tuple[str, ...]:
        """Names of the effects that the user's simulator has; their parameters are fitted all the same."""
        ...

    @property
    def alternatives(self) -> tuple[Alternatives, ...]: ...

    @property
    def gauges(self) -> tuple[str, ...]:
        """What no data of this kind can tell, such as the frame rate."""
        ...

    @property
    def not_tested(self) -> tuple[str, ...]:
        """Effects of the library that these recordings give no way to test, such as a lens without a picture."""
        ...

    def stretches(self, recording: Recording) -> tuple[Recording, ...]:
        """The pieces between interventions from outside (a strike, a hand), in which the motion runs on its own."""
        ...

    def model(self, pieces: tuple[Recording, ...], forms: tuple[str, ...], wanted: BoolArray | None = None) -> Model:
        """One window per piece, in their order, started at its first row; pieces that follow each other directly in one
        shot may be linked.

        `forms` names one form per entry of `alternatives`. `unknowns` are the P parameters of all effects, in the order
        of the catalogue, named `effect.parameter`; slopes are needed for those `wanted` (P,), others may be 0. Misfits
        are predicted minus seen, over the sigmas of the pieces.
        """
        ...

    def covariates(self, piece: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]) -> Covariates:
        """Of the observations of a piece, simulated from `start` (S,) with all parameters `shared` (P,)."""
        ...

    def predict(self, piece: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]) -> FloatArray:
        """(T, N, D) where every body would be seen at every row of the piece, seen or not."""
        ...


@runtime_checkable
class Eventful(Protocol):
    """A scene in which so much happens that the fit of a long piece does not find its way from what is seen alone."""

    @property
    def calm(self) -> float:
        """s, of pieces in which a fit finds its way; longer ones grow from them."""
        ...


def neutral_values(scene: GapScene) -> FloatArray:
    """(P,) all parameters of the catalogue, every effect absent."""
    return np.array([value for effect in scene.effects for value in effect.neutral], dtype=np.float64)


def parameters_of(scene: GapScene, names: tuple[str, ...]) -> BoolArray:
    """(P,) True for the parameters of the effects named."""
    return np.array([effect.name in names for effect in scene.effects for _ in effect.parameters], dtype=bool)
