"""Training samples of the offset regressors: crops about rough positions, and the true offsets."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from detectors.network.offset_regressor import OffsetRegressorKind
from models.core.typing import ByteArray, Float32Array, FloatArray

S = TypeVar("S", bound=Sized)

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


@dataclass(frozen=True, slots=True)
class LightAugmentation:
    """Random changes of the light: standard deviations of the logarithms of gamma, gain, and gain of each colour."""

    gamma: float
    gain: float
    tint: float
    per_sample: bool
    """Whether every sample gets its own mirror image and light, or the whole batch the same."""


class SampleSource(Protocol[S]):
    """Source of the samples that one kind of regressor is trained on; a shard S holds the samples of a file."""

    kind: ClassVar[OffsetRegressorKind]
    light: ClassVar[LightAugmentation]

    def read_shard(self, number: int, turn: int) -> S:
        """Read a shard by its number; `turn` counts the shards that were read before it."""
        ...

    def draw_samples(self, rng: np.random.Generator, rows: list[tuple[S, int]]) -> OffsetSamples:
        """Make samples of rows of shards."""
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
