"""Training the streak network on what the ball network sees of drawn pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from detectors.network.streak_regressor import MIRRORED
from detectors.training.ball_training import as_input
from detectors.training.data.shard_rotation import Shelf
from detectors.training.data.streak_samples import StreakPictures, read_streaks, streak_file
from detectors.training.networks.offset_network import MeasuringNetwork, measuring_loss
from detectors.training.networks.streak_network import TOLD, streak_network
from detectors.training.training_loop import TrainOptions, Watch, trained
from models.core.typing import ByteArray, Float32Array

CHECKPOINT = "streaks-checkpoint.pt"
FILES_AT_ONCE = 40
"""Files of streaks held in memory."""
DARKER, TINTED = 0.2, 0.1
"""Standard deviations of the logarithms of gamma and of the gain of each colour, by which a batch is lit anew."""


def train_streaks(folder: Path, seer: Path, options: TrainOptions, watch: Watch) -> MeasuringNetwork:
    """The trained network for what the ball network in the file `seer` sees; a second call goes on."""
    return trained(MeasuringStreaks(folder, seer, options), folder, options, watch)


@dataclass(slots=True)
class MeasuringStreaks:
    """Where a streak is that the ball network saw."""

    folder: Path
    seer: Path
    options: TrainOptions
    checkpoint: str = CHECKPOINT
    shelf: Shelf[StreakPictures] = field(init=False)

    def __post_init__(self) -> None:
        self.shelf = Shelf(self._read, self.options.files, FILES_AT_ONCE)

    def _read(self, number: int, turn: int) -> StreakPictures:
        return read_streaks(streak_file(self.folder, number, self.seer))

    def empty(self) -> MeasuringNetwork:
        """A network whose weights do not matter yet."""
        return streak_network()

    fresh = empty

    def loss(self, network: MeasuringNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Of the streaks of a step, all mirrored in one way and in one light."""
        shown, told, rng = self._batch(step)
        for axis, signs in ((2, MIRRORED[1]), (1, MIRRORED[2])):
            if rng.random() < 0.5:
                shown, told = np.flip(shown, axis), told * signs.astype(np.float32)
        light = as_input(np.ascontiguousarray(shown)).clamp(min=1e-3) ** float(np.exp(rng.normal(0, DARKER)))
        gain = torch.from_numpy(np.exp(rng.normal(0, TINTED, (1, 3, 1, 1))).astype(np.float32))
        return measuring_loss(network(light * gain), torch.from_numpy(told), TOLD)

    def _batch(self, step: int) -> tuple[ByteArray, Float32Array, np.random.Generator]:
        """Straightened pictures (B, ROWS, COLUMNS, 3), what is true of them (B, 4), and what draws go on with."""
        rng = np.random.default_rng((self.options.seed, step))
        held = self.shelf.at(step)
        ends = np.cumsum([len(streaks) for streaks in held])
        chosen = rng.integers(0, ends[-1], self.options.batch)
        which = np.searchsorted(ends, chosen, side="right")
        rows = chosen - np.concatenate([[0], ends])[which]
        shown = np.stack([held[i].shown[row] for i, row in zip(which, rows, strict=True)])
        return shown, np.stack([held[i].told[row] for i, row in zip(which, rows, strict=True)]), rng
