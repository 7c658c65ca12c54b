"""A still of a clip with its table and balls, beside a panel with what is good and what is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import BoolArray, FloatArray, ImageArray
from video.drawing.masks import SHIFT, draw_disc, draw_ring, draw_text, drawing_scale, to_fixed_point
from video.drawing.palette import FLASH, INK, TRUST_COLOURS, Colour

# Width of the panel relative to the image, and at least.
PANEL_SHARE, LEAST_PANEL_PX = 0.42, 380
# Font size at a drawing scale of 1, and the least one.
FONT_PX, LEAST_FONT_PX = 17.0, 13
# Distance of the lines, and margin, in font sizes.
LINE_SPACING, MARGIN_LINES = 1.5, 1.0
GLARE_COLOUR: Colour = (240, 68, 68)


@dataclass(frozen=True, slots=True)
class PanelLine:
    """A line of the panel."""

    text: str
    colour: Colour
    bold: bool = False


@dataclass(frozen=True, slots=True)
class TableOutline:
    """Corners (4, 2) px of the playing surface, and the balls: centres (K, 2) px and radii (K,) px."""

    corners: FloatArray
    centre: FloatArray
    radius: FloatArray


def draw_filming_still(
    image: ImageArray, outline: TableOutline | None, glare: BoolArray, lines: Sequence[PanelLine]
) -> ImageArray:
    """Draw what was found in a frame beside a panel of text.

    Args:
        image: (H, W, 3).
        outline: Table and balls; None where no table was located.
        glare: (H, W) bright spots on the cloth.
        lines: Text of the panel.

    Returns:
        A wider image.
    """
    scale = drawing_scale(image.shape[0])
    still, thickness = image.copy(), max(round(2 * scale), 1)
    if glare.any():
        spots, _ = cv2.findContours(glare.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(still, spots, -1, GLARE_COLOUR, thickness, cv2.LINE_AA)
    if outline is not None:
        cv2.polylines(still, [to_fixed_point(outline.corners)], True, FLASH, thickness, cv2.LINE_AA, SHIFT)
        for corner in outline.corners:
            draw_disc(still, corner, 5 * scale, FLASH)
        for centre, radius in zip(outline.centre, outline.radius, strict=True):
            draw_ring(still, centre, float(radius) + 1.5 * scale, 1.5 * scale, TRUST_COLOURS["green"], 0.9)
    size, width = _measure_panel(image.shape)
    step, margin = round(LINE_SPACING * size), round(MARGIN_LINES * size)
    height = max(image.shape[0], 2 * margin + step * len(lines))
    whole = np.full((height, image.shape[1] + width, 3), INK, dtype=np.uint8)
    whole[: image.shape[0], : image.shape[1]] = still
    for k, line in enumerate(lines):
        draw_text(whole, line.text, image.shape[1] + margin, margin + k * step, size, line.colour, bold=line.bold)
    return whole


def count_panel_letters(shape: tuple[int, ...]) -> int:
    """Count the letters of an average line that fit into the panel of an image of a shape (H, W, 3)."""
    size, width = _measure_panel(shape)
    return int((width - 2 * MARGIN_LINES * size) / (0.57 * size))


def _measure_panel(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return font size and width, px, of the panel of an image of a shape (H, W, 3)."""
    size = max(round(FONT_PX * drawing_scale(shape[0])), LEAST_FONT_PX)
    return size, max(round(PANEL_SHARE * shape[1]), LEAST_PANEL_PX)
