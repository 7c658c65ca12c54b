"""Air drag: a = -k v v."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class AirDrag:
    """Against the velocity, with its square."""

    name: str = "air_drag"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("free_roll", "after_strike", "ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (Prior("k", "1/m", 0.0, 0.03, False, (0.0, 1.0)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("viscous_drag", "cushion_restitution_speed")
    reference: str = "A sphere in air: k = 3 c rho / (8 R density), 0.004 1/m for a pool ball with c = 0.45"
