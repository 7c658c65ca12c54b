"""Rolling resistance: a ball that rolls freely decelerates at mu g."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.effects.effect import Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class RollingResistance:
    """The cloth takes energy from a rolling ball, at all speeds alike."""

    name: str = "rolling_resistance"
    phases: tuple[Phase, ...] = ("free_roll",)
    parameters: tuple[Prior, ...] = (Prior("mu", "1", 0.010, 0.4, True, (0.001, 0.05)),)
    reference: str = "Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.005 to 0.015"
