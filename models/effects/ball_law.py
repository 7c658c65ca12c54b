"""Another law of two balls that touch: a published form that fits where the assumed one does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.effects.effect import Phase


@final
@dataclass(frozen=True, slots=True)
class BallLaw:
    """By whether the balls rub, and how their friction falls with the slip."""

    name: str = "ball_law"
    phases: tuple[Phase, ...] = ("ball_contact",)
    forms: tuple[str, ...] = ("elastic", "inelastic", "alciatore")
    partners: tuple[str, ...] = ("ball_friction",)
    reference: str = "docs/laws.md"
