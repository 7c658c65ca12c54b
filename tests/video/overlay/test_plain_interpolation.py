"""In-between frames: decoded frames are unchanged, the ball in between is at its fitted position."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from support import staged_shot as shot

from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import ImageArray
from video.io.clip import Clip, read_frames
from video.io.video_writer import VideoWriter
from video.matting.ball_timeline import build_ball_timeline
from video.matting.hidden_background import estimate_hidden_background
from video.overlay.plain_interpolation import regular_frame_rate, subdivide_frame_times
from video.overlay.slow_motion import synthesize_frames
from video.synthesis.frame_synthesis import estimate_clip_appearance

FACTOR = 4


def interpolate(clip: Clip, tracks: Tracks, fit: Fit, factor: int) -> Iterator[ImageArray]:
    """Frames (H, W, 3) of the clip with `factor` - 1 synthesized ones in every gap."""
    background = estimate_hidden_background(build_ball_timeline(shot.scene(), tracks, fit), clip)
    appearance = estimate_clip_appearance(background, clip)
    return (frame.image for frame in synthesize_frames(clip, appearance, subdivide_frame_times(clip, factor)))


def test_original_frames_are_the_decoded_ones_bit_for_bit(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 10)
    frames = list(interpolate(clip, shot.tracks(clip.t), shot.fit(clip.t), FACTOR))
    assert len(frames) == 9 * FACTOR + 1
    for k, (_, real) in enumerate(read_frames(clip)):
        np.testing.assert_array_equal(frames[FACTOR * k], real)


def test_the_ball_in_between_is_at_its_fitted_position(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 12)
    frames = list(interpolate(clip, shot.tracks(clip.t), shot.fit(clip.t), FACTOR))
    times = subdivide_frame_times(clip, FACTOR)
    for k in range(FACTOR * 6 + 1, FACTOR * 7):
        true = shot.film(float(times[k])).astype(float)
        assert np.abs(frames[k] - true).mean() < 1.5
        x, y = np.rint(shot.place(float(times[k]))[0] * shot.SCALE + shot.MARGIN).astype(int)
        near = np.s_[y - 9 : y + 10, x - 9 : x + 10]
        mixed = (shot.film(6 / shot.RATE).astype(float) + shot.film(7 / shot.RATE)) / 2
        assert np.abs(frames[k][near] - true[near]).mean() < 0.5 * np.abs(mixed[near] - true[near]).mean()


def test_a_factor_of_one_is_the_clip_without_its_duplicate_frames(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 8)
    every_other = replace(clip, is_duplicate=np.arange(8) % 2 == 1)
    tracks, fit = shot.tracks(clip.t[::2]), shot.fit(clip.t[::2])
    frames = list(interpolate(every_other, replace(tracks, frame=np.arange(0, 8, 2)), fit, 1))
    assert len(frames) == 4
    assert regular_frame_rate(every_other, 3) == Fraction(shot.RATE, 2) * 3


def test_times_divide_every_gap_and_keep_the_originals(tmp_path: Path) -> None:
    clip = shot.clip_in(tmp_path, 6)
    uneven = replace(clip, t=np.array([0.0, 0.03, 0.07, 0.1, 0.15, 0.2]))
    times = subdivide_frame_times(uneven, 5)
    np.testing.assert_allclose(times[::5], uneven.t)
    np.testing.assert_allclose(np.diff(times[:6]), 0.006)
    assert regular_frame_rate(uneven, 5) is None


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
        subdivide_frame_times(clip, 0)
