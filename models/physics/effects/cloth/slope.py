"""Slope: a table that is not level pulls every ball downhill.

g s on a ball that slides, 5/7 of it on one that rolls; a ball at rest stays while rolling resistance holds it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class Slope:
    """Constant over the table; above 0 where the surface falls towards +x, +y."""

    name: str = "slope"
    kind: EffectKind = "physics"
    phases: tuple[Phase, ...] = ("free_roll", "after_strike", "ball_contact", "cushion_contact")
    parameters: tuple[Prior, ...] = (
        Prior("slope_x", "mm/m", 0.0, 2.0, False, (-20.0, 20.0)),
        Prior("slope_y", "mm/m", 0.0, 2.0, False, (-20.0, 20.0)),
    )
    neutral: tuple[float, ...] = (0.0, 0.0)
    partners: tuple[str, ...] = ("rolling_resistance", "nap", "perspective")
    reference: str = (
        "WPA equipment specifications, section 3: level within 0.02 in over the length, some 0.2 mm/m; homes are worse"
    )
