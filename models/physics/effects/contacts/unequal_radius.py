"""Unequal radius: the first ball of a shot is smaller or larger than all others.

ratio = radius of every other ball over the radius of the first one: it shifts the times and places of contacts. The
centres of all balls are taken to be in one plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class UnequalRadius:
    """One ratio for all other balls."""

    name: str = "unequal_radius"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (Prior("ratio", "1", 1.0, 0.02, False, (0.8, 1.25)),)
    neutral: tuple[float, ...] = (1.0,)
    partners: tuple[str, ...] = ("scale", "lens_distortion")
    reference: str = "Coin-operated tables: cue balls of 2 3/8 in among balls of 2 1/4 in; worn ones are smaller"
