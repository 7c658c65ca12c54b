"""Compiled loops over pixels, compared with NumPy and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from video.io.pixel_kernels import (
    CELL_PX,
    blend_colours,
    dot_products,
    fill_background_difference,
    fill_blend,
    fill_cell_means,
    paint_mask,
)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_blend_is_the_weighted_mean_to_half_a_level(share: float) -> None:
    first, second = np.random.default_rng(3).integers(0, 256, (2, 999), dtype=np.uint8)
    mixed = np.empty_like(first)
    fill_blend(first, second, share, mixed)
    assert np.abs(mixed - (first * (1 - share) + second * share)).max() <= 0.501


@pytest.mark.parametrize("corner", [(3, 2), (-4, -3), (25, 14), (-90, 5), (5, 90)])
def test_paint_covers_the_part_of_the_mask_inside_the_image(corner: tuple[int, int]) -> None:
    x, y = corner
    rng = np.random.default_rng(4)
    image, mask = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8), rng.integers(0, 256, (8, 11), dtype=np.uint8)
    wide = np.pad(image.astype(float), ((100, 100), (100, 100), (0, 0)))
    here = wide[100 + y : 108 + y, 100 + x : 111 + x]
    here += (np.array([250, 10, 90]) - here) * (0.8 / 255 * mask[..., None])
    paint_mask(image, mask, x, y, (250, 10, 90), 0.8)
    assert np.abs(image - wide[100:120, 100:130]).max() <= 0.501


def test_cell_means_equal_those_of_opencv() -> None:
    rng = np.random.default_rng(6)
    for levels in (256, 3):  # few levels: many halves
        image, cells = rng.integers(0, levels, (48, 80, 3), dtype=np.uint8), np.empty((12, 20, 3), np.uint8)
        fill_cell_means(image, cells)
        assert np.array_equal(cells, cv2.resize(image, (80 // CELL_PX, 48 // CELL_PX), interpolation=cv2.INTER_AREA))


@pytest.mark.parametrize("corner", [(3, 2), (-4, -3), (25, 14), (-90, 5), (5, 90)])
def test_colours_are_blended_only_inside_the_image(corner: tuple[int, int]) -> None:
    x, y = corner
    rng = np.random.default_rng(7)
    image, colours = (rng.integers(0, 256, (*size, 3), dtype=np.uint8) for size in ((20, 30), (8, 11)))
    cover = rng.random((8, 11), dtype=np.float32)
    wide = np.pad(image.astype(float), ((100, 100), (100, 100), (0, 0)))
    here = wide[100 + y : 108 + y, 100 + x : 111 + x]
    here += (colours - here) * (0.8 * cover[..., None])
    blend_colours(image, colours, cover, x, y, 0.8)
    assert np.abs(image - wide[100:120, 100:130]).max() <= 0.501


def test_an_object_differs_from_the_background_after_brightness_is_matched() -> None:
    rng = np.random.default_rng(8)
    empty = rng.uniform(40, 120, (6, 7, 3)).astype(np.float32)
    observed = np.rint(empty * np.linspace(0.5, 1.5, 6, dtype=np.float32)[:, None, None]).astype(np.uint8)
    observed[2, 3] = 0, 200, 0
    light, other = np.empty((6, 7), np.float32), np.empty((6, 7), np.float32)
    fill_background_difference(observed, empty, light, other)
    lit = other < 2
    assert not lit[2, 3]
    assert lit.sum() == 41
    np.testing.assert_allclose(light[lit], np.broadcast_to(np.linspace(0.5, 1.5, 6)[:, None], (6, 7))[lit], atol=0.03)


@pytest.mark.parametrize("others", [1, 50])
def test_dot_products_are_sums_over_channels(others: int) -> None:
    rng = np.random.default_rng(9)
    first, second = (rng.random((count, 3), dtype=np.float32) for count in (50, others))
    np.testing.assert_allclose(dot_products(first, second), (first * second).sum(axis=1), rtol=1e-6)
