"""The cloth under a ball that a nose presses down: it may rub more or less than free cloth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class CushionCloth:
    """Its friction, as a multiple of sliding friction: what laws with a rigid table leave open."""

    name: str = "cushion_cloth"
    kind: EffectKind = "detail"
    phases: tuple[Phase, ...] = ("cushion_contact",)
    parameters: tuple[Prior, ...] = (Prior("factor", "1", 1.0, 0.3, True, (0.2, 5.0)),)
    neutral: tuple[float, ...] = (1.0,)
    partners: tuple[str, ...] = ("cushion_law",)
    reference: str = (
        "Mathavan, Jackson, Parkin 2010 (doi:10.1243/09544062JMES1964), section 4: 0.21 beside a cloth's 0.2"
    )
