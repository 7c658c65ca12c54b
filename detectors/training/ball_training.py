"""Training the ball network on drawn pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from detectors.training.data.augmentation import vary
from detectors.training.data.shard_rotation import Shelf
from detectors.training.data.training_shards import Pictures, read_pictures, training_file
from detectors.training.networks.ball_network import BallNetwork
from detectors.training.networks.training_loss import loss_of, targets_of
from detectors.training.networks.warm_start import start_from
from detectors.training.training_loop import TrainOptions, Watch, trained
from models.core.typing import ByteArray, Float32Array

CHECKPOINT = "checkpoint.pt"
FILES_AT_ONCE = 20
"""Picture files held in memory."""
FIRST_SEEN = 64
"""Pictures whose statistics the normalisations of a network from a file begin with."""


def train(folder: Path, options: TrainOptions, watch: Watch) -> BallNetwork:
    """The trained network; `folder` keeps checkpoints and pictures, and a second call goes on where the first ended."""
    return trained(FindingBalls(folder, options), folder, options, watch)


@dataclass(slots=True)
class FindingBalls:
    """Where balls are in a picture."""

    folder: Path
    options: TrainOptions
    checkpoint: str = CHECKPOINT
    shelf: Shelf[Pictures] = field(init=False)

    def __post_init__(self) -> None:
        self.shelf = Shelf(self._read, self.options.files, FILES_AT_ONCE)

    def _read(self, number: int, turn: int) -> Pictures:
        return read_pictures(training_file(self.folder, number))

    def empty(self) -> BallNetwork:
        """A network whose weights do not matter yet."""
        return BallNetwork()

    def fresh(self) -> BallNetwork:
        """The network that training begins with."""
        network = BallNetwork()
        if self.options.start is not None:
            first = read_pictures(training_file(self.folder, 0)).rgb[:FIRST_SEEN]
            start_from(network, self.options.start, as_input(first))
        return network

    def loss(self, network: BallNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Of the pictures of a step."""
        rgb, balls = self._batch(step)
        return loss_of(network(as_input(rgb)), targets_of(torch.from_numpy(balls), rgb.shape[1]))

    def _batch(self, step: int) -> tuple[ByteArray, Float32Array]:
        """Pictures (B, S, S, 3) and balls (B, N, 7)."""
        rng = np.random.default_rng((self.options.seed, step))
        held = self.shelf.at(step)
        chosen = [held[i] for i in rng.integers(0, len(held), self.options.batch)]
        rows = [int(rng.integers(len(pictures))) for pictures in chosen]
        varied = [vary(rng, p.rgb[row], p.balls[row]) for p, row in zip(chosen, rows, strict=True)]
        return np.stack([rgb for rgb, _ in varied]), np.stack([balls for _, balls in varied])


def as_input(rgb: ByteArray) -> Tensor:
    """Pictures (B, H, W, 3) of bytes to the network's (B, 3, H, W)."""
    return torch.from_numpy(rgb).permute(0, 3, 1, 2).float() / 255  # stays laid out as it came: channels side by side
