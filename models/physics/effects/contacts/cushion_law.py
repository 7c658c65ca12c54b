"""Another law of the cushion: a published form that fits where the assumed one does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import Phase


@final
@dataclass(frozen=True, slots=True)
class CushionLaw:
    """By height of the nose, compliance, and how friction acts during the impact."""

    name: str = "cushion_law"
    phases: tuple[Phase, ...] = ("cushion_contact",)
    forms: tuple[str, ...] = ("mirror", "han_2005", "mathavan_2010", "stronge")
    partners: tuple[str, ...] = ("cushion_restitution_speed", "cushion_friction")
    brings: tuple[str, ...] = ("cushion_friction", "cushion_cloth")
    """Effects without which a published law is hardly more than a mirror, and what it leaves open."""
    reference: str = "docs/laws.md"
