"""Scale: lengths are seen too long or too short.

seen = scale x true, from the middle of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class Scale:
    """One factor for both directions."""

    name: str = "scale"
    kind: EffectKind = "observation"
    phases: tuple[Phase, ...] = ("image_region",)
    parameters: tuple[Prior, ...] = (Prior("seen", "1", 1.0, 0.01, False, (0.8, 1.25)),)
    neutral: tuple[float, ...] = (1.0,)
    partners: tuple[str, ...] = ("lens_distortion", "unequal_radius")
    reference: str = "A ball radius or a table length that was assumed, not measured"
