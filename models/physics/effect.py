"""What an effect says of itself: its parameters with unit, bounds and prior, and where it acts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

Phase = Literal["free_roll", "after_strike", "ball_contact", "cushion_contact", "rest", "image_region", "time_jump"]
EffectKind = Literal["physics", "observation", "detail", "probe"]
"""What moves otherwise; what is seen otherwise; what a law leaves open and is no cause by itself (one of its partners
is); a generic smooth field that only shows the shape of what is unknown."""


@dataclass(frozen=True, slots=True)
class Prior:
    """A parameter before anything is seen."""

    name: str
    unit: str
    """SI; "1" for a pure number."""
    value: float
    """The usual value."""
    sigma: float
    """One standard deviation: of the logarithm where `relative`, else in `unit`."""
    relative: bool
    bounds: tuple[float, float]
    """What no table exceeds."""

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not low <= self.value <= high or self.sigma <= 0:
            raise ValueError(f"{self.name}: a prior lies within its bounds and has a sigma above 0")


class Effect(Protocol):
    """An effect of a catalogue: of billiards, or of any other scene."""

    @property
    def name(self) -> str:
        """As users know it."""
        ...

    @property
    def kind(self) -> EffectKind: ...

    @property
    def phases(self) -> tuple[str, ...]:
        """Where it acts: each scene has phases of its own, billiards those of `Phase`."""
        ...

    @property
    def parameters(self) -> tuple[Prior, ...]:
        """What a fit may determine; sigma is the scale of natural strengths."""
        ...

    @property
    def neutral(self) -> tuple[float, ...]:
        """Per parameter, the value at which the effect is absent; it may lie outside the bounds of its prior."""
        ...

    @property
    def partners(self) -> tuple[str, ...]:
        """Effects that it is easily confused with."""
        ...

    @property
    def reference(self) -> str:
        """Where its law and its usual values come from."""
        ...


class Choice(Protocol):
    """A choice between published forms, which acts like an effect."""

    @property
    def name(self) -> str: ...

    @property
    def phases(self) -> tuple[Phase, ...]: ...

    @property
    def forms(self) -> tuple[str, ...]: ...

    @property
    def partners(self) -> tuple[str, ...]: ...

    @property
    def brings(self) -> tuple[str, ...]:
        """Effects that belong to another form: it is not itself without them."""
        ...

    @property
    def reference(self) -> str: ...
