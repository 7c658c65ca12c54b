"""Which detector looks at a scene, and why."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from detectors.options import DetectOptions
from models.core.scene import Scene

OBLIQUE_DEG = 50.0
"""A camera lower than this over the table makes balls hide each other, and shows their dark undersides: there the
network, which has learnt both, finds more. Straight above it invents balls in hands, tips and racks that circles do
not, and explains no more. Measured on rendered halls and on broadcasts (docs/detectors.md)."""


def chosen(options: DetectOptions, scene: Scene, still: bool = False) -> Literal["hough", "onnx"]:
    """The detector that is used on a scene; a network that is named is wanted.

    In a still picture always the network: shadows and rings of light, which a clip shows to stay where they are, look
    like circles there (9 of 265 on the shared stills, none with the network).
    """
    if options.detector != "auto":
        return options.detector
    if options.model is not None or still or elevation(scene) < OBLIQUE_DEG:
        return "onnx"
    return "hough"


def why_chosen(options: DetectOptions, scene: Scene, still: bool = False) -> str:
    """The detector that is used on a scene and the reason, in a few words."""
    if options.detector != "auto":
        return f"{options.detector}, as asked for"
    if options.model is not None:
        return "onnx, because a network was named"
    if still:
        return "onnx: in a single picture the network tells balls from shadows and rings of light"
    taken = chosen(options, scene)
    better = "the network tells balls apart that cover each other" if taken == "onnx" else "circles are seen whole"
    return f"{taken}: the camera looks down at {elevation(scene):.0f} degrees, where {better}"


def elevation(scene: Scene) -> float:
    """How high the camera stands over the middle of the table, degrees: 90 straight above."""
    table = scene.table
    to_eye = scene.camera.eye - np.array([table.length / 2, table.width / 2, 0.0])
    return float(np.degrees(np.arctan2(to_eye[2], np.hypot(to_eye[0], to_eye[1]))))


def with_choice_noted(scene: Scene, options: DetectOptions) -> Scene:
    """The scene with the detector that was used on it, and why, among its notes."""
    return replace(scene, notes=(*scene.notes, f"balls found by {why_chosen(options, scene)}"))
