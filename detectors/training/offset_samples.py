"""Training samples of the offset regressors: crops about rough positions of balls at rest and of streaks."""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np

from detectors.network.ball_model import BallModel, open_ball_model, read_model_metadata
from detectors.network.offset_regressor import DISC, MIN_STREAK_RADII, STREAK, DiscCrop, OffsetRegressorKind, StreakCrop
from detectors.network.peak_decoding import CandidateDetections
from detectors.training.augmentation import augment_image, paint_distractors
from detectors.training.training_shards import TrainingShard, prepare_shard_file, read_shard
from models.core.typing import ByteArray, Float32Array, FloatArray, IntArray

# Unoccluded share and radius from which a ball makes a sample.
MIN_VISIBLE_SHARE, MIN_RADIUS_PX = 0.35, 3.3

# Crop, offset, radius px and unoccluded share of one ball.
SampleRow = tuple[ByteArray, FloatArray, float, float]


@dataclass(frozen=True, slots=True)
class OffsetSamples:
    """K crops and their true offsets."""

    crops: ByteArray
    """(K, rows, columns, 3) RGB."""
    offsets: Float32Array
    """(K, n) ball radii, as in `DiscCrop.offset_to` or `StreakCrop.offset_to`."""
    radius: Float32Array
    """(K,) px in the training image."""
    visible: Float32Array
    """(K,) share of the disc that nothing hides."""

    def __len__(self) -> int:
        return len(self.crops)

    def draw_sample(self, rng: np.random.Generator, row: int) -> SampleRow:
        """Return one of the samples."""
        return self.crops[row], self.offsets[row], float(self.radius[row]), float(self.visible[row])


@dataclass(frozen=True, slots=True)
class LightAugmentation:
    """Random changes of the light: standard deviations of the logarithms of gamma, gain, and gain of each colour."""

    gamma: float
    gain: float
    tint: float
    per_sample: bool
    """Whether every sample gets its own mirror image and light, or the whole batch the same."""


class SampleShard(Protocol):
    """Balls of one file of training images."""

    def __len__(self) -> int: ...

    def draw_sample(self, rng: np.random.Generator, row: int) -> SampleRow:
        """Make a sample of a ball."""
        ...


class SampleSource(Protocol):
    """Source of the samples that one kind of regressor is trained on."""

    kind: ClassVar[OffsetRegressorKind]
    light: ClassVar[LightAugmentation]

    def read_shard(self, number: int, turn: int) -> SampleShard:
        """Read a shard by its number; `turn` counts the shards that were read before it."""
        ...

    def read_hold_out(self, number: int) -> OffsetSamples:
        """Read all samples of a hold-out shard."""
        ...

    def describe(self) -> dict[str, object]:
        """Describe the samples for the recipe in the metadata of the exported network."""
        ...


def stack_samples(kind: OffsetRegressorKind, rows: list[SampleRow]) -> OffsetSamples:
    """Stack samples of single balls."""
    crops = np.array([row[0] for row in rows], dtype=np.uint8).reshape(-1, kind.rows, kind.columns, 3)
    offsets, radius, visible = (np.array([row[k] for row in rows], dtype=np.float32) for k in (1, 2, 3))
    return OffsetSamples(crops, offsets.reshape(-1, len(kind.outputs)), radius, visible)


# Displacement during the exposure up to which a ball counts as at rest.
MAX_DISPLACEMENT_RADII = 0.6
# Standard deviation of the logarithm of the crop's scale: errors of the calibration.
SIZE_ERROR = 0.03
# Share of the crops with a small error of the centre, its standard deviation per axis, and the radius of the disc in
# which the other centres are uniformly distributed.
NEAR_SHARE, NEAR_RADII, FAR_RADII = 0.7, 0.1, 0.5
# Share of the crops with a small roll, and its standard deviation; the others have any roll.
LEVEL_SHARE, LEVEL_RAD = 0.8, 0.15
# Share of the images with distractors beneath the balls.
DISTRACTOR_IMAGE_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class DiscShard:
    """The measurable balls at rest of some training images."""

    images: TrainingShard
    rows: IntArray
    """(K, 2) image and ball."""

    def __len__(self) -> int:
        return len(self.rows)

    def draw_sample(self, rng: np.random.Generator, row: int) -> SampleRow:
        """Crop a ball about a random rough centre."""
        image, ball = self.rows[row]
        x, y, radius, *_, visible = self.images.balls[image, ball].astype(np.float64)
        near, angle = rng.random() < NEAR_SHARE, rng.uniform(0, 2 * np.pi)
        if near:
            error = rng.normal(0, NEAR_RADII, 2)
        else:
            error = FAR_RADII * np.sqrt(rng.random()) * np.array([np.cos(angle), np.sin(angle)])
        roll = rng.normal(0, LEVEL_RAD) if rng.random() < LEVEL_SHARE else rng.uniform(0, 2 * np.pi)
        centre = np.array([x, y])
        crop = DiscCrop(centre + radius * error, radius * float(np.exp(rng.normal(0, SIZE_ERROR))), float(roll))
        return crop.sample(self.images.rgb[image]), crop.offset_to(centre), radius, visible


@dataclass(frozen=True, slots=True)
class DiscSource:
    """Draws samples of balls at rest from the training images of a folder."""

    folder: Path
    seed: int
    kind: ClassVar[OffsetRegressorKind] = DISC
    light: ClassVar[LightAugmentation] = LightAugmentation(gamma=0.2, gain=0.1, tint=0.1, per_sample=True)

    def read_shard(self, number: int, turn: int) -> DiscShard:
        """Read training images and paint distractors onto some of them."""
        rng = np.random.default_rng((self.seed, number, turn))
        return find_measurable_discs(add_distractors(rng, read_shard(prepare_shard_file(self.folder, number))))

    def read_hold_out(self, number: int) -> OffsetSamples:
        """Crop every ball of a hold-out shard once."""
        discs = find_measurable_discs(read_shard(prepare_shard_file(self.folder, number, held_out=True)))
        rng = np.random.default_rng(number)
        return stack_samples(DISC, [discs.draw_sample(rng, row) for row in range(len(discs))])

    def describe(self) -> dict[str, object]:
        """Add nothing to the recipe: the samples follow from its seed."""
        return {}


def find_measurable_discs(images: TrainingShard) -> DiscShard:
    """Find the balls at rest that are inside an image, large enough and not hidden."""
    place, radius = images.balls[..., :2], images.balls[..., 2]
    rests = np.linalg.norm(images.balls[..., 3:5], axis=-1) < MAX_DISPLACEMENT_RADII * radius
    measurable = (images.balls[..., 6] > MIN_VISIBLE_SHARE) & (radius > MIN_RADIUS_PX)
    inside = ((place > 0) & (place < images.rgb.shape[1] - 1)).all(axis=-1)
    return DiscShard(images, np.argwhere(rests & measurable & inside))


def add_distractors(rng: np.random.Generator, images: TrainingShard) -> TrainingShard:
    """Paint distractors onto the cloth of some images."""
    rgb = images.rgb.copy()
    for k in np.flatnonzero(rng.random(len(rgb)) < DISTRACTOR_IMAGE_SHARE):
        rgb[k] = paint_distractors(rng, rgb[k], images.balls[k])
    return TrainingShard(rgb, images.balls)


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
