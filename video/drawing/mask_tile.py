"""Several masks, each in a colour of its own, laid over a picture as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.core.typing import ByteArray, Float32Array, ImageArray
from video.drawing.palette import Colour
from video.io.pixel_kernels import lay_over


@dataclass(frozen=True, slots=True)
class Ink:
    """A mask (h, w), 0 to 255, in a colour; (x, y) is its top-left pixel."""

    mask: ByteArray
    x: int
    y: int
    colour: Colour
    opacity: float = 1.0


@dataclass(frozen=True, slots=True)
class Tile:
    """What is laid: the colour of every pixel and how far it covers; shared, not to be written into."""

    colours: ImageArray
    """(h, w, 3)"""
    cover: Float32Array
    """(h, w) 0 to 1"""

    def lay(self, picture: ImageArray, x: int, y: int, opacity: float = 1.0) -> None:
        """Lay it over `picture` with its top-left pixel at (x, y), in place; what is outside is cut."""
        if opacity > 0:
            lay_over(picture, self.colours, self.cover, x, y, float(opacity))


def stacked(width: int, height: int, inks: Sequence[Ink]) -> Tile:
    """Inks one upon the other, as they would look laid over any picture in turn; what is outside is cut."""
    colours = np.zeros((height, width, 3), dtype=np.float32)
    cover = np.zeros((height, width), dtype=np.float32)
    for ink in inks:
        left, top = max(0, -ink.x), max(0, -ink.y)
        mask = ink.mask[top : max(top, height - ink.y), left : max(left, width - ink.x)]
        here = np.s_[ink.y + top : ink.y + top + mask.shape[0], ink.x + left : ink.x + left + mask.shape[1]]
        share = (mask * np.float32(ink.opacity / 255))[..., None]
        colours[here] += (np.asarray(ink.colour, dtype=np.float32) - colours[here]) * share  # times their cover
        cover[here] += (1 - cover[here]) * share[..., 0]
    plain = np.rint(colours / np.maximum(cover, 1e-6)[..., None])
    return Tile(np.clip(plain, 0, 255).astype(np.uint8), cover)
