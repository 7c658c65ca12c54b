"""From nothing to a detector in a file: train, check on held-out halls, calibrate, export."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import cv2
import torch

from detectors.export import export
from detectors.network import WIDTHS
from detectors.training import TrainOptions, Watch, steps_done, train
from detectors.training_check import as_facts, checked
from detectors.training_data import PICTURES_PER_FILE
from video.training_pictures import SIZE_PX


def make_detector(work: Path, options: TrainOptions, out: Path, watch: Watch) -> dict[str, float]:
    """Train in a folder, write the ONNX file, return its figures on held-out halls."""
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    network = train(work, options, watch)
    calibration, figures = checked(network, work)
    facts = as_facts(calibration, figures)
    recipe = {
        **asdict(options),
        "start": options.start.name if options.start else None,
        "steps_done": steps_done(work),
        "widths": list(WIDTHS),
        "picture_px": SIZE_PX,
        "pictures_per_file": PICTURES_PER_FILE,
        "pictures": "drawn by video/training_pictures.py; no real frame",
        "torch": torch.__version__,
    }
    export(network, calibration, {**facts, "trueroll.recipe": recipe}, out)
    return facts["trueroll.held_out"]
