"""From nothing to a network in a file: train, check on held-out halls, calibrate, export."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import torch

from detectors.network.network_file import model_facts
from detectors.training.ball_export import export
from detectors.training.ball_training import CHECKPOINT, train
from detectors.training.data.disc_samples import DiscPictures, discs_in, shown_balls
from detectors.training.data.streak_samples import FORMS, read_streaks, streak_file
from detectors.training.data.training_shards import PICTURES_PER_FILE, read_pictures, training_file
from detectors.training.disc_export import disc_figures, export_discs
from detectors.training.disc_training import CHECKPOINT as DISC_CHECKPOINT
from detectors.training.disc_training import train_discs
from detectors.training.evaluation import CALIBRATION_FILE, FIGURES_FILE, as_facts, checked
from detectors.training.networks.ball_network import WIDTHS
from detectors.training.networks.disc_network import WIDTHS as DISC_WIDTHS
from detectors.training.networks.streak_network import WIDTHS as STREAK_WIDTHS
from detectors.training.offset_export import sigma_factor
from detectors.training.streak_export import export_streaks, streak_figures
from detectors.training.streak_training import CHECKPOINT as STREAK_CHECKPOINT
from detectors.training.streak_training import train_streaks
from detectors.training.training_loop import TrainOptions, Watch, steps_done
from video.rendering.training_images import SIZE_PX

CHECKPOINTS = {"balls": CHECKPOINT, "streaks": STREAK_CHECKPOINT, "discs": DISC_CHECKPOINT}
"""What keeps the training of each network, by what it sees."""


def make_detector(work: Path, options: TrainOptions, out: Path, watch: Watch) -> dict[str, float]:
    """Train in a folder, write the ONNX file, return its figures on held-out halls."""
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    network = train(work, options, watch)
    calibration, figures = checked(network, work)
    facts = as_facts(calibration, figures)
    recipe = _recipe(options, work / CHECKPOINT) | {"widths": list(WIDTHS)}
    export(network, calibration, {**facts, "trueroll.recipe": recipe}, out)
    return facts["trueroll.held_out"]


def make_streaks(work: Path, seer: Path, options: TrainOptions, out: Path, watch: Watch) -> dict[str, float]:
    """The same for the network that measures the streaks which the ball network in the file `seer` sees."""
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    network = train_streaks(work, seer, options, watch)
    known, unknown = (
        read_streaks(streak_file(work, number, seer, held_out=True)) for number in (CALIBRATION_FILE, FIGURES_FILE)
    )
    factor = sigma_factor(network, known.shown, known.told)
    figures = streak_figures(network, factor, unknown)
    made = {
        "widths": list(STREAK_WIDTHS),
        "forms": FORMS,
        "seen_by": model_facts(seer).get("trueroll.recipe", seer.name),
    }
    return export_streaks(network, factor, figures, _recipe(options, work / STREAK_CHECKPOINT) | made, out)


def make_discs(work: Path, options: TrainOptions, out: Path, watch: Watch) -> dict[str, float]:
    """The same for the network that measures balls at rest."""
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    network = train_discs(work, options, watch)
    known, unknown = (_held_out_discs(work, number) for number in (CALIBRATION_FILE, FIGURES_FILE))
    factor = sigma_factor(network, known.shown, known.told)
    figures = disc_figures(network, factor, unknown)
    recipe = _recipe(options, work / DISC_CHECKPOINT) | {"widths": list(DISC_WIDTHS)}
    return export_discs(network, factor, figures, recipe, out)


def _held_out_discs(work: Path, number: int) -> DiscPictures:
    discs = discs_in(read_pictures(training_file(work, number, held_out=True)))
    return shown_balls(np.random.default_rng(number), [(discs, row) for row in range(len(discs))])


def _recipe(options: TrainOptions, checkpoint: Path) -> dict[str, object]:
    return {
        **asdict(options),
        "start": options.start.name if options.start else None,
        "steps_done": steps_done(checkpoint),
        "picture_px": SIZE_PX,
        "pictures_per_file": PICTURES_PER_FILE,
        "pictures": "drawn by video/rendering/training_images.py; no real frame",
        "torch": torch.__version__,
    }
