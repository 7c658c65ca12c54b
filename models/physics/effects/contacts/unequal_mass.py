"""Unequal mass: the first ball of a shot is lighter or heavier than all others.

ratio = mass of every other ball over the mass of the first one. Only impacts of balls show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class UnequalMass:
    """One ratio for all other balls."""

    name: str = "unequal_mass"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("ball_contact",)
    parameters: tuple[Prior, ...] = (Prior("ratio", "1", 1.0, 0.05, False, (0.5, 2.0)),)
    neutral: tuple[float, ...] = (1.0,)
    partners: tuple[str, ...] = ("ball_restitution",)
    reference: str = "Coin-operated tables: cue balls up to 10 % heavier; worn ones some per cent lighter"
