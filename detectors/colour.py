"""The colour of a ball without its highlight, and how much of it is white."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

SAMPLES = 64
REACH = 0.75
"""Part of the radius that is sampled: further out there is the dark rim."""
HIGHLIGHT_SHARE = 0.12
"""Brightest share of the samples that is left out."""
WHITE_LIGHTNESS = 55.0
"""L* from which a grey is a white."""
WHITE_CHROMA = 0.42
"""Chroma over lightness below which a light colour is white, under yellow light too."""

_TURN = np.pi * (3 - np.sqrt(5.0))
_N = np.arange(SAMPLES) + 0.5
PLACES = np.sqrt(_N / SAMPLES)[:, None] * np.column_stack([np.cos(_N * _TURN), np.sin(_N * _TURN)])
"""(SAMPLES, 2) even cover of the unit disc (sunflower, Vogel 1979, doi:10.1016/0025-5564(79)90080-4)."""


def disc_samples(rgb: Bytes, centre: Floats, radius: Floats, reach: float = REACH) -> NDArray[np.float32]:
    """RGB (K, SAMPLES, 3) inside discs."""
    at = (centre[:, None] + reach * radius[:, None, None] * PLACES).astype(np.float32)
    found = cv2.remap(rgb, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.reshape(len(centre), SAMPLES, 3), dtype=np.float32)


def ball_colours(rgb: Bytes, centre: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Mean CIE L*a*b* (K, 3) without the highlight and share of white (K,) of balls at (K, 2) px."""
    if not len(centre):
        return np.empty((0, 3)), np.empty(0)
    lab = cv2.cvtColor(disc_samples(rgb, centre, radius) / np.float32(255), cv2.COLOR_RGB2LAB).astype(np.float64)
    lightness, chroma = lab[..., 0], np.hypot(lab[..., 1], lab[..., 2])
    white = (lightness > WHITE_LIGHTNESS) & (chroma < WHITE_CHROMA * lightness)
    bright = np.quantile(lightness, 1 - HIGHLIGHT_SHARE, axis=1, keepdims=True)
    keep = (lightness <= bright)[..., None]
    return (lab * keep).sum(axis=1) / keep.sum(axis=1), white.mean(axis=1)
