"""Rolling resistance: the cloth slows a ball that rolls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class RollingResistance:
    """The centre decelerates at mu g."""

    name: str = "rolling_resistance"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("free_roll", "after_strike", "ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (Prior("mu", "1", 0.01, 0.4, True, (0.001, 0.05)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("slope", "nap", "viscous_drag")
    reference: str = "Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.005 to 0.015"
