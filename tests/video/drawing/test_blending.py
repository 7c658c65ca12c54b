"""Colours that are blended into an image through a mask, compared with NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from video.drawing.masks import blend_colours

CORNERS = [(3, 2), (-4, -3), (25, 14), (-90, 5), (5, 90)]


@pytest.mark.parametrize("corner", CORNERS)
@pytest.mark.parametrize("size", [(1, 1), (8, 11)])
def test_colours_are_blended_only_inside_the_image(corner: tuple[int, int], size: tuple[int, int]) -> None:
    x, y = corner
    rng = np.random.default_rng(7)
    image, colours = (rng.integers(0, 256, (*sides, 3), dtype=np.uint8) for sides in ((20, 30), size))
    cover = rng.integers(0, 256, (8, 11), dtype=np.uint8)
    wide = np.pad(image.astype(float), ((100, 100), (100, 100), (0, 0)))
    here = wide[100 + y : 108 + y, 100 + x : 111 + x]
    here += (colours - here) * (0.8 / 255 * cover[..., None])
    blend_colours(image, colours, cover, x, y, 0.8)
    assert np.abs(image - wide[100:120, 100:130]).max() <= 0.501
