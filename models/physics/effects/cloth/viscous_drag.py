"""Viscous drag: a = -k v."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class ViscousDrag:
    """Against the velocity, in proportion to it."""

    name: str = "viscous_drag"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("free_roll", "after_strike", "ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (Prior("k", "1/s", 0.0, 0.05, False, (0.0, 2.0)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("air_drag", "rolling_resistance")
    reference: str = (
        "Rolling friction that grows with speed (Witters, Duymelinck 1986, doi:10.1119/1.14746): some 0.01 1/s"
    )
