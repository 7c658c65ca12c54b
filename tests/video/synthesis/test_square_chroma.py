"""Synthesized balls have one colour per two by two pixels where those of the clip do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import staged_shot as shot

from models.core.typing import ImageArray
from video.io.clip import read_frames
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_timeline import build_ball_timeline
from video.synthesis.frame_synthesis import has_subsampled_chroma, prepare_interval, subsample_chroma

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
