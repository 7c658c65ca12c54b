"""Cameras that turn and zoom in drawn pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.drawn_courts import LOOKS, aim_camera, draw_court
from support.table_images import write_clip

from models.core.court_camera import CourtCamera, CourtScene
from models.core.progress import ignore_progress
from models.core.typing import ByteArray, ImageArray
from models.sports.sport_catalogue import find_sports
from video.calibration import court_motion
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


@pytest.mark.slow
def test_a_camera_that_moves_only_at_the_end_of_a_clip_moves(tmp_path: Path) -> None:
    _, (still, *panned) = draw_pan(3, 0.006, 0.0)
    clip = open_clip(write_clip(tmp_path / "late.mp4", [still] * 38 + panned))
    scene = locate_court(clip, "table-tennis", None, ignore_progress)
    assert scene.camera.motion is not None


def test_a_camera_is_followed_back_from_a_late_reference_without_holding_all_frames(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(court_motion, "BACKWARD_FRAMES", 2)
    cameras, images = draw_pan(6, 0.004, 0.0)
    greys = [np.asarray(image[..., 1]) for image in images]
    asked: list[tuple[int, int]] = []

    def read_images(first: int, stop: int) -> list[tuple[int, ByteArray]]:
        asked.append((first, stop))
        return [(k, greys[k]) for k in range(first, stop)]

    turns, is_measured, _ = court_motion.estimate_court_motion(SPORT, cameras[5], 5, read_images, 6)
    assert is_measured.all()
    assert np.abs(turns[:, 1] - 0.004 * (np.arange(6) - 5)).max() < 0.0015
    assert [one for one in asked if one[0] < 5] == [(3, 5), (1, 3), (0, 1)]


def test_the_camera_of_a_scene_names_the_ends_of_its_court() -> None:
    tennis = find_sports()["tennis"]
    beside = aim_camera((12, -15, 6), (12, 5, 0), 900, is_left_handed=False)
    behind = aim_camera((-12, 5, 6), (12, 5, 0), 900, is_left_handed=True)
    assert CourtScene(tennis, beside, 0.3).sport.halves == ("left", "right")
    assert CourtScene(tennis, behind, 0.3).sport.halves == ("near", "far")
    assert CourtScene(SPORT, behind, 0.3).sport.halves == ("near", "far")


def test_turning_a_camera_keeps_its_place() -> None:
    camera = aim_camera((1.3, -8, 3.9), (1.4, 0.7, -0.4), 1100, is_left_handed=False)
    turned = turn_camera(camera, np.array([0.0, 0.1, 0.0, 0.2]))
    assert np.allclose(turned.centre, camera.centre)
    # A point ahead moves left by the turn to the right.
    ahead = camera.centre + 5 * camera.rays(np.array([[639.5, 359.5]]))
    focal = np.exp(turned.parameters[6])
    assert turned.to_pixels(ahead)[0, 0] == pytest.approx(639.5 + focal * np.tan(0.1), abs=1e-6)
