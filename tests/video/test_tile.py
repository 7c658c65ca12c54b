"""Masks laid as one look as they do laid in turn."""

from __future__ import annotations

import numpy as np
import pytest

from video.drawing.mask_tile import Ink, stacked
from video.drawing.text import lay, number_mask, rounded_mask, text_mask

INKS = (
    Ink(rounded_mask(60, 24, 6), 0, 0, (20, 22, 30), 0.72),
    Ink(text_mask("eight", 14, True), 9, 3, (240, 245, 250)),
    Ink(rounded_mask(8, 30, 2), 50, -4, (250, 200, 0), 0.9),
)


@pytest.mark.parametrize("corner", [(11, 7), (-20, -9), (75, 30), (500, 500)])
def test_inks_stacked_look_as_laid_one_after_another_and_are_cut_alike(corner: tuple[int, int]) -> None:
    x, y = corner
    rng = np.random.default_rng(5)
    at_once = rng.integers(0, 256, (40, 100, 3), dtype=np.uint8)
    in_turn, before = at_once.copy(), at_once.copy()
    stacked(60, 24, INKS).lay(at_once, x, y)
    for ink in INKS:
        low, high = max(0, -ink.y), 24 - ink.y  # the tile ends where the first ink does
        lay(in_turn, ink.mask[low:high], x + ink.x, y + ink.y + low, ink.colour, ink.opacity)
    assert np.abs(at_once.astype(int) - in_turn).max() <= 3
    assert (at_once != before).any() == (x < 100)


def test_half_a_tile_lies_half_way_between_the_picture_and_the_whole_tile() -> None:
    pictures = [np.full((24, 60, 3), 90, dtype=np.uint8) for _ in range(3)]
    for picture, opacity in zip(pictures, (0.0, 0.5, 1.0), strict=True):
        stacked(60, 24, INKS).lay(picture, 0, 0, opacity)
    nothing, half, whole = (picture.astype(float) for picture in pictures)
    assert (nothing == 90).all()
    np.testing.assert_allclose(half, (nothing + whole) / 2, atol=1)


@pytest.mark.parametrize("size", [11, 17, 27, 54])
def test_a_number_of_single_letters_is_the_number_written_at_once(size: int) -> None:
    for text in ("00.123", "12.987", "71.114"):
        whole, parts = (mask(text, size, True).astype(float) for mask in (text_mask, number_mask))
        assert abs(whole.shape[1] - parts.shape[1]) <= 1
        assert whole.shape[0] == parts.shape[0]
        assert parts.sum() == pytest.approx(whole.sum(), rel=0.1)
        columns = [mask.sum(axis=0) for mask in (whole, parts)]
        middle = [np.average(np.arange(len(column)), weights=column) for column in columns]
        assert middle[0] == pytest.approx(middle[1], abs=0.5)
