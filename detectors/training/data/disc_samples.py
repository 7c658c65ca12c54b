"""Training samples of the regressor for balls at rest: crops about rough centres, in many sizes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from detectors.network.ball_crops import DiscCrop
from detectors.network.offset_regressor import DISC, OffsetRegressorKind
from detectors.training.data.distractors import paint_distractors
from detectors.training.data.offset_samples import (
    MIN_RADIUS_PX,
    MIN_VISIBLE_SHARE,
    LightAugmentation,
    OffsetSamples,
    SampleRow,
    stack_samples,
)
from detectors.training.data.training_shards import TrainingShard, prepare_shard_file, read_shard
from models.core.typing import FloatArray, IntArray

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

    def draw_samples(self, rng: np.random.Generator, rows: list[tuple[DiscShard, int]]) -> OffsetSamples:
        """Crop balls about random rough centres."""
        return draw_disc_samples(rng, rows)

    def read_hold_out(self, number: int) -> OffsetSamples:
        """Crop every ball of a hold-out shard once."""
        discs = find_measurable_discs(read_shard(prepare_shard_file(self.folder, number, held_out=True)))
        return draw_disc_samples(np.random.default_rng(number), [(discs, row) for row in range(len(discs))])

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


def draw_disc_samples(rng: np.random.Generator, rows: list[tuple[DiscShard, int]]) -> OffsetSamples:
    """Crop balls, given by their shard and row, each about a random rough centre."""
    return stack_samples(DISC, [_draw_sample(rng, discs, row) for discs, row in rows])


def _draw_sample(rng: np.random.Generator, discs: DiscShard, row: int) -> SampleRow:
    image, ball = discs.rows[row]
    x, y, radius, *_, visible = discs.images.balls[image, ball].astype(np.float64)
    near, angle = rng.random() < NEAR_SHARE, rng.uniform(0, 2 * np.pi)
    error = rng.normal(0, NEAR_RADII, 2) if near else FAR_RADII * np.sqrt(rng.random()) * _unit_vector(angle)
    roll = rng.normal(0, LEVEL_RAD) if rng.random() < LEVEL_SHARE else rng.uniform(0, 2 * np.pi)
    centre = np.array([x, y])
    crop = DiscCrop(centre + radius * error, radius * float(np.exp(rng.normal(0, SIZE_ERROR))), float(roll))
    return crop.sample(discs.images.rgb[image]), crop.offset_to(centre), radius, visible


def _unit_vector(angle: float) -> FloatArray:
    return np.array([np.cos(angle), np.sin(angle)])
