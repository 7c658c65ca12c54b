"""Selection of the detector for a scene, with the reason."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from detectors.detect_options import DetectOptions
from models.core.scene import Scene

# Elevation of the camera, degrees, below which balls hide each other and show their dark undersides: there the network,
# which was trained on both, detects more balls. From straight above it has false positives in hands, tips and racks
# that the circle detector does not have, and detects no more. Measured on rendered venues and on broadcasts
# (docs/explanation/detection.md).
OBLIQUE_ELEVATION_DEG = 50.0


def select_detector(options: DetectOptions, scene: Scene, is_still: bool = False) -> Literal["hough", "onnx"]:
    """Select the detector for a scene; a network named in the options implies the detector with a network.

    For a single image it is always the network: shadows and rings of light, which a clip shows to be static, look like
    circles there (9 of 265 on the shared stills, none with the network).
    """
    if options.detector != "auto":
        return options.detector
    if options.model is not None or is_still or camera_elevation(scene) < OBLIQUE_ELEVATION_DEG:
        return "onnx"
    return "hough"


def explain_selection(options: DetectOptions, scene: Scene, is_still: bool = False) -> str:
    """Name the detector that is used on a scene, with the reason in a few words."""
    if options.detector != "auto":
        return f"{options.detector}, as requested"
    if options.model is not None:
        return "onnx, because a network was named"
    if is_still:
        return "onnx: in a single image the network distinguishes balls from shadows and rings of light"
    selected = select_detector(options, scene)
    reason = (
        "the network separates balls that cover each other" if selected == "onnx" else "circles are completely visible"
    )
    return f"{selected}: the camera looks down at {camera_elevation(scene):.0f} degrees, where {reason}"


def camera_elevation(scene: Scene) -> float:
    """Elevation of the camera above the middle of the table, degrees: 90 is straight above."""
    table = scene.table
    to_eye = scene.camera.position - np.array([table.length / 2, table.width / 2, 0.0])
    return float(np.degrees(np.arctan2(to_eye[2], np.hypot(to_eye[0], to_eye[1]))))


def note_selection(scene: Scene, options: DetectOptions) -> Scene:
    """Add the selected detector and the reason to the notes of a scene.

    Args:
        scene: Table and camera.
        options: Options of the detection.

    Returns:
        The scene with the note.
    """
    return replace(scene, notes=(*scene.notes, f"balls detected by {explain_selection(options, scene)}"))
