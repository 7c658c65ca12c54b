"""Light, glare and sharpness of a view of a table."""

from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import BoolArray, ByteArray, FloatArray, ImageArray

CLIPPED_LEVEL = 250
"""Level of 255 from which a colour counts as clipped; video rarely reaches 255."""
GLARE_RATIO, GLARE_GREY = 1.6, 0.5
"""A pixel of glare is so many times brighter than the median of the cloth, and has at most this share of its
saturation."""
GLARE_LEVELS = (150, 240)
"""Limits of the level of 255 from which a pixel is glare: no dark grey is, and nearly white always is."""
SPOT_RADII = 1.6
"""Radius of the smallest spot that is no ball, ball radii."""
EDGE_WINDOW, STRONG_EDGE = 21, 40.0
"""px around an edge within which both sides are seen, and the least step of a strong edge, grey levels."""
SHARPEST_SHARE = 0.2
"""Quantile of the blur over strong edges: many edges are soft by themselves, the sharpest show the focus."""
SLOPE_VARIANCE = 5 / 12
"""px^2 that a slope over two pixels (4 / 12) and the pixels themselves (1 / 12) add to the variance of the blur."""
LEAST_EDGES = 60
"""Pixels of strong edges below which the focus is not measured."""
STEADY_SHARES = (25, 75)
"""Percentiles of the cells that give the brightness of a frame: what moves lies outside."""
RANGE_PERCENTILES = (3, 97)
"""Percentiles over the frames that bound the range of the brightness."""
LEAST_LEVEL = 12
"""Level of 255 below which a cell is too dark for a ratio."""


def draw_table_mask(size: tuple[int, int], corners: FloatArray, scale: float = 1.0) -> BoolArray:
    """Draw the playing surface.

    Args:
        size: Width and height of the mask, px.
        corners: (4, 2) px of the image.
        scale: Mask pixels per image pixel.

    Returns:
        Mask (h, w).
    """
    mask = np.zeros(size[::-1], np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners * scale).astype(np.int32), 1)
    return mask > 0


def measure_exposure(image: ImageArray, mask: BoolArray) -> float:
    """Measure the median brightness of the table, grey levels of 255, in an image (H, W, 3) under a mask (H, W)."""
    return float(np.median(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[mask]))


def measure_clipping(image: ImageArray, mask: BoolArray) -> float:
    """Measure the share of pixels with a colour at its maximum, %, in an image (H, W, 3) under a mask (H, W)."""
    return float(100 * (image.max(axis=2)[mask] >= CLIPPED_LEVEL).mean())


def measure_flicker(thumbnails: ImageArray, mask: BoolArray) -> float:
    """Measure half the range of the brightness over the frames, %.

    Args:
        thumbnails: (K, h, w) small grey frames.
        mask: (h, w) where light is compared.

    Returns:
        Half the range, % of the mean.
    """
    cells = thumbnails[:, mask].astype(np.float32)
    typical = np.median(cells, axis=0)
    bright = typical >= LEAST_LEVEL
    if not bright.any():
        return float("nan")
    ratio = np.sort(cells[:, bright] / typical[bright], axis=1)
    low, high = (ratio.shape[1] * share // 100 for share in STEADY_SHARES)
    gain = ratio[:, low : max(high, low + 1)].mean(axis=1)
    first, last = np.percentile(gain, RANGE_PERCENTILES)
    return float(50 * (last - first))


def find_glare(image: ImageArray, mask: BoolArray, ball_radius: float) -> BoolArray:
    """Find bright spots on the cloth that are larger than balls.

    Args:
        image: (H, W, 3), the table without what moves.
        mask: (H, W) of the playing surface.
        ball_radius: px.

    Returns:
        Mask (H, W) of the spots.
    """
    saturation = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)[..., 1].astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    cloth_grey, cloth_saturation = float(np.median(grey[mask])), float(np.median(saturation[mask]))
    bright = mask & (grey > np.clip(GLARE_RATIO * cloth_grey, *GLARE_LEVELS))
    bright &= (saturation < GLARE_GREY * cloth_saturation) | (grey >= CLIPPED_LEVEL)
    size = 2 * max(round(SPOT_RADII * ball_radius), 1) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return np.asarray(cv2.morphologyEx(bright.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0)


def measure_edge_blur(grey: ByteArray, mask: BoolArray) -> float:
    """Measure the blur of the sharpest strong edges.

    An edge of step h that is blurred by a Gaussian of standard deviation s has the largest slope h / (s sqrt(2 pi)).

    Args:
        grey: (H, W).
        mask: (H, W) where edges count.

    Returns:
        Standard deviation, px; NaN where there are too few strong edges.
    """
    smooth = grey.astype(np.float32)
    across, down = (cv2.Scharr(smooth, cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1)))
    slope = cv2.magnitude(across, down)
    kernel = np.ones((EDGE_WINDOW, EDGE_WINDOW), np.uint8)
    step = cv2.dilate(smooth, kernel) - cv2.erode(smooth, kernel)
    near = cv2.dilate(slope, np.ones((5, 5), np.uint8))
    strong = mask & (step >= STRONG_EDGE) & (slope >= near) & (slope > 0.02 * step)
    if np.count_nonzero(strong) < LEAST_EDGES:
        return float("nan")
    apparent = float(np.quantile(step[strong] / (slope[strong] * np.sqrt(2 * np.pi)), SHARPEST_SHARE))
    return float(np.sqrt(max(apparent**2 - SLOPE_VARIANCE, 0.0)))
