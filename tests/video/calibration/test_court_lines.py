"""Ridges and places of paint in drawn images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from models.core.typing import FloatArray
from video.calibration.court_lines import find_painted_lines, find_ridge_points, measure_crests


def draw_bar(width: float, centre: float, left: float, right: float, blur: float = 0.8) -> FloatArray:
    """Draw an upright bar of 200 grey levels between two grounds (60, 80), with pixels that integrate."""
    x = np.arange(80 * 16) / 16 - 0.5 + 1 / 32
    fine = np.where(np.abs(x - centre) < width / 2, 200.0, np.where(x < centre, left, right))
    row = fine.reshape(80, 16).mean(1)
    return cv2.GaussianBlur(np.tile(row.astype(np.float32), (60, 1)), (0, 0), blur)


@pytest.mark.parametrize("width", [1.5, 3.0, 7.0])
@pytest.mark.parametrize("grounds", [(60.0, 60.0), (40.0, 110.0), (120.0, 50.0)])
def test_paint_is_placed_within_a_tenth_of_a_pixel_whatever_lies_beside_it(
    width: float, grounds: tuple[float, float]
) -> None:
    for centre in (40.0, 40.3, 40.62):
        image = draw_bar(width, centre, *grounds)
        y = np.arange(10.0, 50.0)
        at, across = np.column_stack([np.full(40, 39.0), y]), np.tile([1.0, 0.0], (40, 1))
        shift, contrast = measure_crests(image, at, across, np.full(40, width), 4.0, np.ones(40, np.bool_))
        assert np.abs(39.0 + shift - centre).max() < 0.1
        assert contrast.min() > 20


def test_a_step_between_two_grounds_is_no_paint() -> None:
    image = np.full((60, 80), 50, np.float32)
    image[:, 40:] = 180
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    at, across = np.column_stack([np.full(40, 40.0), np.arange(10.0, 50.0)]), np.tile([1.0, 0.0], (40, 1))
    shift, _ = measure_crests(image, at, across, np.full(40, 3.0), 4.0, np.ones(40, np.bool_))
    assert np.isnan(shift).all()
    assert len(find_ridge_points(image).xy) == 0


def test_lines_of_different_widths_and_directions_are_found_where_they_were_drawn() -> None:
    image = np.full((360, 640), 70, np.uint8)
    ends = [((40, 60), (600, 90), 1), ((100, 20), (60, 340), 2), ((500, 30), (620, 330), 6), ((30, 300), (610, 250), 3)]
    for start, end, thickness in ends:
        cv2.line(image, start, end, 210, thickness, cv2.LINE_AA)
    noisy = image + np.random.default_rng(3).normal(0, 4, image.shape)
    lines = find_painted_lines(find_ridge_points(noisy.astype(np.float32)), image.shape)
    middle = np.array([(640 - 1) / 2, (360 - 1) / 2])
    for start, end, _ in ends:
        off = [np.abs((np.array(point) - middle) @ lines.normal.T - lines.offset) for point in (start, end)]
        nearest = np.argmin(np.maximum(*off))
        assert max(off[0][nearest], off[1][nearest]) < 1.0
        assert lines.cover[nearest, -1] > 0.85 * np.hypot(end[0] - start[0], end[1] - start[1])
