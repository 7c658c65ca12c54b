"""Compiled loops over pixels, against the same sums of whole arrays."""

from __future__ import annotations

import numpy as np
import pytest

from video.pixels import fill_mixed, paint


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
