"""Detect: balls in every picture."""

from __future__ import annotations

from pathlib import Path

from detectors.detect import DetectOptions, detect_balls
from models.detections import Detections
from models.progress import Progress
from pipeline.stage import Inputs, Stage


def detect_stage(options: DetectOptions) -> Stage:
    return Stage("detect", __name__, ("read", "calibrate"), Detections, _run, options)


def _run(inputs: Inputs, options: DetectOptions, folder: Path, progress: Progress) -> Detections:
    return detect_balls(inputs["read"], inputs["calibrate"], options, progress)
