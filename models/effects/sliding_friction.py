"""Sliding friction: a ball that slips is accelerated at mu g against its slip until it rolls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.effects.effect import Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class SlidingFriction:
    """Coulomb friction between ball and cloth; it carries spin into motion."""

    name: str = "sliding_friction"
    phases: tuple[Phase, ...] = ("after_strike", "ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (Prior("mu", "1", 0.2, 0.25, True, (0.05, 0.5)),)
    reference: str = "Alciatore, billiards.colostate.edu, physical properties of billiard equipment: 0.15 to 0.25"
