"""Spin decay: the cloth stops a ball that turns about the vertical.

|wz| falls at a constant rate, whatever else the ball does. It is seen only after the next contact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class SpinDecay:
    """One rate for all spins."""

    name: str = "spin_decay"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("cushion_contact", "ball_contact")
    parameters: tuple[Prior, ...] = (Prior("rate", "rad/s2", 10.0, 0.5, True, (0.1, 60.0)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("cushion_friction",)
    reference: str = "Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 5 to 15 rad/s2"
