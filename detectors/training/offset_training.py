"""Training of the offset regressors."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from detectors.training.ball_training import to_network_input
from detectors.training.data.offset_samples import LightAugmentation, OffsetSamples, SampleSource
from detectors.training.data.shard_rotation import ShardRotation
from detectors.training.networks.offset_network import OffsetNetwork, offset_loss
from detectors.training.training_loop import StepCallback, TrainOptions, run_training
from models.core.typing import ByteArray, Float32Array, FloatArray

S = TypeVar("S", bound=Sized)

SHARDS_IN_MEMORY = 40
MIRROR_SHARE = 0.5
"""Share of the samples that each mirror reverses."""
MIN_LEVEL = 1e-3
"""Least level, of 1, before gamma is applied: a power of 0 has no slope."""


def train_offset_network(
    source: SampleSource[S], folder: Path, options: TrainOptions, watch: StepCallback
) -> OffsetNetwork:
    """Train an offset regressor on the samples of a source; a second call continues an interrupted training.

    Args:
        source: Source of the samples.
        folder: Folder of the checkpoint.
        options: Length of the training, batch size and seed.
        watch: Called after each step.

    Returns:
        The network with averaged weights.
    """
    return run_training(OffsetTraining(source, options), folder, options, watch)


@dataclass(slots=True)
class OffsetTraining(Generic[S]):
    """The training task of an offset regressor."""

    source: SampleSource[S]
    options: TrainOptions
    checkpoint: str = field(init=False)
    shards: ShardRotation[S] = field(init=False)

    def __post_init__(self) -> None:
        self.checkpoint = self.source.kind.checkpoint
        self.shards = ShardRotation(self.source.read_shard, self.options.files, SHARDS_IN_MEMORY)

    def create_network(self) -> OffsetNetwork:
        """Create a network to load weights into."""
        return OffsetNetwork(self.source.kind)

    create_initial_network = create_network

    def compute_loss(self, network: OffsetNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Compute the loss of the samples of a step, mirrored at random and in random light."""
        kind, light = self.source.kind, self.source.light
        rng = np.random.default_rng((self.options.seed, step))
        samples = self._draw_batch(rng, step)
        draws = len(samples) if light.per_sample else 1
        crops, offsets = _mirror_samples(rng, samples, self.source, draws)
        return offset_loss(network(_change_light(rng, crops, light, draws)), torch.from_numpy(offsets), kind.outputs)

    def _draw_batch(self, rng: np.random.Generator, step: int) -> OffsetSamples:
        """Draw the samples of a step, uniformly from all rows of the shards in memory."""
        shards = self.shards.shards_at(step)
        ends = np.cumsum([len(shard) for shard in shards])
        chosen = rng.integers(0, ends[-1], self.options.batch)
        which = np.searchsorted(ends, chosen, side="right")
        rows = chosen - np.concatenate([[0], ends])[which]
        return self.source.draw_samples(rng, [(shards[i], int(row)) for i, row in zip(which, rows, strict=True)])


def _mirror_samples(
    rng: np.random.Generator, samples: OffsetSamples, source: SampleSource[S], draws: int
) -> tuple[ByteArray, Float32Array]:
    """Mirror crops and offsets at random, each by its own draw or (`draws` is 1) all by the same."""
    crops, offsets = samples.crops.copy(), samples.offsets.copy()
    for mirror in source.kind.mirrors:
        reversed_rows = np.broadcast_to(rng.random(draws) < MIRROR_SHARE, len(crops))
        crops[reversed_rows] = np.flip(crops[reversed_rows], mirror.axis)
        offsets[reversed_rows] *= np.array(mirror.signs, dtype=np.float32)
    return crops, offsets


def _change_light(rng: np.random.Generator, crops: ByteArray, light: LightAugmentation, draws: int) -> Tensor:
    """Change gamma and gains of crops (B, rows, columns, 3) at random; network input (B, 3, rows, columns)."""
    gamma = _exponential_tensor(rng.normal(0, light.gamma, (draws, 1, 1, 1)))
    log_gain = rng.normal(0, light.gain, (draws, 1, 1, 1)) if light.gain else 0.0
    gain = _exponential_tensor(log_gain + rng.normal(0, light.tint, (draws, 3, 1, 1)))
    return to_network_input(crops).clamp(min=MIN_LEVEL) ** gamma * gain


def _exponential_tensor(logarithms: FloatArray) -> Tensor:
    return torch.from_numpy(np.exp(logarithms).astype(np.float32))
