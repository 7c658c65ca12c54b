"""Nap: the fibres of a snooker cloth lie one way, here towards +x.

A ball that rolls at an angle a to +x is slowed at (mu_r - mu cos a) g: less with the nap than against it. The table
cannot be made to drive a ball: |mu| stays below rolling resistance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class Nap:
    """Rolling resistance hangs on the direction of travel; below 0 where the nap lies towards -x."""

    name: str = "nap"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("free_roll",)
    parameters: tuple[Prior, ...] = (Prior("mu", "1", 0.0, 0.002, False, (-0.02, 0.02)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("slope", "rolling_shutter")
    reference: str = "Cloths with a nap (snooker, English billiards): balls run further with it than against it"
