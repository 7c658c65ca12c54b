"""Tiles: several coloured masks composed once, and blended onto many frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.core.typing import ByteArray, ImageArray
from video.drawing.palette import Colour
from video.drawing.text import blend_levels
from video.io.yuv_frame import Canvas, YuvFrame, convert_colours


@dataclass(frozen=True, slots=True)
class ColouredMask:
    """A mask (h, w), 0 to 255, with its colour; (x, y) is its top-left pixel in the tile."""

    mask: ByteArray
    x: int
    y: int
    colour: Colour
    opacity: float = 1.0


@dataclass(frozen=True, slots=True)
class MaskTile:
    """Composed masks: a colour and an opacity for each pixel. Tiles are shared and must not be written into."""

    colours: ImageArray
    """(h, w, 3)"""
    levels: ImageArray
    """(h, w, 3) the same for frames for the encoder."""
    cover: ByteArray
    """(h, w) opacity, 0 to 255."""

    @classmethod
    def from_colours(cls, colours: ImageArray, cover: ByteArray) -> MaskTile:
        """Make a tile of colours (h, w, 3) and their opacity (h, w), 0 to 255."""
        return cls(colours, convert_colours(colours), cover)

    def blend_onto(self, image: Canvas, x: int, y: int, opacity: float = 1.0) -> None:
        """Blend the tile onto an image in place with its top-left pixel at (x, y), cut at the border."""
        blend_levels(image, self.levels if isinstance(image, YuvFrame) else self.colours, self.cover, x, y, opacity)


def compose_tile(width: int, height: int, masks: Sequence[ColouredMask]) -> MaskTile:
    """Compose masks into one tile.

    Args:
        width: Width of the tile, px.
        height: Height of the tile, px.
        masks: Coloured masks from bottom to top; parts outside the tile are cut.

    Returns:
        A tile that looks the same as the masks blended one after another.
    """
    colours = np.zeros((height, width, 3), dtype=np.float32)
    alpha = np.zeros((height, width), dtype=np.float32)
    for layer in masks:
        left, top = max(0, -layer.x), max(0, -layer.y)
        mask = layer.mask[top : max(top, height - layer.y), left : max(left, width - layer.x)]
        here = np.s_[layer.y + top : layer.y + top + mask.shape[0], layer.x + left : layer.x + left + mask.shape[1]]
        share = (mask * np.float32(layer.opacity / 255))[..., None]
        colours[here] += (np.asarray(layer.colour, dtype=np.float32) - colours[here]) * share  # premultiplied
        alpha[here] += (1 - alpha[here]) * share[..., 0]
    unmultiplied = np.rint(colours / np.maximum(alpha, 1e-6)[..., None])
    return MaskTile.from_colours(
        np.clip(unmultiplied, 0, 255).astype(np.uint8), np.rint(255 * np.clip(alpha, 0, 1)).astype(np.uint8)
    )
