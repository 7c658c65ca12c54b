"""Lens distortion: r_seen = r (1 + k1 r^2).

r is the distance from the middle of the picture, in half lengths of the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class LensDistortion:
    """Radial, of third order; k1 > 0 is a pincushion."""

    name: str = "lens_distortion"
    kind: EffectKind = "observation"
    phases: tuple[Phase, ...] = ("image_region",)
    parameters: tuple[Prior, ...] = (Prior("k1", "1", 0.0, 0.02, False, (-0.3, 0.3)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("scale", "unequal_radius")
    reference: str = "Brown 1971, Close-range camera calibration, Photogrammetric Engineering 37: the first radial term"
