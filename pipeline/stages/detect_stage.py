"""The detect stage: finds the balls in every frame."""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path

from detectors.detect_options import DetectOptions
from models.core.detections import Detections
from models.core.errors import OptionError
from models.core.progress import Progress
from models.numerics.executor import SERIAL, Executor
from pipeline.engine.stage import Inputs, Stage


def detect_stage(options: DetectOptions, executor: Executor = SERIAL) -> Stage:
    """Build the stage that detects balls.

    Args:
        options: Options of the stage.
        executor: Where parts of the clip are searched; it changes no result.

    Returns:
        The stage `detect`, whose output is `Detections`.

    Raises:
        OptionError: The file of the network cannot be read.
    """
    facts = {} if options.model is None else {"model": _hash_model(Path(options.model))}
    return Stage(
        "detect", __name__, ("read", "calibrate"), Detections, partial(_detect_balls, executor), options, facts
    )


def load_detectors() -> None:
    """Load modules, networks and compiled code, which takes a second, before the stage begins in a helper process."""
    import numpy as np

    from detectors import detect as detect
    from detectors.network.ball_model import SHIPPED_BALL_MODEL, open_ball_model
    from detectors.network.offset_regressor import DISC, STREAK, open_offset_regressor
    from models.numerics.statistics import huber_losses

    open_ball_model(SHIPPED_BALL_MODEL)
    for kind in (STREAK, DISC):
        open_offset_regressor(kind)
    huber_losses(np.zeros((1, 1)))  # the first call loads the compiler's registries


def _hash_model(model: Path) -> str:
    """Return the SHA-256 of the file: another network under the same name is another detector."""
    try:
        with model.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise OptionError(f"--model is the file of an ONNX ball detector; {model}: {error.strerror}") from error


def _detect_balls(
    executor: Executor, inputs: Inputs, options: DetectOptions, folder: Path, progress: Progress
) -> Detections:
    """Detect the balls in every frame."""
    from detectors.detect import detect_balls  # slow to import

    return detect_balls(inputs["read"], inputs["calibrate"], options, progress, executor)
