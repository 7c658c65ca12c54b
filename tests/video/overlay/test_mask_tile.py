"""A composed tile of masks looks as the masks blended one after another."""

from __future__ import annotations

import numpy as np
import pytest

from video.drawing.mask_tile import ColouredMask, compose_tile
from video.drawing.text import blend_mask, number_mask, round_corner_mask, text_mask

MASKS = (
    ColouredMask(round_corner_mask(60, 24, 6), 0, 0, (20, 22, 30), 0.72),
    ColouredMask(text_mask("eight", 14, True), 9, 3, (240, 245, 250)),
    ColouredMask(round_corner_mask(8, 30, 2), 50, -4, (250, 200, 0), 0.9),
)


@pytest.mark.parametrize("corner", [(11, 7), (-20, -9), (75, 30), (500, 500)])
def test_a_composed_tile_looks_as_its_masks_blended_one_after_another(corner: tuple[int, int]) -> None:
    x, y = corner
    rng = np.random.default_rng(5)
    at_once = rng.integers(0, 256, (40, 100, 3), dtype=np.uint8)
    in_turn, before = at_once.copy(), at_once.copy()
    compose_tile(60, 24, MASKS).blend_onto(at_once, x, y)
    for layer in MASKS:
        low, high = max(0, -layer.y), 24 - layer.y  # the tile ends at the first mask
        blend_mask(in_turn, layer.mask[low:high], x + layer.x, y + layer.y + low, layer.colour, layer.opacity)
    assert np.abs(at_once.astype(int) - in_turn).max() <= 3
    assert (at_once != before).any() == (x < 100)


def test_half_opacity_gives_the_mean_of_the_image_and_the_opaque_tile() -> None:
    images = [np.full((24, 60, 3), 90, dtype=np.uint8) for _ in range(3)]
    for image, opacity in zip(images, (0.0, 0.5, 1.0), strict=True):
        compose_tile(60, 24, MASKS).blend_onto(image, 0, 0, opacity)
    nothing, half, whole = (image.astype(float) for image in images)
    assert (nothing == 90).all()
    np.testing.assert_allclose(half, (nothing + whole) / 2, atol=1)


@pytest.mark.parametrize("size", [11, 17, 27, 54])
def test_a_number_of_single_letters_looks_as_one_rendered_at_once(size: int) -> None:
    for text in ("00.123", "12.987", "71.114"):
        whole, parts = (mask(text, size, True).astype(float) for mask in (text_mask, number_mask))
        assert abs(whole.shape[1] - parts.shape[1]) <= 1
        assert whole.shape[0] == parts.shape[0]
        assert parts.sum() == pytest.approx(whole.sum(), rel=0.1)
        columns = [mask.sum(axis=0) for mask in (whole, parts)]
        middle = [np.average(np.arange(len(column)), weights=column) for column in columns]
        assert middle[0] == pytest.approx(middle[1], abs=0.5)
