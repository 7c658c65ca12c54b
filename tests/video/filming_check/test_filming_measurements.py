"""Measurements of filming on images whose light, blur and motion are known."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from models.core.detections import Detections
from models.core.typing import FloatArray, ImageArray
from video.filming_check.clip_sample import FRAME_RANGE, sample_clip
from video.filming_check.measure_filming import (
    CODES,
    FilmingLimits,
    Limit,
    find_glare,
    measure_clipping,
    measure_edge_blur,
    measure_exposure,
    measure_flicker,
)
from video.filming_check.motion_measurements import measure_drift, measure_exposure_time, select_lively_runs
from video.io.video_writer import VideoWriter

EVERYWHERE = np.ones((120, 200), bool)
CORNERS = np.array([[40.0, 30.0], [160.0, 30.0], [160.0, 90.0], [40.0, 90.0]])


def plain_cloth(level: int = 90) -> ImageArray:
    """A green cloth of a brightness (G channel)."""
    return np.full((120, 200, 3), (level // 3, level, level // 2), np.uint8)


def detections(rows: list[tuple[int, float, float, float]]) -> Detections:
    """Balls of radius 10 as (frame, x, y, length of the streak along x), px."""
    count = len(rows)
    table = np.array(rows)
    ones, none = np.ones(count), np.zeros((count, 3))
    streak = np.column_stack([table[:, 3], np.zeros(count)])
    return Detections(
        table[:, 0].astype(np.int64), table[:, 1:3], 10 * ones, streak, none, 0 * ones, 0 * ones, ones, ones, ones, ones
    )


@pytest.mark.parametrize("limit", [Limit(2.0, 10.0), Limit(10.0, 2.0)])
def test_a_limit_grades_both_directions(limit: Limit) -> None:
    values = (limit.good, (limit.good + limit.bad) / 2, limit.bad, limit.bad + (limit.bad - limit.good), float("nan"))
    assert [limit.grade(value) for value in values] == ["good", "doubt", "doubt", "bad", "unknown"]


def test_every_limit_has_a_reason_in_the_source() -> None:
    source = Path(__file__).parents[3] / "video" / "filming_check" / "measure_filming.py"
    lines = source.read_text(encoding="utf-8").splitlines()
    for code in CODES:
        at = next(k for k, line in enumerate(lines) if line.startswith(f"    {code}: Limit"))
        assert lines[at + 1].startswith('    """'), code
        assert getattr(FilmingLimits(), code).good != getattr(FilmingLimits(), code).bad


def test_brightness_and_clipped_pixels_are_those_of_the_table() -> None:
    image = plain_cloth(90)
    grey = float(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[0, 0])
    assert measure_exposure(image, EVERYWHERE) == grey
    image[:30] = 255
    assert measure_clipping(image, EVERYWHERE) == pytest.approx(25.0)


def test_flicker_is_half_the_range_and_no_moving_thing_counts() -> None:
    gain = 1 + 0.08 * np.sin(np.arange(60) * 0.7)
    frames = np.stack([np.full((40, 60), round(150 * g), np.uint8) for g in gain])
    steady = np.full((60, 40, 60), 150, np.uint8)
    steady[20:40, :, 10:22] = 20  # an arm over a fifth of the table
    assert measure_flicker(frames, np.ones((40, 60), bool)) == pytest.approx(8.0, abs=0.6)
    assert measure_flicker(steady, np.ones((40, 60), bool)) < 0.2


def test_glare_is_a_large_white_spot_and_a_ball_is_none() -> None:
    image = plain_cloth(90)
    cv2.circle(image, (50, 60), 8, (240, 240, 235), -1)  # a cue ball
    cv2.circle(image, (140, 60), 25, (240, 240, 235), -1)
    glare = find_glare(image, EVERYWHERE, 8.0)
    assert glare[60, 140]
    assert not glare[60, 50]
    assert glare.sum() == pytest.approx(np.pi * 25**2, rel=0.1)


def test_glare_is_found_on_cloth_with_one_strong_colour() -> None:
    image = np.full((120, 200, 3), (30, 60, 215), np.uint8)
    cv2.circle(image, (140, 60), 25, (245, 245, 250), -1)
    assert find_glare(image, EVERYWHERE, 8.0)[60, 140]


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.5])
def test_the_blur_of_edges_is_that_of_the_lens(sigma: float) -> None:
    image = np.full((120, 200), 60, np.uint8)
    image[30:90, 40:160] = 180
    blurred = cv2.GaussianBlur(image, (0, 0), sigma)
    assert measure_edge_blur(blurred, EVERYWHERE) == pytest.approx(sigma, rel=0.15)


def test_the_exposure_time_follows_from_streak_and_motion() -> None:
    """A ball goes 60 px per frame at 50 fps, smeared over 30 px: 10 ms. A resting and a slow ball do not count."""
    rows = [(k, 50.0 + 60 * k, 40.0, 30.0) for k in range(4)]
    rows += [(k, 300.0, 80.0, 0.0) for k in range(4)] + [(k, 30.0 + 2 * k, 110.0, 0.0) for k in range(4)]
    t: FloatArray = np.arange(4) / 50
    assert measure_exposure_time(detections(sorted(rows)), t) == pytest.approx(10.0)
    assert np.isnan(measure_exposure_time(detections([(k, 300.0, 80.0, 0.0) for k in range(4)]), t))


def test_the_drift_of_a_hand_is_measured_and_another_view_is_none() -> None:
    rng = np.random.default_rng(1)
    room = cv2.resize(rng.integers(0, 255, (60, 100), dtype=np.uint8), (640, 384), interpolation=cv2.INTER_CUBIC)
    corners = CORNERS * 3.2
    moved = [np.roll(room, (shift, 2 * shift), (0, 1)) for shift in (0, 1, 2, 3)]
    assert measure_drift(moved, corners) == pytest.approx(np.hypot(2, 4), abs=0.5)
    assert measure_drift([room] * 4, corners) == pytest.approx(0, abs=0.1)
    others = [cv2.resize(rng.integers(0, 255, (60, 100), dtype=np.uint8), (640, 384)) for _ in range(4)]
    assert measure_drift([room, *others], corners) == float("inf")


def test_lively_runs_are_where_a_small_thing_is_fast() -> None:
    frames = np.full((60, 40, 60), 90, np.uint8)
    for k in range(20, 26):
        frames[k, 18:21, 4 + 9 * (k - 20) : 7 + 9 * (k - 20)] = 220
    frames[40:50] += np.arange(10, dtype=np.uint8)[:, None, None] * 15  # a player in front of the lens
    runs = select_lively_runs(frames, np.ones((40, 60), bool))
    assert all(len(run) == 3 for run in runs)
    assert set(runs[0]) | set(runs[1]) <= set(range(28))
    assert {21, 22, 23} & {k for run in runs for k in run}


def test_a_sample_of_a_long_clip_is_its_liveliest_part(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    still = cv2.resize(rng.integers(0, 255, (30, 40, 3), dtype=np.uint8), (800, 600))
    path = tmp_path / "long.mp4"
    with VideoWriter(path, 800, 600, Fraction(30), crf=20, key_s=1.0) as writer:
        for k in range(500):
            image = still.copy()
            if 300 <= k < 400:
                part = np.s_[100:300, 2 * (k - 300) : 200 + 2 * (k - 300)]
                image[part] = 255 - image[part]
            writer.write(image)
    sample = sample_clip(path)
    assert len(sample.times) == 500
    assert FRAME_RANGE[0] <= sample.clip.frame_count < 400
    first, last = sample.clip.first_frame, sample.clip.first_frame + sample.clip.frame_count
    assert first % 30 == 0
    assert min(last, 400) - max(first, 300) > 80, "most of the motion is inside"
    assert np.abs(sample.stills[0].astype(int) - still).mean() < 60
    assert 0.625 * 2 ** (10 / 6) < sample.quantiser_step < 0.625 * 2 ** (26 / 6), "constant rate factor 20"


@pytest.mark.parametrize(("streak", "exposure_ms"), [(38.0, 0.95 * 1e3 / 30), (48.0, float("nan"))])
def test_no_shutter_is_open_for_longer_than_a_frame(streak: float, exposure_ms: float) -> None:
    """A longer streak belongs to something else."""
    balls = detections([(k, 40.0 + 40.0 * k, 60.0, streak) for k in range(3)])
    assert measure_exposure_time(balls, np.arange(3) / 30) == pytest.approx(exposure_ms, nan_ok=True)
