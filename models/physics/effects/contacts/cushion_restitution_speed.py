"""Cushion restitution that falls with speed: e = e0 - slope v.

v is the speed towards the cushion at impact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class CushionRestitutionSpeed:
    """In proportion to the normal speed."""

    name: str = "cushion_restitution_speed"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("cushion_contact",)
    parameters: tuple[Prior, ...] = (Prior("slope", "s/m", 0.0, 0.05, False, (-0.2, 0.2)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("air_drag", "cushion_restitution")
    reference: str = (
        "Mathavan, Jackson, Parkin 2010 (doi:10.1243/09544062JMES1964): restitution falls with the speed of the impact"
    )
