"""Another law of two balls that touch: a published form that fits where the assumed one does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import Phase


@final
@dataclass(frozen=True, slots=True)
class BallLaw:
    """By whether the balls rub, and how their friction falls with the slip."""

    name: str = "ball_law"
    phases: tuple[Phase, ...] = ("ball_contact",)
    forms: tuple[str, ...] = ("elastic", "inelastic", "alciatore")
    partners: tuple[str, ...] = ("ball_friction",)
    brings: tuple[str, ...] = ()
    """Effects without which a published law is not itself: the other one has a friction of its own."""
    reference: str = "docs/laws.md"
