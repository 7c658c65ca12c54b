"""Detect: balls in every picture."""

from __future__ import annotations

import hashlib
from pathlib import Path

from detectors.options import DetectOptions
from models.core.detections import Detections
from models.core.errors import OptionError
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage


def detect_stage(options: DetectOptions) -> Stage:
    facts = {} if options.model is None else {"model": _digest(Path(options.model))}
    return Stage("detect", __name__, ("read", "calibrate"), Detections, _run, options, facts)


def _digest(model: Path) -> str:
    """SHA-256 of the file: another network under the same name is another detector."""
    try:
        with model.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise OptionError(f"--model is the file of an ONNX ball detector; {model}: {error.strerror}") from error


def _run(inputs: Inputs, options: DetectOptions, folder: Path, progress: Progress) -> Detections:
    from detectors.detect import detect_balls  # slow to import, and not needed while cached

    return detect_balls(inputs["read"], inputs["calibrate"], options, progress)
