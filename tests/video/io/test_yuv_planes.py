"""YUV planes, compared with the formulas of BT.709 in floating point."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from video.io.video_writer import build_encoder_frame


def _exact_planes(rgb: NDArray[np.uint8]) -> list[NDArray[np.float64]]:
    """Compute Y', Cb, Cr by ITU-R BT.709-6, items 3.2 to 3.4; the chroma of 2 x 2 pixels is their mean."""
    red, green, blue = (rgb[..., k] / 255 for k in range(3))
    bright = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    colours = [(blue - bright) / 1.8556, (red - bright) / 1.5748]
    height, width = bright.shape
    means = [one.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3)) for one in colours]
    return [219 * bright + 16, *(224 * mean + 128 for mean in means)]


def _convert_planes(rgb: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    frame = build_encoder_frame(rgb)
    return [np.frombuffer(p, np.uint8).reshape(p.height, p.line_size)[:, : p.width] for p in frame.planes]


@pytest.mark.parametrize("size", [(2, 2), (34, 50), (180, 322)])
def test_planes_follow_the_formulas_to_a_level(size: tuple[int, int]) -> None:
    rgb = np.random.default_rng(5).integers(0, 256, (*size, 3), dtype=np.uint8)
    for converted, exact, tolerance in zip(_convert_planes(rgb), _exact_planes(rgb), (0.6, 1.0, 1.0), strict=True):
        assert np.abs(converted - exact).max() < tolerance


def test_greys_have_neutral_chroma_and_black_and_white_reach_the_ends_of_the_range() -> None:
    levels = np.repeat(np.arange(256, dtype=np.uint8), 4)
    bright, blue, red = _convert_planes(np.repeat(np.tile(levels, (2, 1))[..., None], 3, axis=2))
    assert (bright[0, 0], bright[0, -1]) == (16, 235)
    assert np.all(blue == 128)
    assert np.all(red == 128)


def test_errors_do_not_accumulate() -> None:
    rgb = np.random.default_rng(6).integers(0, 256, (400, 400, 3), dtype=np.uint8)
    for converted, exact in zip(_convert_planes(rgb), _exact_planes(rgb), strict=True):
        assert abs(float((converted - exact).mean())) < 0.01


def test_a_frame_does_not_share_its_planes_with_the_next_one() -> None:
    dark, light = (np.full((16, 16, 3), level, np.uint8) for level in (0, 255))
    first, _ = (build_encoder_frame(image) for image in (dark, light))
    assert np.frombuffer(first.planes[0], np.uint8).max() == 16
