"""Motion of a camera that a hand holds, from registrations with known errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from models.core.typing import FloatArray
from video.calibration import camera_motion
from video.calibration.camera_motion import (
    ReferenceFeatures,
    Registration,
    estimate_camera_motion,
    measure_shifts,
)
from video.calibration.table_finder import calibrate_clip
from video.calibration.view_prior import MOTION_NOTE
from video.io.clip import open_clip, read_frames
from video.io.video_options import CalibrateOptions
from video.io.video_writer import VideoWriter

SAMPLES = Path(__file__).resolve().parents[3] / "sample_videos"
CORNERS = np.array([[40.0, 30.0], [280.0, 30.0], [280.0, 150.0], [40.0, 150.0]])


def smoothed_shift(shift: FloatArray, monkeypatch: pytest.MonkeyPatch) -> FloatArray:
    """Motion (T,) px to the right that is estimated where every frame is registered with that of `shift`."""

    def register(reference: ReferenceFeatures, grey: np.ndarray, guess: FloatArray | None) -> Registration:
        homography = np.eye(3)
        homography[0, 2] = shift[int(grey[0, 0])]
        return Registration(homography, 1.0, 0.1, 0.0)

    monkeypatch.setattr(camera_motion, "register_image", register)
    reference = ReferenceFeatures(np.zeros((4, 4), np.uint8), np.empty((0, 1, 2), np.float32), CORNERS, 1.0)
    frames = ((k, np.full((4, 4), k, np.uint8)) for k in range(len(shift)))
    return estimate_camera_motion(reference, frames, len(shift))[0][:, 0, 2]


def test_the_tremor_of_a_hand_stays_and_errors_of_registration_shrink(monkeypatch: pytest.MonkeyPatch) -> None:
    t, rng = np.arange(200) / 30, np.random.default_rng(1)
    tremor, noise = 3 * np.sin(2 * np.pi * 6 * t), rng.normal(0, 0.3, 200)
    assert np.std(smoothed_shift(tremor, monkeypatch)) > 0.75 * np.std(tremor)
    assert np.std(smoothed_shift(noise, monkeypatch)) < 0.8 * np.std(noise)


def test_a_knock_is_followed_at_once_and_a_stand_is_still_before_and_after(monkeypatch: pytest.MonkeyPatch) -> None:
    t, rng = np.arange(150) / 30, np.random.default_rng(1)
    knock = np.where(t >= 2, 10 * np.exp(-np.maximum(t - 2, 0) / 0.15), 0.0)
    estimate = smoothed_shift(knock + rng.normal(0, 0.1, 150), monkeypatch)
    assert np.abs(estimate - knock)[55:75].max() < 0.8
    assert np.ptp(estimate[:55]) < 0.4
    assert np.count_nonzero(estimate == np.median(estimate)) > 100


def knock_camera(image: np.ndarray, t: float) -> np.ndarray:
    """Shift an image as a camera on a stand does that is knocked by 10 px at 1.5 s."""
    shift = 10 * np.exp(-(t - 1.5) / 0.15) * np.cos(6 * np.pi * (t - 1.5)) if t >= 1.5 else 0.0
    return np.asarray(ndimage.shift(image, (0.6 * shift, shift, 0), order=1, mode="nearest"), np.uint8)


def test_a_knock_between_the_sampled_frames_is_noticed(tmp_path: Path) -> None:
    clip = open_clip(SAMPLES / "overhead_pool.mp4")
    assert calibrate_clip(clip, CalibrateOptions()).camera.motion is None
    with VideoWriter(tmp_path / "knock.mp4", clip.width, clip.height, clip.fps, crf=16) as writer:
        for frame, rgb in read_frames(clip, indices=clip.frames):
            writer.write(knock_camera(rgb, float(clip.t[frame])))
    scene = calibrate_clip(open_clip(tmp_path / "knock.mp4"), CalibrateOptions())
    assert scene.camera.motion is not None
    shift = measure_shifts(scene.camera.corners_px, scene.camera.motion)
    assert shift.max() == pytest.approx(np.hypot(10, 6), abs=1.5)
    assert np.median(shift) < 0.8
    assert any(note.startswith(MOTION_NOTE) and "for a moment" in note for note in scene.notes)
