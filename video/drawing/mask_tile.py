"""Several coloured masks composed into one tile that is blended onto an image at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.core.typing import ByteArray, Float32Array, ImageArray
from video.drawing.palette import Colour
from video.io.pixel_kernels import blend_colours


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
    alpha: Float32Array
    """(h, w) 0 to 1"""

    def blend_onto(self, image: ImageArray, x: int, y: int, opacity: float = 1.0) -> None:
        """Blend the tile onto `image` (H, W, 3) in place with its top-left pixel at (x, y), cut at the border."""
        if opacity > 0:
            blend_colours(image, self.colours, self.alpha, x, y, float(opacity))


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
    return MaskTile(np.clip(unmultiplied, 0, 255).astype(np.uint8), alpha)
