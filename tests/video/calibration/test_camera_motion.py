"""Motion of a camera that a hand holds, from registrations with known errors."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from video.calibration import camera_motion
from video.calibration.camera_motion import ReferenceFeatures, Registration, estimate_camera_motion

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
