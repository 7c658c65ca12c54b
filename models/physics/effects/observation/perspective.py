"""Perspective: a camera that looks at the table at an angle which the calibration missed.

A place (x, y) from the middle of the picture, in half lengths of the table, is seen at (x, y) / (1 + p_x x + p_y y).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from models.physics.effect import EffectKind, Phase, Prior


@final
@dataclass(frozen=True, slots=True)
class Perspective:
    """The two numbers of the homography that are neither affine nor a shift."""

    name: str = "perspective"
    kind: EffectKind = "observation"
    phases: tuple[Phase, ...] = ("image_region",)
    parameters: tuple[Prior, ...] = (
        Prior("p_x", "1", 0.0, 0.01, False, (-0.3, 0.3)),
        Prior("p_y", "1", 0.0, 0.01, False, (-0.3, 0.3)),
    )
    neutral: tuple[float, ...] = (0.0, 0.0)
    partners: tuple[str, ...] = ("slope", "lens_distortion")
    reference: str = "Hartley and Zisserman 2004, Multiple View Geometry, section 2.4.3"
