"""Training the streak network on what the ball network sees of drawn pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.centres import SIGMA_LIMITS
from detectors.streak_model import MIRRORED
from detectors.streak_network import TOLD, StreakNetwork
from detectors.streak_pictures import StreakPictures, read_streaks, streak_file
from detectors.training import as_input
from detectors.training_loop import TrainOptions, Watch, trained
from detectors.training_loss import HUBER

Bytes = NDArray[np.uint8]
Floats32 = NDArray[np.float32]

CHECKPOINT = "streaks-checkpoint.pt"
FILES_AT_ONCE = 40
"""Files of streaks held in memory; one is exchanged for another every so many steps."""
STEPS_PER_FILE = 50
DARKER, TINTED = 0.2, 0.1
"""Standard deviations of the logarithms of gamma and of the gain of each colour, by which a batch is lit anew."""


def train_streaks(folder: Path, seer: Path, options: TrainOptions, watch: Watch) -> StreakNetwork:
    """The trained network for what the ball network in the file `seer` sees; a second call goes on."""
    return trained(MeasuringStreaks(folder, seer, options), folder, options, watch)


@dataclass(slots=True)
class MeasuringStreaks:
    """Where a streak is that the ball network saw."""

    folder: Path
    seer: Path
    options: TrainOptions
    shelf: list[StreakPictures] = field(default_factory=list)
    """Files of streaks at hand."""
    checkpoint: str = CHECKPOINT

    def empty(self) -> StreakNetwork:
        """A network whose weights do not matter yet."""
        return StreakNetwork()

    fresh = empty

    def loss(self, network: StreakNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Of the streaks of a step, all mirrored in one way and in one light."""
        shown, told, rng = self._batch(step)
        for axis, signs in ((2, MIRRORED[1]), (1, MIRRORED[2])):
            if rng.random() < 0.5:
                shown, told = np.flip(shown, axis), told * signs.astype(np.float32)
        light = as_input(np.ascontiguousarray(shown)).clamp(min=1e-3) ** float(np.exp(rng.normal(0, DARKER)))
        gain = torch.from_numpy(np.exp(rng.normal(0, TINTED, (1, 3, 1, 1))).astype(np.float32))
        return streak_loss(network(light * gain), torch.from_numpy(told))

    def _batch(self, step: int) -> tuple[Bytes, Floats32, np.random.Generator]:
        """Straightened pictures (B, ROWS, COLUMNS, 3), what is true of them (B, 4), and what draws go on with."""
        rng = np.random.default_rng((self.options.seed, step))
        if not self.shelf or step % STEPS_PER_FILE == 0:
            # As with the pictures of balls: after an interruption the shelf holds what was on it.
            turn = step // STEPS_PER_FILE
            numbers = range(max(turn - FILES_AT_ONCE + 1, 0), turn + 1) if not self.shelf else [turn]
            files = [streak_file(self.folder, number % self.options.files, self.seer) for number in numbers]
            self.shelf.extend(read_streaks(path) for path in files)
            del self.shelf[:-FILES_AT_ONCE]
        ends = np.cumsum([len(held) for held in self.shelf])
        chosen = rng.integers(0, ends[-1], self.options.batch)
        which = np.searchsorted(ends, chosen, side="right")
        rows = chosen - np.concatenate([[0], ends])[which]
        shown = np.stack([self.shelf[i].shown[row] for i, row in zip(which, rows, strict=True)])
        return shown, np.stack([self.shelf[i].told[row] for i, row in zip(which, rows, strict=True)]), rng


def streak_loss(said: Tensor, told: Tensor) -> tuple[Tensor, dict[str, float]]:
    """Negative log likelihood, with Huber's tails, of what is true (B, 4) by what a network said (B, 8)."""
    width = said[:, len(TOLD) :].clamp(*SIGMA_LIMITS)
    pull = ((told - said[:, : len(TOLD)]) * torch.exp(-width)).abs()
    missed = torch.where(pull < HUBER, 0.5 * pull**2, HUBER * pull - 0.5 * HUBER**2)
    each = (missed + width).mean(dim=0)
    return each.sum(), dict(zip(TOLD, each.tolist(), strict=True))
