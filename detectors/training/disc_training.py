"""Training the disc network on drawn balls at rest."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from detectors.network.disc_regressor import MIRRORED
from detectors.training.ball_training import as_input
from detectors.training.data.disc_samples import Discs, discs_in, shown_balls, with_litter
from detectors.training.data.shard_rotation import Shelf
from detectors.training.data.training_shards import read_pictures, training_file
from detectors.training.networks.disc_network import TOLD, disc_network
from detectors.training.networks.offset_network import MeasuringNetwork, measuring_loss
from detectors.training.training_loop import TrainOptions, Watch, trained
from models.core.typing import FloatArray

CHECKPOINT = "discs-checkpoint.pt"
FILES_AT_ONCE = 40
"""Picture files held in memory."""
DARKER, LIT, TINTED = 0.2, 0.1, 0.1
"""Standard deviations of the logarithms of gamma, gain, and gain of each colour, by which a ball is lit anew."""


def train_discs(folder: Path, options: TrainOptions, watch: Watch) -> MeasuringNetwork:
    """The trained network; `folder` keeps checkpoints and pictures, and a second call goes on."""
    return trained(MeasuringDiscs(folder, options), folder, options, watch)


@dataclass(slots=True)
class MeasuringDiscs:
    """Where the centre of a ball is that was found."""

    folder: Path
    options: TrainOptions
    checkpoint: str = CHECKPOINT
    shelf: Shelf[Discs] = field(init=False)

    def __post_init__(self) -> None:
        self.shelf = Shelf(self._read, self.options.files, FILES_AT_ONCE)

    def _read(self, number: int, turn: int) -> Discs:
        rng = np.random.default_rng((self.options.seed, number, turn))
        return discs_in(with_litter(rng, read_pictures(training_file(self.folder, number))))

    def empty(self) -> MeasuringNetwork:
        """A network whose weights do not matter yet."""
        return disc_network()

    fresh = empty

    def loss(self, network: MeasuringNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Of the balls of a step, each mirrored or not and in a light of its own."""
        rng = np.random.default_rng((self.options.seed, step))
        held = self.shelf.at(step)
        ends = np.cumsum([len(discs) for discs in held])
        chosen = rng.integers(0, ends[-1], self.options.batch)
        which = np.searchsorted(ends, chosen, side="right")
        rows = chosen - np.concatenate([[0], ends])[which]
        balls = shown_balls(rng, [(held[i], int(row)) for i, row in zip(which, rows, strict=True)])
        flipped = rng.random(len(balls)) < 0.5
        shown, told = balls.shown.copy(), balls.told.copy()
        shown[flipped], told[flipped] = shown[flipped][:, :, ::-1], told[flipped] * MIRRORED.astype(np.float32)
        gamma = _factors(rng.normal(0, DARKER, (len(balls), 1, 1, 1)))
        gain = _factors(rng.normal(0, LIT, (len(balls), 1, 1, 1)) + rng.normal(0, TINTED, (len(balls), 3, 1, 1)))
        lit = as_input(shown).clamp(min=1e-3) ** gamma * gain
        return measuring_loss(network(lit), torch.from_numpy(told), TOLD)


def _factors(logarithms: FloatArray) -> Tensor:
    return torch.from_numpy(np.exp(logarithms).astype(np.float32))
