"""Complete training of each network of the detector: train, calibrate and evaluate on hold-out samples, export."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import cv2
import torch

from detectors.network.offset_regressor import DISC, STREAK
from detectors.training.ball_evaluation import CALIBRATION_FILE, FIGURES_FILE, calibrate_and_evaluate
from detectors.training.ball_training import CHECKPOINT, train_ball_network
from detectors.training.detector_networks import CHANNEL_WIDTHS
from detectors.training.flying_training import CHECKPOINT as FLYING_CHECKPOINT
from detectors.training.offset_samples import SampleSource
from detectors.training.offset_training import (
    evaluate_offset_network,
    fit_sigma_factor,
    train_offset_network,
)
from detectors.training.onnx_export import export_ball_network, export_offset_network
from detectors.training.training_loop import StepCallback, TrainOptions, read_step_count
from detectors.training.training_shards import IMAGES_PER_SHARD
from video.rendering.training_images import SIZE_PX

# Checkpoint file of each network, by the name of its weight file.
CHECKPOINTS = {
    "balls": CHECKPOINT,
    STREAK.name: STREAK.checkpoint,
    DISC.name: DISC.checkpoint,
    "flying": FLYING_CHECKPOINT,
}


def train_ball_detector(work: Path, options: TrainOptions, out: Path, watch: StepCallback) -> dict[str, float]:
    """Train the network that detects balls, and write it as an ONNX file.

    Args:
        work: Folder of training images and checkpoints; a second call continues an interrupted training.
        options: Length of the training, batch size and seed.
        out: ONNX file to write.
        watch: Called after each step.

    Returns:
        Its figures on hold-out images by name.
    """
    _limit_threads(options)
    network = train_ball_network(work, options, watch)
    calibration, figures = calibrate_and_evaluate(network, work)
    recipe = _describe_recipe(options, work / CHECKPOINT) | {"widths": list(CHANNEL_WIDTHS)}
    export_ball_network(network, calibration, figures, recipe, out)
    return figures


def train_offset_regressor(
    source: SampleSource, work: Path, options: TrainOptions, out: Path, watch: StepCallback
) -> dict[str, float]:
    """Train a network that measures motion-blur streaks or balls at rest, and write it as an ONNX file.

    Args:
        source: Source of the samples.
        work: Folder of training images, samples and checkpoints; a second call continues an interrupted training.
        options: Length of the training, batch size and seed.
        out: ONNX file to write.
        watch: Called after each step.

    Returns:
        Its figures on hold-out samples by name.
    """
    _limit_threads(options)
    network = train_offset_network(source, work, options, watch)
    factor = fit_sigma_factor(network, source.read_hold_out(CALIBRATION_FILE))
    figures = evaluate_offset_network(network, factor, source.read_hold_out(FIGURES_FILE))
    recipe = _describe_recipe(options, work / source.kind.checkpoint)
    recipe |= {"widths": list(source.kind.widths), **source.describe()}
    export_offset_network(network, factor, figures, recipe, out)
    return figures


def _limit_threads(options: TrainOptions) -> None:
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)


def _describe_recipe(options: TrainOptions, checkpoint: Path) -> dict[str, object]:
    return {
        **asdict(options),
        "start": options.start.name if options.start else None,
        "steps_done": read_step_count(checkpoint),
        "picture_px": SIZE_PX,
        "pictures_per_file": IMAGES_PER_SHARD,
        "pictures": "rendered by video/rendering/training_images.py; no real frame",
        "torch": torch.__version__,
    }
