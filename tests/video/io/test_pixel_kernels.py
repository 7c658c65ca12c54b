"""Compiled loops over pixels, compared with NumPy and OpenCV."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import staged_shot as shot

from models.core.typing import ImageArray
from video.io.clip import read_frames
from video.io.pixel_kernels import (
    CELL_PX,
    blend_rgb,
    blend_yuv,
    dot_products,
    fill_background_difference,
    fill_blend,
    fill_cell_means,
    has_subsampled_chroma,
    subsample_chroma,
)
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_timeline import build_ball_timeline
from video.synthesis.frame_synthesis import prepare_interval


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_blend_is_the_weighted_mean_to_half_a_level(share: float) -> None:
    first, second = np.random.default_rng(3).integers(0, 256, (2, 999), dtype=np.uint8)
    mixed = np.empty_like(first)
    fill_blend(first, second, share, mixed)
    assert np.abs(mixed - (first * (1 - share) + second * share)).max() <= 0.501


def test_cell_means_equal_those_of_opencv() -> None:
    rng = np.random.default_rng(6)
    for levels in (256, 3):  # few levels: many halves
        image, cells = rng.integers(0, levels, (48, 80, 3), dtype=np.uint8), np.empty((12, 20, 3), np.uint8)
        fill_cell_means(image, cells)
        assert np.array_equal(cells, cv2.resize(image, (80 // CELL_PX, 48 // CELL_PX), interpolation=cv2.INTER_AREA))


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
    blend_rgb(image, colours, cover, x, y, 0.8)
    assert np.abs(image - wide[100:120, 100:130]).max() <= 0.501


@pytest.mark.parametrize("corner", CORNERS)
@pytest.mark.parametrize("size", [(1, 1), (8, 11)])
def test_planes_take_the_blended_luma_and_the_mean_chroma_of_four_pixels(
    corner: tuple[int, int], size: tuple[int, int]
) -> None:
    x, y = corner
    rng = np.random.default_rng(8)
    sides = ((20, 30), (10, 15), (10, 15))
    bright, blue, red = (rng.integers(0, 256, one, dtype=np.uint8) for one in sides)
    colours, cover = rng.integers(0, 256, (*size, 3), dtype=np.uint8), rng.integers(0, 256, (8, 11), dtype=np.uint8)
    wide = np.stack([bright, *(np.kron(plane, np.ones((2, 2))) for plane in (blue, red))], axis=-1)
    wide = np.pad(wide, ((100, 100), (100, 100), (0, 0)))
    here = wide[100 + y : 108 + y, 100 + x : 111 + x]
    here += (colours - here) * (0.8 / 255 * cover[..., None])
    blend_yuv(bright, blue, red, colours, cover, x, y, 0.8)
    inside = wide[100:120, 100:130]
    assert np.abs(bright - inside[..., 0]).max() <= 0.501
    for plane, exact in zip((blue, red), (inside[..., 1], inside[..., 2]), strict=True):
        assert np.abs(plane - exact.reshape(10, 2, 15, 2).mean(axis=(1, 3))).max() <= 0.501


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


TIMES = np.arange(31) / shot.RATE


def subsample(image: ImageArray) -> ImageArray:
    """Subsample the chroma of an image as a camera does."""
    subsample_chroma(image, (0, 0, shot.WIDTH, shot.HEIGHT))
    return image


def film_subsampled(t: float) -> ImageArray:
    """Film the staged shot with subsampled chroma."""
    return subsample(shot.film(t))


def test_decoded_frames_have_subsampled_chroma_and_shifted_ones_do_not(tmp_path: Path) -> None:
    _, image = next(read_frames(shot.clip_in(tmp_path, 6), indices=[1]))
    assert has_subsampled_chroma(image)
    assert not has_subsampled_chroma(np.roll(image, 1, axis=1))
    assert not has_subsampled_chroma(shot.film(0.5))


def test_subsampling_a_subsampled_image_hardly_changes_it() -> None:
    image = film_subsampled(0.5)
    again = image.copy()
    subsample_chroma(again, (0, 0, shot.WIDTH, shot.HEIGHT))
    assert np.abs(again.astype(int) - image).max() <= 2


def test_subsampling_keeps_luma_and_pixels_outside_the_box() -> None:
    rng = np.random.default_rng(4)
    image = rng.integers(90, 160, (31, 41, 3)).astype(np.uint8)
    output = image.copy()
    subsample_chroma(output, (7, -3, 60, 21))
    bright = [p @ np.array([0.299, 0.587, 0.114]) for p in (output, image)]
    assert np.abs(bright[0] - bright[1]).max() < 1
    assert np.array_equal(output[22:], image[22:])
    assert np.array_equal(output[:, :6], image[:, :6])
    assert has_subsampled_chroma(output[:22, 6:40])


def test_a_synthetic_ball_has_its_chroma_on_the_grid_of_the_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shot, "COLOURS", shot.COLOURS[::-1])  # the red ball moves
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    plate = BackgroundPlate(subsample(shot.cloth()), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))
    first, second = (float(t) for t in TIMES[10:12])
    t = 0.75 * first + 0.25 * second
    interval = prepare_interval(timeline, plate, 10, film_subsampled(first), film_subsampled(second))
    assert interval.has_square_chroma
    centres = timeline.centres_at(t, timeline.state_at(np.array([t])).xy[0])
    errors = [
        float(((synthesizer.synthesize(t, centres).astype(float) - film_subsampled(t)) ** 2).mean())
        for synthesizer in (interval, replace(interval, has_square_chroma=False))
    ]
    assert errors[0] < 0.2 * errors[1]


def test_subsampling_once_detected_is_kept_where_a_later_frame_is_undecidable() -> None:
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    plate = BackgroundPlate(subsample(shot.cloth()), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))
    frames = [film_subsampled(float(TIMES[10])), *(np.zeros_like(shot.cloth()) for _ in range(2))]
    interval = prepare_interval(timeline, plate, 10, *frames[:2])
    later = prepare_interval(timeline, plate, 11, *frames[1:], previous=interval)
    assert later.has_square_chroma
    assert not prepare_interval(timeline, plate, 11, *frames[1:]).has_square_chroma
