"""Cushion friction: the nose rubs along the ball, and turns side spin into motion.

Coulomb friction during the impact, until the surface stops slipping; how the law of the cushion holds it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class CushionFriction:
    """One coefficient for all speeds."""

    name: str = "cushion_friction"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("cushion_contact",)
    parameters: tuple[Prior, ...] = (Prior("mu", "1", 0.17, 0.4, True, (0.01, 0.6)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("spin_decay", "cushion_law")
    reference: str = (
        "Mathavan, Jackson, Parkin 2010 (doi:10.1243/09544062JMES1964): 0.14; Han 2005 (doi:10.1007/BF02919180): 0.2"
    )
