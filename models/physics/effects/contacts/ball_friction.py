"""Ball friction: two balls rub where they touch: throw, and spin that passes over.

Coulomb friction against the slip of the two surfaces, until they stick (a seventh of the slip, for equal balls).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class BallFriction:
    """One coefficient for all speeds."""

    name: str = "ball_friction"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("ball_contact",)
    parameters: tuple[Prior, ...] = (Prior("mu", "1", 0.05, 0.5, True, (0.001, 0.4)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("ball_law",)
    reference: str = "Alciatore, technical proof A-14: 0.01 to 0.11, falling with the speed of the slip"
