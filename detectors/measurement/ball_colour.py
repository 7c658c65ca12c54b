"""The colour of a ball without its highlight, how much of it is white, and how dark the rest is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, FloatArray

SAMPLES = 64
REACH = 0.75
"""Part of the radius that is sampled: further out there is the dark rim."""
HIGHLIGHT_SHARE = 0.12
"""Brightest share of the samples that is left out."""
WHITE_REACH = 0.9
"""Part of the radius in which white is looked for: of a stripe it is often the rim alone."""
RIM_REACH = 0.5
"""Part of the radius from which white counts as the rim's: the spot of a number seen from the front ends there."""
PALEST_SHARE, FEWEST_PALE = 0.03, 12
"""Share of all samples of a picture, the palest, that show what white looks like in its light; at least so many."""
PALE_CHROMA = 0.8
"""What chroma takes from lightness in the order of paleness."""
WHITE_TINT, WHITE_LIGHTNESS = 0.5, 45.0
"""Chroma over lightness up to which the palest is a white in tinted light, and L* from which; else white is plain."""
PLAIN_WHITE = np.array([80.0, 0.0, 0.0])
"""CIE L*a*b* of a white ball under white light."""
TINT_APART, DARKER = 0.35, 0.5
"""Difference of chroma over lightness up to which a colour is that white in shade, and the deepest such shade."""

_TURN = np.pi * (3 - np.sqrt(5.0))
_N = np.arange(SAMPLES) + 0.5
PLACES = np.sqrt(_N / SAMPLES)[:, None] * np.column_stack([np.cos(_N * _TURN), np.sin(_N * _TURN)])
"""(SAMPLES, 2) even cover of the unit disc (sunflower, Vogel 1979, doi:10.1016/0025-5564(79)90080-4)."""


@dataclass(frozen=True, slots=True)
class Coats:
    """How K balls are painted; as the columns of `Detections`."""

    colour: FloatArray
    white: FloatArray
    white_rim: FloatArray
    value: FloatArray


def disc_samples(rgb: ByteArray, centre: FloatArray, radius: FloatArray, reach: float = REACH) -> NDArray[np.float32]:
    """RGB (K, SAMPLES, 3) inside discs."""
    at = (centre[:, None] + reach * radius[:, None, None] * PLACES).astype(np.float32)
    found = cv2.remap(rgb, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.reshape(len(centre), SAMPLES, 3), dtype=np.float32)


def ball_coats(rgb: ByteArray, centre: FloatArray, radius: FloatArray) -> Coats:
    """How balls at (K, 2) px with radii (K,) px are painted.

    White is what is as white as the palest of the picture: light is yellow in one hall and green in another.
    """
    if not len(centre):
        return Coats(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0))
    inner = disc_samples(rgb, centre, radius)
    lab = _lab(inner)
    keep = _without_highlight(lab)
    colour = (lab * keep[..., None]).sum(axis=1) / keep.sum(axis=1, keepdims=True)
    wide = _lab(disc_samples(rgb, centre, radius, WHITE_REACH))
    white = _white_of(wide)
    pale = _is_white(wide, white)
    rim = np.linalg.norm(PLACES, axis=1) * WHITE_REACH > RIM_REACH
    painted = keep & ~_is_white(lab, white)
    counted = np.where(painted.any(axis=1, keepdims=True), painted, keep)
    return Coats(colour, pale.mean(axis=1), pale[:, rim].mean(axis=1), _value(inner, counted))


def _lab(rgb: NDArray[np.float32]) -> FloatArray:
    """CIE L*a*b* (K, n, 3) of RGB (K, n, 3) of 0 to 255."""
    return np.asarray(cv2.cvtColor(rgb / np.float32(255), cv2.COLOR_RGB2LAB), dtype=np.float64)


def _without_highlight(lab: FloatArray) -> NDArray[np.bool_]:
    """Which samples (K, n) are not among the brightest of their ball."""
    lightness = lab[..., 0]
    last = int((SAMPLES - 1) * (1 - HIGHLIGHT_SHARE))
    dim: NDArray[np.bool_] = lightness <= np.partition(lightness, last, axis=1)[:, last : last + 1]
    return dim


def _value(rgb: NDArray[np.float32], counted: NDArray[np.bool_]) -> FloatArray:
    """Median (K,) of the brightest channel, 0 to 1, of the samples (K, n, 3) that count, (K, n), some of each."""
    ranked = np.sort(np.where(counted, rgb.max(axis=2), np.inf), axis=1)
    row, count = np.arange(len(ranked)), counted.sum(axis=1)
    middle = (ranked[row, (count - 1) // 2] + ranked[row, count // 2]) / 2
    return np.asarray(middle / 255, dtype=np.float64)


def _is_white(lab: FloatArray, white: FloatArray) -> NDArray[np.bool_]:
    """Which of the samples (K, n, 3) are `white` (3,), in the light or in shade."""
    tint = lab[..., 1:] / np.maximum(lab[..., :1], 1.0) - white[1:] / white[0]
    alike = (np.hypot(tint[..., 0], tint[..., 1]) < TINT_APART) & (lab[..., 0] > DARKER * white[0])
    return np.asarray(alike, dtype=np.bool_)


def _white_of(lab: FloatArray) -> FloatArray:
    """CIE L*a*b* (3,) of white in a picture, from the samples (K, n, 3) of its balls."""
    chroma = np.hypot(lab[..., 1], lab[..., 2])
    pale = np.where(_without_highlight(lab), lab[..., 0] - PALE_CHROMA * chroma, -np.inf).ravel()
    palest = np.argsort(-pale, kind="stable")[: max(FEWEST_PALE, round(PALEST_SHARE * len(pale)))]
    seen = np.median(lab.reshape(-1, 3)[palest], axis=0)
    tinted = np.hypot(seen[1], seen[2]) > WHITE_TINT * seen[0]
    return PLAIN_WHITE if tinted or seen[0] < WHITE_LIGHTNESS else seen
