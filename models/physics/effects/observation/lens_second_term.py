"""What the first radial term of a lens leaves: r_seen = r (1 + k1 r^2 + k2 r^4), r as for `lens_distortion`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class LensSecondTerm:
    """Of fifth order; lenses of phones are corrected, and what is left bends back at the edge."""

    name: str = "lens_second_term"
    kind: EffectKind = "detail"
    phases: tuple[Phase, ...] = ("image_region",)
    parameters: tuple[Prior, ...] = (Prior("k2", "1", 0.0, 0.01, False, (-0.3, 0.3)),)
    neutral: tuple[float, ...] = (0.0,)
    partners: tuple[str, ...] = ("lens_distortion",)
    reference: str = (
        "Brown 1971, Close-range camera calibration, Photogrammetric Engineering 37: the second radial term"
    )
