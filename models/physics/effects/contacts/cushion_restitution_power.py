"""How restitution falls with speed otherwise than in proportion: e = e0 v^-power - slope v, v in m/s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class CushionRestitutionPower:
    """What a straight line leaves open: much of it is lost at low speeds already."""

    name: str = "cushion_restitution_power"
    kind: EffectKind = "detail"
    phases: tuple[Phase, ...] = ("cushion_contact",)
    parameters: tuple[Prior, ...] = (Prior("power", "1", 0.0, 0.1, False, (-0.2, 0.6)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("cushion_restitution_speed",)
    reference: str = "Johnson 1985, Contact Mechanics, section 11.5: e falls with the fourth root of the speed"
