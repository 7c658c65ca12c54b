"""Trails of balls: a line along the recent path that fades with age."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray
from video.drawing.circles import SHIFT, to_fixed_point
from video.drawing.palette import WHITE, Colour, mix_colours
from video.drawing.text import blend_sparse_masks

TRAIL_PIECE_PX, MAX_TRAIL_PIECES = 10.0, 18
"""px of a trail with one opacity, and largest number of such pieces."""
TRAIL_OPACITY, CORE_OPACITY = 0.62, 0.85
"""Opacity of the coloured line and of its white core."""


def draw_trail(
    image: ImageArray, path: FloatArray, fade: FloatArray, colour: Colour, width: float, uncovered: ImageArray
) -> None:
    """Draw a line with a white core along `path` (n, 2) px with opacity `fade` (n,), where `uncovered` (H, W)."""
    if len(path) < 2:
        return
    margin = width + 3
    x0, y0 = (int(v) for v in np.maximum(np.floor(path.min(axis=0) - margin), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(path.max(axis=0) + margin), [image.shape[1], image.shape[0]]))
    if x1 <= x0 or y1 <= y0:
        return
    pieces = _split_trail(path - [x0, y0], fade)
    layers = []
    for ink, thickness, opacity in (
        (colour, width, TRAIL_OPACITY),
        (mix_colours(WHITE, colour, 0.12), width * 0.3, CORE_OPACITY),
    ):
        mask = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
        _draw_strokes(mask, pieces, opacity, max(1, round(thickness)))
        layers.append((mask, ink))
    blend_sparse_masks(image, layers, x0, y0, uncovered)


def _split_trail(path: FloatArray, fade: FloatArray) -> list[tuple[NDArray[np.int32], float]]:
    """Split a polyline (n, 2) px into lines of constant opacity, the oldest first."""
    points = to_fixed_point(path).reshape(-1, 1, 2)
    length = float(np.hypot(*np.diff(path, axis=0).T).sum())
    count = int(min(max(length / TRAIL_PIECE_PX, 2), MAX_TRAIL_PIECES, len(points) - 1))
    cuts = [k * (len(points) - 1) // count for k in range(count + 1)]
    return [(points[start : end + 1], float(fade[end])) for start, end in pairwise(cuts)]


def _draw_strokes(
    mask: ImageArray, pieces: Sequence[tuple[NDArray[np.int32], float]], opacity: float, thickness: int
) -> None:
    """Draw the pieces of a polyline, each with its own opacity."""
    for line, fade in pieces:
        level = round(fade * opacity * 255)
        if level > 2:
            cv2.polylines(mask, [line], False, level, thickness, cv2.LINE_AA, SHIFT)
