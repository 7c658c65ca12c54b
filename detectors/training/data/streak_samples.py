"""Training samples of the regressor for streaks: streaks that the ball network detects in training images."""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import ClassVar

import numpy as np

from detectors.network.ball_crops import StreakCrop
from detectors.network.ball_model import BallModel, open_ball_model, read_model_metadata
from detectors.network.offset_regressor import MIN_STREAK_RADII, STREAK, OffsetRegressorKind
from detectors.network.peak_decoding import CandidateDetections
from detectors.training.data.augmentation import augment_image
from detectors.training.data.offset_samples import (
    MIN_RADIUS_PX,
    MIN_VISIBLE_SHARE,
    LightAugmentation,
    OffsetSamples,
    SampleRow,
    stack_samples,
)
from detectors.training.data.training_shards import prepare_shard_file, read_shard
from models.core.typing import ByteArray, FloatArray

# Augmented forms of each training image that the ball network processes.
FORMS = 6
# Confidence score from which a detected streak counts: see `FAINT_SCORE` in `network/candidate_rules.py`.
MIN_STREAK_SCORE = 0.12
# Detected over true radius; a detection outside is another object.
SIZE_LIMITS = (0.6, 1.6)
# Errors added to those of the ball network: standard deviations of the logarithm of the radius, of the centre per axis
# in ball radii, and of the relative length and the direction of the displacement.
RADIUS_ERROR, CENTRE_RADII, DISPLACEMENT_ERROR = 0.03, 0.05, 0.05
# Arrays of a shard file and the fields of `OffsetSamples` that they hold.
FILE_ARRAYS = {"shown": "crops", "told": "offsets", "radius": "radius", "visible": "visible"}


@dataclass(frozen=True, slots=True)
class StreakSource:
    """Takes samples of streaks from what a ball network detects in the training images of a folder."""

    folder: Path
    ball_network: Path
    kind: ClassVar[OffsetRegressorKind] = STREAK
    light: ClassVar[LightAugmentation] = LightAugmentation(gamma=0.2, gain=0.0, tint=0.1, per_sample=False)

    def read_shard(self, number: int, turn: int) -> OffsetSamples:
        """Read the streaks of a file of training images."""
        return read_streak_shard(prepare_streak_shard(self.folder, number, self.ball_network))

    def draw_samples(self, rng: np.random.Generator, rows: list[tuple[OffsetSamples, int]]) -> OffsetSamples:
        """Select rows of shards."""
        columns = (np.stack([getattr(shard, name)[row] for shard, row in rows]) for name in FILE_ARRAYS.values())
        return OffsetSamples(*columns)

    def read_hold_out(self, number: int) -> OffsetSamples:
        """Read the streaks of a hold-out shard."""
        return read_streak_shard(prepare_streak_shard(self.folder, number, self.ball_network, held_out=True))

    def describe(self) -> dict[str, object]:
        """Name the number of forms and the ball network."""
        network = read_model_metadata(self.ball_network).get("trueroll.recipe", self.ball_network.name)
        return {"forms": FORMS, "seen_by": network}


def prepare_streak_shard(folder: Path, number: int, ball_network: Path, held_out: bool = False) -> Path:
    """Write a file of the streaks that a ball network detects in a file of training images, unless it exists.

    Args:
        folder: Folder of the training images.
        number: Number of the file of training images.
        ball_network: ONNX file of the ball network; a hash of it is part of the file name.
        held_out: Whether to use the hold-out images.

    Returns:
        The file.
    """
    mark = sha256(ball_network.read_bytes()).hexdigest()[:8]
    path = folder / f"{'held-out-' if held_out else ''}streaks-{mark}-{number:05d}.npz"
    if not path.exists():
        images, forms = prepare_shard_file(folder, number, held_out), 1 if held_out else FORMS
        samples = _detect_streak_samples(images, open_ball_model(ball_network), forms, number)
        aside = path.with_suffix(f".{os.getpid()}.part")
        with aside.open("wb") as file:
            np.savez(file, **{key: getattr(samples, name) for key, name in FILE_ARRAYS.items()})
        aside.replace(path)
    return path


def read_streak_shard(path: Path) -> OffsetSamples:
    """Read a file that `prepare_streak_shard` wrote."""
    with np.load(path, allow_pickle=False) as arrays:
        return OffsetSamples(**{name: arrays[key] for key, name in FILE_ARRAYS.items()})


def _detect_streak_samples(file: Path, model: BallModel, forms: int, seed: int) -> OffsetSamples:
    """Collect the streaks that a network detects in the images of a file; the first form is the image itself."""
    images, rng = read_shard(file), np.random.default_rng(seed)
    rows: list[SampleRow] = []
    for rgb, balls in zip(images.rgb, images.balls, strict=True):
        if forms > 1 and not (np.linalg.norm(balls[:, 3:5], axis=1) > balls[:, 2]).any():
            continue
        for form in range(forms):
            augmented, truth = augment_image(rng, rgb, balls) if form else (rgb, balls)
            rows += _match_streaks(rng, augmented, truth[~np.isnan(truth[:, 0])].astype(np.float64), model)
    return stack_samples(STREAK, rows)


def _match_streaks(rng: np.random.Generator, rgb: ByteArray, balls: FloatArray, model: BallModel) -> list[SampleRow]:
    """Make samples of the detected streaks that match a true ball (N, 7)."""
    median_radius = float(np.median(balls[:, 2])) if len(balls) else 1.0
    candidates = model.find_candidates(np.ascontiguousarray(rgb), median_radius)
    rows: list[SampleRow] = []
    for k, ball in _match_candidates(candidates, balls).items():
        _, _, radius, *true_displacement, _, visible = balls[ball]
        displacement = candidates.streak[k]
        if not MIN_STREAK_RADII * candidates.radius[k] < np.linalg.norm(displacement):
            continue
        if visible < MIN_VISIBLE_SHARE or radius < MIN_RADIUS_PX:
            continue
        if not SIZE_LIMITS[0] < candidates.radius[k] / radius < SIZE_LIMITS[1]:
            continue
        size = float(radius * np.exp(rng.normal(0, RADIUS_ERROR)))
        aside = np.array([-displacement[1], displacement[0]]) * rng.normal(0, DISPLACEMENT_ERROR)
        rough = displacement * np.exp(rng.normal(0, DISPLACEMENT_ERROR)) + aside
        crop = StreakCrop(candidates.centre[k] + rng.normal(0, CENTRE_RADII * size, 2), size, rough)
        offset = crop.offset_to(balls[ball, :2], np.array(true_displacement))
        rows.append((crop.sample(rgb), offset, size, float(visible)))
    return rows


def _match_candidates(candidates: CandidateDetections, balls: FloatArray) -> dict[int, int]:
    """Assign candidates to balls (N, 7), nearest first, each at most once."""
    is_likely = candidates.score > MIN_STREAK_SCORE
    distance = np.linalg.norm(candidates.centre[:, None] - balls[None, :, :2], axis=-1)
    reach = np.maximum(0.7 * balls[:, 2], 2.0) + 0.5 * np.linalg.norm(balls[:, 3:5], axis=1)
    pairs = np.argwhere((distance < reach) & is_likely[:, None])
    ball_of: dict[int, int] = {}
    for k, ball in pairs[np.argsort(distance[pairs[:, 0], pairs[:, 1]], kind="stable")].tolist():
        if k not in ball_of and ball not in ball_of.values():
            ball_of[k] = ball
    return ball_of
