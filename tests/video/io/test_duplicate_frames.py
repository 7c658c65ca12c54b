"""Duplicate frames in clips of known truth, coded as cameras and converters do (B-frames, skipped blocks)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from support.sample_clips import NAMES, SAMPLES

from models.core.typing import ImageArray
from video.io.clip import open_clip, read_frames
from video.io.duplicate_frames import MAX_DUPLICATE_CHANGE, FrameChangeMeter, find_duplicate_frames

WIDTH, HEIGHT = 360, 180


def draw_scene(balls: Sequence[tuple[float, float]], radius: float = 7.0) -> ImageArray:
    """Draw white balls on green cloth between wooden rails, anti-aliased, RGB (180, 360, 3)."""
    image = np.full((HEIGHT, WIDTH, 3), (90, 60, 40), np.uint8)
    cv2.rectangle(image, (20, 20), (WIDTH - 21, HEIGHT - 21), (30, 110, 60), -1)
    for x, y in balls:
        cv2.circle(image, (round(x * 16), round(y * 16)), round(radius * 16), (225, 220, 210), -1, cv2.LINE_AA, 4)
    return image


def find_duplicates_after_coding(
    path: Path, images: Sequence[ImageArray], rate: int = 30, crf: int = 24, noise: float = 0.0
) -> NDArray[np.bool_]:
    """Find duplicates after x264 with B-frames; sensor noise (grey levels) is new for each new image object."""
    rng, last, noisy = np.random.default_rng(3), None, draw_scene([])
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"crf": str(crf), "preset": "veryfast"}
        for image in images:
            if image is not last and noise > 0:
                noisy = np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
            elif image is not last:
                noisy = image
            last = image
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noisy, format="rgb24")))
        container.mux(stream.encode(None))
    return open_clip(path).is_duplicate


def roll_ball(count: int, speed: float, start: float = 36.0) -> list[ImageArray]:
    return [draw_scene([(start + speed * k, 90.0)]) for k in range(count)]


def repeat_frames(images: Sequence[ImageArray], times: Sequence[int]) -> tuple[list[ImageArray], NDArray[np.bool_]]:
    """Repeat each image as often as `times` prescribes, cyclically; also return which of the frames are duplicates."""
    frames, truth = [], []
    for k, image in enumerate(images):
        n = times[k % len(times)]
        frames += [image] * n
        truth += [False] + [True] * (n - 1)
    return frames, np.array(truth)


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("times", [(2,), (4,), (2, 3), (1, 1, 1, 1, 2)], ids=["15in30", "15in60", "24in60", "25in30"])
def test_a_regular_cadence_is_found_without_fault(tmp_path: Path, times: tuple[int, ...], noise: float) -> None:
    frames, truth = repeat_frames(roll_ball(40, 7.0), times)
    detected = find_duplicates_after_coding(tmp_path / "a.mp4", frames, noise=noise)
    last_change = np.flatnonzero(~truth)[-1]
    assert np.array_equal(detected[: last_change + 1], truth[: last_change + 1])


def test_an_irregular_cadence_is_found_between_motion(tmp_path: Path) -> None:
    times = np.random.default_rng(5).choice([1, 2, 3, 4], 40, p=[0.2, 0.4, 0.3, 0.1]).tolist()
    frames, truth = repeat_frames(roll_ball(36, 8.0), times)
    detected = find_duplicates_after_coding(tmp_path / "a.mp4", frames, noise=1.0)
    assert not np.any(detected & ~truth)
    assert np.count_nonzero(detected) >= 0.9 * np.count_nonzero(truth)


def test_the_cadence_goes_on_where_the_balls_slow_down_and_rest(tmp_path: Path) -> None:
    way = np.cumsum(np.clip(9.0 - 0.25 * np.arange(60), 0.0, None))
    frames, truth = repeat_frames([draw_scene([(36 + x, 90.0)]) for x in way], (2,))
    detected = find_duplicates_after_coding(tmp_path / "a.mp4", frames)
    assert not np.any(detected & ~truth)
    assert np.count_nonzero(truth & ~detected) <= 3  # below half a pixel, coding catches up in the repeats
    assert np.array_equal(detected[76:], truth[76:])


@pytest.mark.parametrize("crf", [18, 32])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_still_scene_has_no_duplicates(tmp_path: Path, crf: int, noise: float) -> None:
    frames = [draw_scene([(100, 100), (200, 150)]) for _ in range(60)]
    assert not find_duplicates_after_coding(tmp_path / "a.mp4", frames, crf=crf, noise=noise).any()


@pytest.mark.parametrize("crf", [18, 32])
@pytest.mark.parametrize("speed", [0.3, 0.6, 1.0, 1.5])
def test_a_slow_roll_is_motion(tmp_path: Path, speed: float, crf: int) -> None:
    assert not find_duplicates_after_coding(tmp_path / "a.mp4", roll_ball(60, speed), rate=60, crf=crf).any()


def test_a_ball_that_comes_to_rest_and_is_struck_again_is_no_duplicate(tmp_path: Path) -> None:
    speed = np.concatenate([np.full(10, 6.0), np.linspace(6, 0, 30), np.zeros(4), np.full(20, 6.0), np.zeros(40)])
    frames = [draw_scene([(36 + x, 90.0)]) for x in np.cumsum(speed)]
    assert not find_duplicates_after_coding(tmp_path / "a.mp4", frames, rate=60).any()


def test_a_ball_that_reverses_at_the_cushions_is_no_duplicate(tmp_path: Path) -> None:
    """Four times the ball reverses half-way between two frames, which are then equal."""
    way = [abs((11.2 * k + 5.6) % 560 - 280) for k in range(110)]
    assert not find_duplicates_after_coding(tmp_path / "a.mp4", [draw_scene([(40 + x, 90.0)]) for x in way]).any()


def test_a_single_duplicate_stays_an_observation(tmp_path: Path) -> None:
    frames = roll_ball(50, 7.0)
    assert not find_duplicates_after_coding(tmp_path / "a.mp4", [*frames[:25], frames[24], *frames[25:]]).any()


def test_a_flickering_spot_is_no_motion() -> None:
    meter, dark = FrameChangeMeter(), np.full((180, 320), 60, np.uint8)
    bright = dark.copy()
    bright[40:43, 50:52] = 255
    changes = [meter.measure_change(image) for image in [dark, dark, bright, bright] * 10]
    assert max(change for change, _ in changes[1:]) < MAX_DUPLICATE_CHANGE


def test_a_key_frame_on_a_duplicate_does_not_hide_it() -> None:
    change = np.array([np.inf, *[2.0, 90.0] * 20])
    change[21] = 7.0
    assert find_duplicate_frames(change, np.full(len(change), 90.0))[21]


def test_two_cadences_in_disagreement_leave_the_rest_between_them_open() -> None:
    change = np.array([np.inf, *[2.0, 60.0] * 12, *[1.0] * 20, 60.0, *[2.0, 60.0] * 12])  # slips in the rest
    repeat = find_duplicate_frames(change, np.full(len(change), 90.0))
    assert repeat[1:25:2].all()
    assert not repeat[25:45].any()


@pytest.mark.parametrize(
    ("name", "share"),
    [("snooker_video_9_0056_0101", 0.5), ("snooker_video_13_0030_0034", 0.5), ("pool9ft_overhead_poolTest3", 0.58)],
)
def test_duplicates_in_real_containers_are_found(footage: Path, name: str, share: float) -> None:
    assert open_clip(footage / f"{name}.mp4").is_duplicate.mean() == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("name", ["carom_F3", "snooker_simulation_vs_reality_1_0008_0011", "phone_overhead_break"])
def test_real_clips_without_duplicates_stay_whole(footage: Path, name: str) -> None:
    clip = open_clip(footage / f"{name}.mp4")
    assert not clip.is_duplicate.any()
    assert isinstance(clip.fps, Fraction)


def test_duplicates_in_a_rendered_container_are_found(tmp_path: Path) -> None:
    """A sample clip at half its rate, every frame shown twice."""
    images = [cv2.resize(image, (WIDTH, HEIGHT)) for _, image in read_frames(open_clip(SAMPLES / "overhead_pool.mp4"))]
    frames, truth = repeat_frames(images[:80:2], [2])
    found = find_duplicates_after_coding(tmp_path / "a.mp4", frames)
    assert found.mean() == pytest.approx(truth.mean(), abs=0.02)


@pytest.mark.parametrize("name", NAMES)
def test_rendered_clips_without_duplicates_stay_whole(name: str) -> None:
    clip = open_clip(SAMPLES / f"{name}.mp4")
    assert not clip.is_duplicate.any()
    assert isinstance(clip.fps, Fraction)


@pytest.mark.parametrize(
    ("copies", "frames", "found"),
    [
        ([10, 31], 60, 0),  # two: a cue that reverses twice
        ([10, 31, 47], 60, 3),
        ([10, 31, 77], 90, 3),  # one in thirty, as in a clip converted from 29 to 30 fps
        ([10, 31, 77], 130, 0),  # one in forty: no container repeats frames so rarely
    ],
)
def test_a_container_repeats_frames_often_enough_to_tell(copies: list[int], frames: int, found: int) -> None:
    change = np.full(frames, 60.0)
    change[copies] = 1.0
    assert find_duplicate_frames(change, np.full(frames, 90.0)).sum() == found
