"""Cushion restitution: the share of the normal speed that a cushion gives back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.effects.effect import Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class CushionRestitution:
    """One number for all speeds and angles: laws differ, so the prior is wide."""

    name: str = "cushion_restitution"
    phases: tuple[Phase, ...] = ("cushion_contact",)
    parameters: tuple[Prior, ...] = (Prior("e", "1", 0.75, 0.2, False, (0.2, 1.0)),)
    reference: str = "Mathavan, Jackson, Parkin 2010, doi:10.1243/09544062JMES1964: 0.75 to 0.98 by law and speed"
