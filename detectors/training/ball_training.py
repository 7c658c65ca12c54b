"""Training of the ball network on rendered images."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from detectors.training.data.augmentation import augment_image
from detectors.training.data.shard_rotation import ShardRotation
from detectors.training.data.training_shards import TrainingShard, prepare_shard_file, read_shard
from detectors.training.networks.ball_loss import build_targets, compute_ball_loss
from detectors.training.networks.ball_network import BallNetwork
from detectors.training.networks.warm_start import load_exported_weights
from detectors.training.training_loop import StepCallback, TrainOptions, run_training
from models.core.typing import ByteArray, Float32Array

CHECKPOINT = "checkpoint.pt"
SHARDS_IN_MEMORY = 20
"""Files of training images in memory."""
STATISTICS_IMAGES = 64
"""Images for the initial statistics of the normalisations of a network from a file."""


def train_ball_network(folder: Path, options: TrainOptions, watch: StepCallback) -> BallNetwork:
    """Train the ball network; a second call continues an interrupted training.

    Args:
        folder: Folder of checkpoints and training images.
        options: Length of the training, batch size and seed.
        watch: Called after each step.

    Returns:
        The network with averaged weights.
    """
    return run_training(BallTraining(folder, options), folder, options, watch)


@dataclass(slots=True)
class BallTraining:
    """The training task of the ball network."""

    folder: Path
    options: TrainOptions
    checkpoint: str = CHECKPOINT
    shards: ShardRotation[TrainingShard] = field(init=False)

    def __post_init__(self) -> None:
        self.shards = ShardRotation(self._read_shard, self.options.files, SHARDS_IN_MEMORY)

    def _read_shard(self, number: int, turn: int) -> TrainingShard:
        return read_shard(prepare_shard_file(self.folder, number))

    def create_network(self) -> BallNetwork:
        """Create a network to load weights into."""
        return BallNetwork()

    def create_initial_network(self) -> BallNetwork:
        """Create the network that training begins with."""
        network = BallNetwork()
        if self.options.start is not None:
            first = read_shard(prepare_shard_file(self.folder, 0)).rgb[:STATISTICS_IMAGES]
            load_exported_weights(network, self.options.start, to_network_input(first))
        return network

    def compute_loss(self, network: BallNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Compute the loss of the images of a step."""
        rgb, balls = self._draw_batch(step)
        return compute_ball_loss(network(to_network_input(rgb)), build_targets(torch.from_numpy(balls), rgb.shape[1]))

    def _draw_batch(self, step: int) -> tuple[ByteArray, Float32Array]:
        """Draw augmented images (B, S, S, 3) and their balls (B, N, 7)."""
        rng = np.random.default_rng((self.options.seed, step))
        shards = self.shards.shards_at(step)
        chosen = [shards[i] for i in rng.integers(0, len(shards), self.options.batch)]
        rows = [int(rng.integers(len(shard))) for shard in chosen]
        varied = [augment_image(rng, p.rgb[row], p.balls[row]) for p, row in zip(chosen, rows, strict=True)]
        return np.stack([rgb for rgb, _ in varied]), np.stack([balls for _, balls in varied])


def to_network_input(rgb: ByteArray) -> Tensor:
    """Convert images (B, H, W, 3) of bytes to the input (B, 3, H, W) of a network, in [0, 1]."""
    return torch.from_numpy(rgb).permute(0, 3, 1, 2).float() / 255  # memory layout unchanged: channels last
