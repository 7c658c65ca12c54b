"""Colours that are blended into an image through a mask, compared with NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from video.drawing.masks import blend_colours, blend_levels
from video.io.yuv_frame import YuvFrame

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


@pytest.mark.parametrize("corner", [*CORNERS, (4, 2), (-3, -4), (20, 13)])
@pytest.mark.parametrize("size", [(1, 1), (8, 11)])
def test_planes_take_the_blended_luma_and_the_mean_chroma_of_four_pixels(
    corner: tuple[int, int], size: tuple[int, int]
) -> None:
    x, y = corner
    rng = np.random.default_rng(8)
    sides = ((20, 30), (10, 15), (10, 15))
    bright, blue, red = (rng.integers(0, 256, one, dtype=np.uint8) for one in sides)
    colours, cover = rng.integers(0, 256, (*size, 3), dtype=np.uint8), rng.integers(0, 256, (8, 11), dtype=np.uint8)
    colours[..., 1:] = colours[0, 0, 1:]  # where chroma differs within four pixels, its mean is taken for all of them
    wide = np.stack([bright, *(np.kron(plane, np.ones((2, 2))) for plane in (blue, red))], axis=-1)
    wide = np.pad(wide, ((100, 100), (100, 100), (0, 0)))
    here = wide[100 + y : 108 + y, 100 + x : 111 + x]
    here += (colours - here) * (0.8 / 255 * cover[..., None])
    blend_levels(YuvFrame((bright, blue, red)), colours, cover, x, y, 0.8)
    inside = wide[100:120, 100:130]
    assert np.abs(bright - inside[..., 0]).max() <= 0.501
    for plane, exact in zip((blue, red), (inside[..., 1], inside[..., 2]), strict=True):
        assert np.abs(plane - exact.reshape(10, 2, 15, 2).mean(axis=(1, 3))).max() <= 0.501
