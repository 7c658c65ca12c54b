"""Frames between frames: the decoded ones untouched, the ball in between where the motion puts it."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from support import staged_shot as shot

from video.io.clip import read_frames
from video.io.video_writer import VideoWriter
from video.overlay.plain_interpolation import between, even_rate, times_between

FACTOR = 4


def test_originals_are_the_decoded_pictures_bit_for_bit(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 10)
    made = list(between(clip, shot.scene(), shot.tracks(clip.t), shot.fit(clip.t), FACTOR))
    assert len(made) == 9 * FACTOR + 1
    for k, (_, real) in enumerate(read_frames(clip)):
        np.testing.assert_array_equal(made[FACTOR * k], real)


def test_the_ball_in_between_is_where_the_motion_puts_it(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 12)
    made = list(between(clip, shot.scene(), shot.tracks(clip.t), shot.fit(clip.t), FACTOR))
    times = times_between(clip, FACTOR)
    for k in range(FACTOR * 6 + 1, FACTOR * 7):
        true = shot.film(float(times[k])).astype(float)
        assert np.abs(made[k] - true).mean() < 1.5
        x, y = np.rint(shot.place(float(times[k]))[0] * shot.SCALE + shot.MARGIN).astype(int)
        near = np.s_[y - 9 : y + 10, x - 9 : x + 10]
        mixed = (shot.film(6 / shot.RATE).astype(float) + shot.film(7 / shot.RATE)) / 2
        assert np.abs(made[k][near] - true[near]).mean() < 0.5 * np.abs(mixed[near] - true[near]).mean()


def test_a_factor_of_one_is_the_clip_without_its_repeats(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 8)
    seen = replace(clip, repeat=np.arange(8) % 2 == 1)
    tracks, fit = shot.tracks(clip.t[::2]), shot.fit(clip.t[::2])
    made = list(between(seen, shot.scene(), replace(tracks, frame=np.arange(0, 8, 2)), fit, 1))
    assert len(made) == 4
    assert even_rate(seen, 3) == Fraction(shot.RATE, 2) * 3


def test_times_divide_every_gap_and_keep_the_originals(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 6)
    uneven = replace(clip, t=np.array([0.0, 0.03, 0.07, 0.1, 0.15, 0.2]))
    times = times_between(uneven, 5)
    np.testing.assert_allclose(times[::5], uneven.t)
    np.testing.assert_allclose(np.diff(times[:6]), 0.006)
    assert even_rate(uneven, 5) is None


def test_uneven_times_are_written_as_they_are(tmp_path: Path) -> None:
    times = [0.0, 0.013, 0.02, 0.0777]
    with VideoWriter(tmp_path / "a.mp4", 64, 48, Fraction(50), time_base=Fraction(1, 90000)) as video:
        for k, t in enumerate(times):
            video.write(np.full((48, 64, 3), 60 * k, np.uint8), t)
    with av.open(str(tmp_path / "a.mp4")) as container:
        shown = [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]
    np.testing.assert_allclose(shown, times, atol=1 / 90000)


def test_no_factor_below_one(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 6)
    with pytest.raises(ValueError, match="1 or more"):
        next(between(clip, shot.scene(), shot.tracks(clip.t), shot.fit(clip.t), 0))
