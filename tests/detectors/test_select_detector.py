"""Which detector `auto` takes: the one for the camera's height over the table."""

from __future__ import annotations

import numpy as np
import pytest

from detectors.detect_options import DetectOptions
from detectors.select_detector import camera_elevation, explain_selection, note_selection, select_detector
from models.core.scene import Camera, Scene, Table


def scene_from(degrees: float) -> Scene:
    """A 9 ft table seen by a camera 4 m from its middle, so high over the cloth, beyond its right end."""
    table = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, True)
    middle = np.array([1.27, 0.635, 0.0])
    forward = -np.array([np.cos(np.radians(degrees)), 0.0, np.sin(np.radians(degrees))])
    right = np.array([0.0, 1.0, 0.0])
    pose = np.stack([right, np.cross(forward, right), forward])
    optics = np.array([[1000.0, 0, 512], [0, 1000.0, 288], [0, 0, 1]])
    matrix = optics @ np.column_stack([pose, -pose @ (middle - 4 * forward)])
    camera = Camera(matrix, 1024, 576, np.zeros((4, 2)), np.eye(8), "cloth", 1.0, 0.1)
    return Scene(table, camera, np.array([40.0, -30.0, 0.0]), ("found by its cloth",))


@pytest.mark.parametrize("degrees", [20.0, 45.0, 80.0])
def test_the_elevation_is_that_of_the_camera(degrees: float) -> None:
    assert camera_elevation(scene_from(degrees)) == pytest.approx(degrees)


def test_a_low_camera_takes_the_network_and_a_high_one_circles() -> None:
    assert select_detector(DetectOptions(), scene_from(20.0)) == "onnx"
    assert select_detector(DetectOptions(), scene_from(85.0)) == "hough"
    assert select_detector(DetectOptions(), scene_from(85.0), is_still=True) == "onnx"
    assert select_detector(DetectOptions(detector="hough"), scene_from(85.0), is_still=True) == "hough"


def test_a_requested_detector_is_selected_at_any_height() -> None:
    for degrees in (20.0, 85.0):
        assert select_detector(DetectOptions(detector="hough"), scene_from(degrees)) == "hough"
        assert select_detector(DetectOptions(detector="onnx"), scene_from(degrees)) == "onnx"
        assert select_detector(DetectOptions(model="own.onnx"), scene_from(degrees)) == "onnx"


@pytest.mark.parametrize("degrees", [20.0, 85.0])
def test_the_reason_names_the_detector_and_is_noted(degrees: float) -> None:
    scene = scene_from(degrees)
    reason = explain_selection(DetectOptions(), scene)
    assert reason.startswith(select_detector(DetectOptions(), scene))
    assert f"{degrees:.0f} degrees" in reason
    assert note_selection(scene, DetectOptions()).notes == (*scene.notes, f"balls detected by {reason}")
    assert "as requested" in explain_selection(DetectOptions(detector="onnx"), scene)
