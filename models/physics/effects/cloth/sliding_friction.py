"""Sliding friction: Coulomb friction between ball and cloth, until the ball rolls.

The contact point slips with u; the centre accelerates by -mu g u/|u|, and u itself shrinks at 7/2 mu g.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class SlidingFriction:
    """Coulomb friction between ball and cloth; it carries spin into motion."""

    name: str = "sliding_friction"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("after_strike", "ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (Prior("mu", "1", 0.2, 0.25, True, (0.05, 0.5)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ()
    reference: str = "Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.15 to 0.25"
