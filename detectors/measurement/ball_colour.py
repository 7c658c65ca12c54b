"""Colours of balls: without the highlight, the white share, and the brightness of the rest."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.srgb import LUMA_601
from models.core.typing import BoolArray, ByteArray, FloatArray

# Samples of a ball.
SAMPLES = 64
# Radius, ball radii, within which the colour is sampled: farther out there is the dark rim.
SAMPLED_RADII = 0.75
# Brightest share of the samples that is excluded.
HIGHLIGHT_SHARE = 0.12
# Radius, ball radii, within which white is measured: a stripe often has it at the rim alone.
WHITE_SAMPLED_RADII = 0.9
# Radius, ball radii, from which white counts as that of the rim: the spot of a number seen from the front ends there.
RIM_RADII = 0.5
# Share of all samples of an image, the palest, from which white in its light is estimated, and their least number.
PALEST_SHARE, MIN_PALE_SAMPLES = 0.03, 12
# Weight of chroma against lightness in the order of paleness.
CHROMA_PENALTY = 0.8
# Chroma over lightness up to which, and L* from which, the palest is a white in tinted light; else white is plain.
MAX_WHITE_TINT, MIN_WHITE_LIGHTNESS = 0.5, 45.0
# CIE L*a*b* of a white ball under white light.
PLAIN_WHITE = np.array([80.0, 0.0, 0.0])
# Difference of chroma over lightness up to which a colour is that white in shade, and least lightness over the white's.
MAX_TINT_DIFFERENCE, MIN_SHADE_LIGHTNESS = 0.35, 0.5
# Standard deviation of a disc's luma over its level below which it is no sphere. A matte one in even light has 0.025
# (half the cosine of its slope, in sRGB). Balls also mirror lamps: of 726 detections in real clips none is below 0.047,
# overexposed ones aside. Drawn discs have 0.007 to 0.02, by coding alone; not so in colour, whose resolution is half of
# luma's, so that the edge of a small disc reaches its middle.
FLAT_SHARE = 0.022
# Least level for this share: coding alone gives a dark drawn disc a standard deviation of one level, and a dark ball
# that mirrors no lamp hardly more.
MIN_FLAT_LEVEL = 80.0
# Weights of red, green and blue in the precision of samples.
LUMA = LUMA_601.astype(np.float32)
# Level of two channels, the white of studio range, from which a camera no longer records shading. A sphere that is so
# bright or so dark still hides light from the cloth beside it: the darkest sixth of the ring around it has at most 0.88
# of the luma of the cloth farther out in real clips, that around discs and spots of light that are drawn at least 0.97.
EXPOSED_LEVEL, MAX_SHADED_SHARE = 235.0, 0.93
# Radii of these rings in ball radii, and the directions of which eight in succession are that sixth.
NEAR_RADII, FAR_RADII, DIRECTIONS, SECTOR = (1.2, 1.35, 1.5), (2.2, 2.5, 2.8), 48, 8

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5.0))
_SAMPLE_NUMBERS = np.arange(SAMPLES) + 0.5
# (SAMPLES, 2) even coverage of the unit disc (sunflower, Vogel 1979, doi:10.1016/0025-5564(79)90080-4).
DISC_SAMPLES = np.sqrt(_SAMPLE_NUMBERS / SAMPLES)[:, None] * np.column_stack(
    [np.cos(_SAMPLE_NUMBERS * _GOLDEN_ANGLE), np.sin(_SAMPLE_NUMBERS * _GOLDEN_ANGLE)]
)


@dataclass(frozen=True, slots=True)
class BallColours:
    """Colours of K balls; as the columns of `Detections`."""

    colour: FloatArray
    white: FloatArray
    white_rim: FloatArray
    value: FloatArray


def sample_discs(
    rgb: ByteArray, centre: FloatArray, radius: FloatArray, reach: float = SAMPLED_RADII
) -> NDArray[np.float32]:
    """Sample RGB (K, SAMPLES, 3) inside discs."""
    at = (centre[:, None] + reach * radius[:, None, None] * DISC_SAMPLES).astype(np.float32)
    samples = cv2.remap(rgb, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(samples.reshape(len(centre), SAMPLES, 3), dtype=np.float32)


def find_flat_discs(rgb: ByteArray, centre: FloatArray, radius: FloatArray) -> BoolArray:
    """Find discs that have one level throughout, as graphics drawn over an image have, and no lit sphere.

    Args:
        rgb: Image (H, W, 3).
        centre: Centres (K, 2) px.
        radius: Radii (K,) px.

    Returns:
        Mask (K,).
    """
    if not len(centre):
        return np.zeros(0, dtype=np.bool_)
    samples = sample_discs(rgb, centre, radius)
    luma, level = samples @ LUMA, np.sort(np.median(samples, axis=1), axis=1)
    brightness = np.median(luma, axis=1)
    is_flat = luma.std(axis=1) < FLAT_SHARE * np.maximum(brightness, MIN_FLAT_LEVEL)
    unrecorded = np.flatnonzero(is_flat & ((level[:, -2] >= EXPOSED_LEVEL) | (brightness < MIN_FLAT_LEVEL)))
    is_flat[unrecorded] = [_measure_shade(rgb, centre[k], float(radius[k])) > MAX_SHADED_SHARE for k in unrecorded]
    return np.asarray(is_flat)


def _measure_shade(rgb: ByteArray, centre: FloatArray, radius: float) -> float:
    """Measure the luma of the darkest sector of the ring around a disc over that of the surface farther out."""
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    reach = radius * np.array([*NEAR_RADII, *FAR_RADII], np.float32)[:, None]
    x, y = (
        np.float32(middle + reach * turn) for middle, turn in zip(centre, (np.cos(angle), np.sin(angle)), strict=True)
    )
    luma = cv2.remap(rgb, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) @ LUMA
    near = luma[: len(NEAR_RADII)].mean(axis=0)
    sectors = np.convolve(np.append(near, near[: SECTOR - 1]), np.full(SECTOR, 1 / SECTOR), "valid")
    return float(sectors.min() / max(np.median(luma[len(NEAR_RADII) :]), 1.0))


def measure_ball_colours(rgb: ByteArray, centre: FloatArray, radius: FloatArray) -> BallColours:
    """Measure the colours of balls.

    White is relative to the palest colour of the balls: light is yellow in one venue and green in another.

    Args:
        rgb: Image (H, W, 3).
        centre: Centres (K, 2) px.
        radius: Radii (K,) px.

    Returns:
        The colours.
    """
    if not len(centre):
        return BallColours(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0))
    inner = sample_discs(rgb, centre, radius)
    lab = _rgb_to_lab(inner)
    keep = _is_below_highlight(lab)
    colour = (lab * keep[..., None]).sum(axis=1) / keep.sum(axis=1, keepdims=True)
    wide = _rgb_to_lab(sample_discs(rgb, centre, radius, WHITE_SAMPLED_RADII))
    white = _estimate_white(wide)
    pale = _is_white(wide, white)
    rim = np.linalg.norm(DISC_SAMPLES, axis=1) * WHITE_SAMPLED_RADII > RIM_RADII
    painted = keep & ~_is_white(lab, white)
    counted = np.where(painted.any(axis=1, keepdims=True), painted, keep)
    return BallColours(colour, pale.mean(axis=1), pale[:, rim].mean(axis=1), _median_value(inner, counted))


def _rgb_to_lab(rgb: NDArray[np.float32]) -> FloatArray:
    """Convert RGB (K, n, 3) of 0 to 255 to CIE L*a*b* (K, n, 3)."""
    return np.asarray(cv2.cvtColor(rgb / np.float32(255), cv2.COLOR_RGB2LAB), dtype=np.float64)


def _is_below_highlight(lab: FloatArray) -> NDArray[np.bool_]:
    """Which samples (K, n) are not among the brightest of their ball."""
    lightness = lab[..., 0]
    last = int((SAMPLES - 1) * (1 - HIGHLIGHT_SHARE))
    dim: NDArray[np.bool_] = lightness <= np.partition(lightness, last, axis=1)[:, last : last + 1]
    return dim


def _median_value(rgb: NDArray[np.float32], is_counted: NDArray[np.bool_]) -> FloatArray:
    """Median (K,) of the brightest channel, 0 to 1, of the samples (K, n, 3) that count, (K, n), some of each."""
    ranked = np.sort(np.where(is_counted, rgb.max(axis=2), np.inf), axis=1)
    row, count = np.arange(len(ranked)), is_counted.sum(axis=1)
    middle = (ranked[row, (count - 1) // 2] + ranked[row, count // 2]) / 2
    return np.asarray(middle / 255, dtype=np.float64)


def _is_white(lab: FloatArray, white: FloatArray) -> NDArray[np.bool_]:
    """Which of the samples (K, n, 3) are `white` (3,), in the light or in shade."""
    tint = lab[..., 1:] / np.maximum(lab[..., :1], 1.0) - white[1:] / white[0]
    alike = (np.hypot(tint[..., 0], tint[..., 1]) < MAX_TINT_DIFFERENCE) & (
        lab[..., 0] > MIN_SHADE_LIGHTNESS * white[0]
    )
    return np.asarray(alike, dtype=np.bool_)


def _estimate_white(lab: FloatArray) -> FloatArray:
    """Estimate CIE L*a*b* (3,) of white in an image from the samples (K, n, 3) of its balls."""
    chroma = np.hypot(lab[..., 1], lab[..., 2])
    pale = np.where(_is_below_highlight(lab), lab[..., 0] - CHROMA_PENALTY * chroma, -np.inf).ravel()
    palest = np.argsort(-pale, kind="stable")[: max(MIN_PALE_SAMPLES, round(PALEST_SHARE * len(pale)))]
    palest_colour = np.median(lab.reshape(-1, 3)[palest], axis=0)
    tinted = np.hypot(palest_colour[1], palest_colour[2]) > MAX_WHITE_TINT * palest_colour[0]
    return PLAIN_WHITE if tinted or palest_colour[0] < MIN_WHITE_LIGHTNESS else palest_colour
