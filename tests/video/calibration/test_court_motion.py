"""Cameras that turn and zoom in drawn pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drawn_courts import LOOKS, aim_camera, draw_court
from support.table_images import write_clip

from models.core.court_camera import CourtCamera
from models.core.progress import ignore_progress
from models.core.typing import ImageArray
from models.sports.sport_catalogue import find_sports
from video.calibration.court_finder import locate_court
from video.calibration.court_motion import turn_camera
from video.io.clip import open_clip

SPORT = find_sports()["table-tennis"]
LOOK = replace(LOOKS["table-tennis"], banners=0, noise=2.0, quality=85)


def draw_pan(count: int, pan: float, zoom: float) -> tuple[list[CourtCamera], list[ImageArray]]:
    """Draw frames of a camera that pans by rad and zooms by a share from one to the next."""
    start = aim_camera((1.3, -8, 3.9), (1.4, 0.7, -0.4), 1100, is_left_handed=False, size=(960, 540))
    cameras = [turn_camera(start, np.array([0.2 * pan * k, pan * k, 0, zoom * k])) for k in range(count)]
    return cameras, [draw_court(SPORT, camera, LOOK, np.random.default_rng(k)) for k, camera in enumerate(cameras)]


@pytest.mark.slow
def test_a_camera_that_pans_and_zooms_is_followed_within_half_a_pixel(tmp_path: Path) -> None:
    cameras, images = draw_pan(14, 0.004, -0.006)
    clip = open_clip(write_clip(tmp_path / "pan.mp4", images))
    scene = locate_court(clip, "table-tennis", None, ignore_progress)
    assert scene.camera.motion is not None
    assert "camera-moves" in scene.notes
    xyz = np.column_stack([SPORT.corners, np.zeros(4)])
    for frame, camera in enumerate(cameras):
        shift = np.linalg.norm(scene.camera.to_pixels(xyz, frame) - camera.to_pixels(xyz), axis=1)
        assert shift.max() < 0.5
    # A ball above the table moves with the camera as well.
    ball = np.array([[0.5, 0.8, 0.6]])
    assert np.linalg.norm(scene.camera.to_pixels(ball, 13) - cameras[13].to_pixels(ball)) < 1.0


def test_a_camera_that_stands_has_no_motion(tmp_path: Path) -> None:
    _, images = draw_pan(6, 0.0, 0.0)
    scene = locate_court(open_clip(write_clip(tmp_path / "still.mp4", images)), "table-tennis", None, ignore_progress)
    assert scene.camera.motion is None


def test_turning_a_camera_keeps_its_place() -> None:
    camera = aim_camera((1.3, -8, 3.9), (1.4, 0.7, -0.4), 1100, is_left_handed=False)
    turned = turn_camera(camera, np.array([0.0, 0.1, 0.0, 0.2]))
    assert np.allclose(turned.centre, camera.centre)
    # A point ahead moves left by the turn to the right.
    ahead = camera.centre + 5 * camera.rays(np.array([[639.5, 359.5]]))
    focal = np.exp(turned.parameters[6])
    assert turned.to_pixels(ahead)[0, 0] == pytest.approx(639.5 + focal * np.tan(0.1), abs=1e-6)
