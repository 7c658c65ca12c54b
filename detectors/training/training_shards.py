"""Training images on disk in numbered files. File k is the same everywhere, so interrupted runs can continue."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from models.core.typing import ByteArray, Float32Array
from video.rendering.random_scene import MAX_BALLS
from video.rendering.training_images import TrainingImage, generate_training_images

# Images in a file.
IMAGES_PER_SHARD = 240
# Columns of `TrainingShard.balls`; lengths in px.
COLUMNS = ("x", "y", "radius", "streak_x", "streak_y", "look", "visible")
# Offset of the random seeds of hold-out files.
HOLD_OUT_SEED = 7_000_000


@dataclass(frozen=True, slots=True)
class TrainingShard:
    """P training images."""

    rgb: ByteArray
    """(P, S, S, 3)"""
    balls: Float32Array
    """(P, N, 7) columns as in COLUMNS; rows of NaN fill it up."""

    def __len__(self) -> int:
        return len(self.rgb)


def prepare_shard_file(folder: Path, number: int, held_out: bool = False) -> Path:
    """Render the training images of a file, unless it exists.

    Args:
        folder: Folder of the files.
        number: Number of the file, which determines its images.
        held_out: Whether to render hold-out images.

    Returns:
        The file.
    """
    path = folder / f"{'held-out' if held_out else 'pictures'}-{number:05d}.npz"
    if not path.exists():
        rng = np.random.default_rng(number + HOLD_OUT_SEED * held_out)
        shard = stack_training_images(list(generate_training_images(rng, IMAGES_PER_SHARD, held_out)))
        aside = path.with_suffix(f".{os.getpid()}.part")
        with aside.open("wb") as file:
            np.savez(file, rgb=shard.rgb, balls=shard.balls)
        aside.replace(path)
    return path


def read_shard(path: Path) -> TrainingShard:
    """Read a file that `prepare_shard_file` wrote.

    Args:
        path: The file.

    Returns:
        Its images.
    """
    with np.load(path, allow_pickle=False) as arrays:
        return TrainingShard(arrays["rgb"], arrays["balls"])


def stack_training_images(images: list[TrainingImage]) -> TrainingShard:
    """Stack training images."""
    balls = np.full((len(images), MAX_BALLS, len(COLUMNS)), np.nan, np.float32)
    for row, image in zip(balls, images, strict=True):
        row[: len(image.radius)] = np.column_stack(
            [image.centre, image.radius, image.streak, image.appearance_class, image.visible]
        )
    return TrainingShard(np.stack([image.rgb for image in images]), balls)


T = TypeVar("T")

# Steps after which the next file is read.
STEPS_PER_SHARD = 50


@dataclass(slots=True)
class ShardRotation(Generic[T]):
    """The shards from which the samples of a step are drawn; after an interruption they are the same."""

    read: Callable[[int, int], T]
    """Reads a shard, by its number and by the number of shards read before it."""
    files: int
    """Number of files; then they repeat."""
    capacity: int
    """Number of shards in memory."""
    shards: list[T] = field(default_factory=list)

    def shards_at(self, step: int) -> list[T]:
        """Read the shards of a step; calls after the first one must be in the order of the steps."""
        turn = step // STEPS_PER_SHARD
        if not self.shards:
            self._read_turns(range(max(turn - self.capacity + 1, 0), turn + 1))
        elif step % STEPS_PER_SHARD == 0:
            self._read_turns(range(turn, turn + 1))
        return self.shards

    def _read_turns(self, turns: range) -> None:
        self.shards.extend(self.read(turn % self.files, turn) for turn in turns)
        del self.shards[: -self.capacity]
