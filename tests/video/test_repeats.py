"""Repeats against clips whose truth is known, coded as cameras and converters code them (B-frames, skipped blocks)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from models.core.typing import ImageArray
from video.io.clip import open_clip
from video.io.duplicate_frames import QUIET, ChangeMeter, mark_repeats

WIDTH, HEIGHT = 360, 180


def scene(balls: Sequence[tuple[float, float]], radius: float = 7.0) -> ImageArray:
    """White balls on green cloth between wooden rails, anti-aliased, RGB (180, 360, 3)."""
    picture = np.full((HEIGHT, WIDTH, 3), (90, 60, 40), np.uint8)
    cv2.rectangle(picture, (20, 20), (WIDTH - 21, HEIGHT - 21), (30, 110, 60), -1)
    for x, y in balls:
        cv2.circle(picture, (round(x * 16), round(y * 16)), round(radius * 16), (225, 220, 210), -1, cv2.LINE_AA, 4)
    return picture


def coded(
    path: Path, pictures: Sequence[ImageArray], rate: int = 30, crf: int = 24, noise: float = 0.0
) -> NDArray[np.bool_]:
    """Repeats found after x264 with B-frames; sensor noise (grey levels) is new where the picture is a new object."""
    rng, last, noisy = np.random.default_rng(3), None, scene([])
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"crf": str(crf), "preset": "veryfast"}
        for picture in pictures:
            if picture is not last and noise > 0:
                noisy = np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8)
            elif picture is not last:
                noisy = picture
            last = picture
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noisy, format="rgb24")))
        container.mux(stream.encode(None))
    return open_clip(path).repeat


def rolling(count: int, speed: float, start: float = 36.0) -> list[ImageArray]:
    return [scene([(start + speed * k, 90.0)]) for k in range(count)]


def shown(pictures: Sequence[ImageArray], times: Sequence[int]) -> tuple[list[ImageArray], NDArray[np.bool_]]:
    """Every picture as often as `times` says, over and over; and which of those are repeats."""
    film, truth = [], []
    for k, picture in enumerate(pictures):
        n = times[k % len(times)]
        film += [picture] * n
        truth += [False] + [True] * (n - 1)
    return film, np.array(truth)


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("times", [(2,), (4,), (2, 3), (1, 1, 1, 1, 2)], ids=["15in30", "15in60", "24in60", "25in30"])
def test_a_regular_cadence_is_found_without_fault(tmp_path: Path, times: tuple[int, ...], noise: float) -> None:
    film, truth = shown(rolling(40, 7.0), times)
    found = coded(tmp_path / "a.mp4", film, noise=noise)
    last_change = np.flatnonzero(~truth)[-1]
    assert np.array_equal(found[: last_change + 1], truth[: last_change + 1])


def test_an_irregular_cadence_is_found_between_motion(tmp_path: Path) -> None:
    times = np.random.default_rng(5).choice([1, 2, 3, 4], 40, p=[0.2, 0.4, 0.3, 0.1]).tolist()
    film, truth = shown(rolling(36, 8.0), times)
    found = coded(tmp_path / "a.mp4", film, noise=1.0)
    assert not np.any(found & ~truth)
    assert np.count_nonzero(found) >= 0.9 * np.count_nonzero(truth)


def test_the_cadence_goes_on_where_the_balls_slow_down_and_rest(tmp_path: Path) -> None:
    way = np.cumsum(np.clip(9.0 - 0.25 * np.arange(60), 0.0, None))
    film, truth = shown([scene([(36 + x, 90.0)]) for x in way], (2,))
    found = coded(tmp_path / "a.mp4", film)
    assert not np.any(found & ~truth)
    assert np.count_nonzero(truth & ~found) <= 3  # below half a pixel, coding catches up in the repeats
    assert np.array_equal(found[76:], truth[76:])


@pytest.mark.parametrize("crf", [18, 32])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_still_scene_has_no_repeats(tmp_path: Path, crf: int, noise: float) -> None:
    film = [scene([(100, 100), (200, 150)]) for _ in range(60)]
    assert not coded(tmp_path / "a.mp4", film, crf=crf, noise=noise).any()


@pytest.mark.parametrize("crf", [18, 32])
@pytest.mark.parametrize("speed", [0.3, 0.6, 1.0, 1.5])
def test_a_slow_roll_is_motion(tmp_path: Path, speed: float, crf: int) -> None:
    assert not coded(tmp_path / "a.mp4", rolling(60, speed), rate=60, crf=crf).any()


def test_a_ball_that_comes_to_rest_and_is_struck_again_is_no_repeat(tmp_path: Path) -> None:
    speed = np.concatenate([np.full(10, 6.0), np.linspace(6, 0, 30), np.zeros(4), np.full(20, 6.0), np.zeros(40)])
    film = [scene([(36 + x, 90.0)]) for x in np.cumsum(speed)]
    assert not coded(tmp_path / "a.mp4", film, rate=60).any()


def test_a_ball_that_turns_round_at_the_cushions_is_no_repeat(tmp_path: Path) -> None:
    """Four times it turns round half-way between two pictures, which are then alike."""
    way = [abs((11.2 * k + 5.6) % 560 - 280) for k in range(110)]
    assert not coded(tmp_path / "a.mp4", [scene([(40 + x, 90.0)]) for x in way]).any()


def test_a_single_doubled_picture_stays_an_observation(tmp_path: Path) -> None:
    film = rolling(50, 7.0)
    assert not coded(tmp_path / "a.mp4", [*film[:25], film[24], *film[25:]]).any()


def test_a_twinkling_spot_is_no_motion() -> None:
    meter, dark = ChangeMeter(), np.full((180, 320), 60, np.uint8)
    bright = dark.copy()
    bright[40:43, 50:52] = 255
    changes = [meter.change(picture) for picture in [dark, dark, bright, bright] * 10]
    assert max(change for change, _ in changes[1:]) < QUIET


def test_a_key_frame_on_a_repeat_does_not_hide_it() -> None:
    change = np.array([np.inf, *[2.0, 90.0] * 20])
    change[21] = 7.0
    assert mark_repeats(change, np.full(len(change), 90.0))[21]


def test_two_cadences_in_disagreement_leave_the_rest_between_them_open() -> None:
    change = np.array([np.inf, *[2.0, 60.0] * 12, *[1.0] * 20, 60.0, *[2.0, 60.0] * 12])  # slips in the rest
    repeat = mark_repeats(change, np.full(len(change), 90.0))
    assert repeat[1:25:2].all()
    assert not repeat[25:45].any()


@pytest.mark.parametrize(
    ("name", "share"),
    [("snooker_video_9_0056_0101", 0.5), ("snooker_video_13_0030_0034", 0.5), ("pool9ft_overhead_poolTest3", 0.58)],
)
def test_real_containers_that_repeat_are_seen_through(footage: Path, name: str, share: float) -> None:
    assert open_clip(footage / f"{name}.mp4").repeat.mean() == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("name", ["carom_F3", "snooker_simulation_vs_reality_1_0008_0011", "phone_overhead_break"])
def test_real_clips_of_distinct_pictures_stay_whole(footage: Path, name: str) -> None:
    clip = open_clip(footage / f"{name}.mp4")
    assert not clip.repeat.any()
    assert isinstance(clip.rate, Fraction)
