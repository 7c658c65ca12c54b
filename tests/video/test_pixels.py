"""Compiled loops over pixels, against the same sums of whole arrays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from video.io.pixel_kernels import CELL, dots, fill_cells, fill_mixed, lay_over, paint, unlike


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_mixture_is_the_weighted_mean_to_half_a_level(share: float) -> None:
    first, second = np.random.default_rng(3).integers(0, 256, (2, 999), dtype=np.uint8)
    mixed = np.empty_like(first)
    fill_mixed(first, second, share, mixed)
    assert np.abs(mixed - (first * (1 - share) + second * share)).max() <= 0.501


@pytest.mark.parametrize("corner", [(3, 2), (-4, -3), (25, 14), (-90, 5), (5, 90)])
def test_paint_covers_the_part_of_the_mask_that_lies_in_the_picture(corner: tuple[int, int]) -> None:
    x, y = corner
    rng = np.random.default_rng(4)
    picture, mask = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8), rng.integers(0, 256, (8, 11), dtype=np.uint8)
    wide = np.pad(picture.astype(float), ((100, 100), (100, 100), (0, 0)))
    here = wide[100 + y : 108 + y, 100 + x : 111 + x]
    here += (np.array([250, 10, 90]) - here) * (0.8 / 255 * mask[..., None])
    paint(picture, mask, x, y, (250, 10, 90), 0.8)
    assert np.abs(picture - wide[100:120, 100:130]).max() <= 0.501


def test_cells_are_the_means_that_opencv_finds() -> None:
    rng = np.random.default_rng(6)
    for levels in (256, 3):  # few levels: many halves
        picture, cells = rng.integers(0, levels, (48, 80, 3), dtype=np.uint8), np.empty((12, 20, 3), np.uint8)
        fill_cells(picture, cells)
        assert np.array_equal(cells, cv2.resize(picture, (80 // CELL, 48 // CELL), interpolation=cv2.INTER_AREA))


@pytest.mark.parametrize("corner", [(3, 2), (-4, -3), (25, 14), (-90, 5), (5, 90)])
def test_colours_lie_over_the_part_of_the_picture_that_they_cover(corner: tuple[int, int]) -> None:
    x, y = corner
    rng = np.random.default_rng(7)
    picture, colours = (rng.integers(0, 256, (*size, 3), dtype=np.uint8) for size in ((20, 30), (8, 11)))
    cover = rng.random((8, 11), dtype=np.float32)
    wide = np.pad(picture.astype(float), ((100, 100), (100, 100), (0, 0)))
    here = wide[100 + y : 108 + y, 100 + x : 111 + x]
    here += (colours - here) * (0.8 * cover[..., None])
    lay_over(picture, colours, cover, x, y, 0.8)
    assert np.abs(picture - wide[100:120, 100:130]).max() <= 0.501


def test_what_is_unlike_the_empty_place_in_its_own_light_stands_out() -> None:
    rng = np.random.default_rng(8)
    empty = rng.uniform(40, 120, (6, 7, 3)).astype(np.float32)
    seen = np.rint(empty * np.linspace(0.5, 1.5, 6, dtype=np.float32)[:, None, None]).astype(np.uint8)
    seen[2, 3] = 0, 200, 0
    light, other = np.empty((6, 7), np.float32), np.empty((6, 7), np.float32)
    unlike(seen, empty, light, other)
    lit = other < 2
    assert not lit[2, 3]
    assert lit.sum() == 41
    np.testing.assert_allclose(light[lit], np.broadcast_to(np.linspace(0.5, 1.5, 6)[:, None], (6, 7))[lit], atol=0.03)


@pytest.mark.parametrize("others", [1, 50])
def test_products_of_colours_are_those_of_their_channels_added(others: int) -> None:
    rng = np.random.default_rng(9)
    first, second = (rng.random((count, 3), dtype=np.float32) for count in (50, others))
    np.testing.assert_allclose(dots(first, second), (first * second).sum(axis=1), rtol=1e-6)
