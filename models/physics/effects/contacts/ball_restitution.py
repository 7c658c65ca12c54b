"""Ball restitution: the share of the closing speed with which two balls part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class BallRestitution:
    """One number for all speeds."""

    name: str = "ball_restitution"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("ball_contact",)
    parameters: tuple[Prior, ...] = (Prior("e", "1", 0.94, 0.05, False, (0.7, 1.0)),)
    neutral: tuple[float, ...] = (1.0,)
    partners: tuple[str, ...] = ("unequal_mass",)
    reference: str = "Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.92 to 0.98"
