"""Cushion restitution: the share of the speed towards a cushion that comes back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class CushionRestitution:
    """For slow balls; what depends on speed is an effect of its own."""

    name: str = "cushion_restitution"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("cushion_contact",)
    parameters: tuple[Prior, ...] = (Prior("e", "1", 0.75, 0.2, False, (0.2, 1.0)),)
    neutral: tuple[float, ...] = (1.0,)
    partners: tuple[str, ...] = ("cushion_restitution_speed",)
    reference: str = "Mathavan, Jackson, Parkin 2010, doi:10.1243/09544062JMES1964: 0.75 to 0.98 by law and speed"
