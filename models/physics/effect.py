"""Description of an effect: its parameters with unit, bounds and prior, and where it acts."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Literal, final

# Phases of a billiards shot in which an effect shows.
Phase = Literal["free_roll", "after_strike", "ball_contact", "cushion_contact", "rest", "image_region", "time_jump"]
# `physics` changes the motion; `observation` changes the measurement of the same motion; `detail` is a parameter that a
# contact model leaves open and no cause by itself (one of its partners is); `probe` is a generic law, a smooth force or
# change of a contact that only shows whether the library lacks a law, and no cause either.
EffectKind = Literal["physics", "observation", "detail", "probe"]
# Where a billiards effect acts: between the cloth or the air and a ball, in a contact with a cushion, in a contact of
# two balls, in the sizes and masses of the set of balls, in the camera. The engine reads the parameters of the first
# three.
Site = Literal["cloth", "cushion", "ball", "set", "camera"]
ENGINE_SITES: tuple[Site, ...] = ("cloth", "cushion", "ball")
# Rank of an effect behind all that have a number.
LAST = sys.maxsize


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior distribution of a parameter."""

    name: str
    unit: str
    """SI; "1" for a pure number."""
    value: float
    """The usual value."""
    sigma: float
    """Standard deviation: of the logarithm if `relative`, otherwise in `unit`."""
    relative: bool
    bounds: tuple[float, float]
    """The least and the greatest value on any real table."""

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not low <= self.value <= high or self.sigma <= 0:
            raise ValueError(f"{self.name}: a prior lies within its bounds and has a sigma above 0")


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect of a catalogue, of billiards or of another scene."""

    name: str
    """Name in files and options."""
    parameters: tuple[Prior, ...]
    """Parameters that a fit may determine; sigma is the scale of natural strengths."""
    neutral: tuple[float, ...]
    """Per parameter, the value at which the effect is absent; it may lie outside the bounds of its prior."""
    phases: tuple[str, ...]
    """Phases in which the effect shows; every scene has its own, billiards has those of `Phase`."""
    reference: str
    """Source of the equation and of the usual values."""
    partners: tuple[str, ...] = ()
    """Effects and model choices with a similar signature."""
    kind: EffectKind = "physics"

    def __post_init__(self) -> None:
        if len(self.neutral) != len(self.parameters):
            raise ValueError(
                f"{self.name} has {len(self.parameters)} parameters and {len(self.neutral)} neutral values"
            )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BilliardsEffect(Effect):
    """An effect of billiards; every file in `models.physics.effects` defines one as `EFFECT`."""

    phases: tuple[Phase, ...]
    site: Site
    phrase: str = ""
    """Words for reports; empty where the name with spaces for underscores is clear."""
    limits: tuple[float, float] = (0.0, float("inf"))
    """Least and greatest value that a simulation accepts, for every parameter of the effect."""
    bends_path: bool = False
    """Whether the path of a ball on the cloth has no closed form under this effect, so that it is integrated."""
    rank: int = LAST
    """Position in the catalogue, which orders candidates in reports; effects of equal rank are sorted by name."""
    slot: int = LAST
    """Order of the parameters in the engine's vector; effects of equal slot are sorted by name."""

    @property
    def is_in_engine(self) -> bool:
        """Whether the parameters belong to the vector of the simulation engine."""
        return self.site in ENGINE_SITES

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Full names, effect and parameter: `slope.slope_x`."""
        return tuple(f"{self.name}.{prior.name}" for prior in self.parameters)


@final
@dataclass(frozen=True, slots=True)
class ModelChoice:
    """A choice between published contact models, which a diagnosis treats like an effect."""

    name: str
    phases: tuple[Phase, ...]
    forms: tuple[str, ...]
    """Names of the models."""
    partners: tuple[str, ...]
    """Effects with a similar signature."""
    companions: tuple[str, ...]
    """Effects that belong to another form: without them it is not the published model."""
    reference: str
    phrase: str
    """Words for reports."""
