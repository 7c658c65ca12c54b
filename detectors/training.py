"""Training the ball network on drawn pictures; an interrupted training goes on from its last checkpoint."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.network import BallNetwork
from detectors.training_data import Pictures, read_pictures, training_file
from detectors.training_loss import loss_of, targets_of
from detectors.training_variety import vary
from detectors.warm_start import start_from

Bytes = NDArray[np.uint8]
Floats32 = NDArray[np.float32]

CHECKPOINT = "checkpoint.pt"
RATE, DECAY = 3e-3, 1e-4
"""Highest learning rate and weight decay of AdamW (Loshchilov and Hutter 2019, arXiv:1711.05101)."""
WARM_SHARE = 0.04
"""Share of the steps in which the learning rate rises; then it falls along a half cosine."""
AVERAGED = 0.998
"""Share of the averaged weights that a step keeps: the averaged ones are exported (Polyak and Juditsky 1992,
doi:10.1137/0330046)."""
FILES_AT_ONCE = 20
"""Picture files held in memory; one is exchanged for another every so many steps."""
STEPS_PER_FILE = 50
FIRST_SEEN = 64
"""Pictures whose statistics the normalisations of a network from a file begin with."""
CHECKPOINT_S = 60.0


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """How long and on how much the detector is trained."""

    steps: int = 12000
    """Steps in all."""
    hours: float = 3.0
    """Time after which it ends all the same, interruptions not counted: the learning rate falls in time for it."""
    batch: int = 16
    """Pictures per step."""
    files: int = 100
    """Files of 240 training pictures each, made before they are needed."""
    threads: int = 2
    """Of the processor."""
    seed: int = 0
    """Of the network's first weights and the order of the pictures."""
    start: Path | None = None
    """ONNX file of a network to go on from; without it, from nothing."""


@dataclass(slots=True)
class Training:
    """The state of a training."""

    network: BallNetwork
    average: BallNetwork
    optimiser: torch.optim.AdamW
    step: int
    seconds: float
    """Spent so far."""

    def done(self, options: TrainOptions) -> float:
        """How far the training is, from 0 to 1."""
        return min(max(self.step / options.steps, self.seconds / (3600 * options.hours)), 1.0)


Watch = Callable[[int, float, dict[str, float]], None]
"""Told the step, how far the training is (0 to 1) and the parts of the step's loss."""


def train(folder: Path, options: TrainOptions, watch: Watch) -> BallNetwork:
    """The trained network; `folder` keeps checkpoints and pictures, and a second call goes on where the first ended."""
    folder.mkdir(parents=True, exist_ok=True)
    state = _resumed(folder, options)
    try:
        _continue(state, folder, options, watch)
    finally:
        _save(folder, state)
    return state.average.eval()


def _continue(state: Training, folder: Path, options: TrainOptions, watch: Watch) -> None:
    last = saved = time.monotonic()
    for rgb, balls in _batches(folder, options, state):
        parts = _step(state, options, rgb, balls)
        now = time.monotonic()
        state.seconds, last = state.seconds + now - last, now
        watch(state.step, state.done(options), parts)
        if now - saved > CHECKPOINT_S:
            _save(folder, state)
            saved = now


def _fresh(folder: Path, options: TrainOptions) -> Training:
    torch.manual_seed(options.seed)
    network, average = _laid_out(BallNetwork()), _laid_out(BallNetwork())
    if options.start is not None:
        start_from(network, options.start, as_input(read_pictures(training_file(folder, 0)).rgb[:FIRST_SEEN]))
    average.load_state_dict(network.state_dict())
    return Training(network, average, torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY), 0, 0.0)


def _laid_out(network: BallNetwork) -> BallNetwork:
    """A network whose arrays hold the channels of a place side by side: a step takes two thirds of the time."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def _resumed(folder: Path, options: TrainOptions) -> Training:
    path = folder / CHECKPOINT
    state = _fresh(folder, replace(options, start=None) if path.exists() else options)
    if path.exists():
        saved = torch.load(path, weights_only=True)
        state.network.load_state_dict(saved["network"])
        state.average.load_state_dict(saved["average"])
        state.optimiser.load_state_dict(saved["optimiser"])
        state.step, state.seconds = saved["step"], saved["seconds"]
    return state


def steps_done(folder: Path) -> int:
    """Steps of the last checkpoint."""
    return int(torch.load(folder / CHECKPOINT, weights_only=True)["step"])


def _save(folder: Path, state: Training) -> None:
    aside = folder / (CHECKPOINT + ".part")
    torch.save(
        {
            "network": state.network.state_dict(),
            "average": state.average.state_dict(),
            "optimiser": state.optimiser.state_dict(),
            "step": state.step,
            "seconds": state.seconds,
        },
        aside,
    )
    aside.replace(folder / CHECKPOINT)


def _batches(folder: Path, options: TrainOptions, state: Training) -> Iterator[tuple[Bytes, Floats32]]:
    """Batches of pictures (B, S, S, 3) and balls (B, N, 7) for the steps that are left."""
    held: list[Pictures] = []
    while state.done(options) < 1:
        rng = np.random.default_rng((options.seed, state.step))
        if not held or state.step % STEPS_PER_FILE == 0:
            # After an interruption the shelf is filled with the files that were on it.
            turn = state.step // STEPS_PER_FILE
            numbers = range(max(turn - FILES_AT_ONCE + 1, 0), turn + 1) if not held else [turn]
            held.extend(read_pictures(training_file(folder, number % options.files)) for number in numbers)
            del held[:-FILES_AT_ONCE]
        chosen = [held[i] for i in rng.integers(0, len(held), options.batch)]
        rows = [int(rng.integers(len(pictures))) for pictures in chosen]
        varied = [vary(rng, p.rgb[row], p.balls[row]) for p, row in zip(chosen, rows, strict=True)]
        yield np.stack([rgb for rgb, _ in varied]), np.stack([balls for _, balls in varied])


def as_input(rgb: Bytes) -> Tensor:
    """Pictures (B, H, W, 3) of bytes to the network's (B, 3, H, W)."""
    return torch.from_numpy(rgb).permute(0, 3, 1, 2).float() / 255  # stays laid out as it came: channels side by side


def _step(state: Training, options: TrainOptions, rgb: Bytes, balls: Floats32) -> dict[str, float]:
    done = state.done(options)
    warm = min(done / WARM_SHARE, 1.0)
    for group in state.optimiser.param_groups:
        group["lr"] = RATE * warm * (0.5 + 0.5 * float(np.cos(np.pi * done))) + 1e-6
    state.network.train()
    loss, parts = loss_of(state.network(as_input(rgb)), targets_of(torch.from_numpy(balls), rgb.shape[1]))
    state.optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(state.network.parameters(), 5.0)
    state.optimiser.step()
    state.step += 1
    _follow(state)
    return parts


@torch.no_grad()
def _follow(state: Training) -> None:
    """Move the averaged weights; early on they follow faster."""
    keep = min(AVERAGED, 1 - 1 / (1 + state.step / 10))
    for mean, value in zip(state.average.state_dict().values(), state.network.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(value, 1 - keep)
        else:
            mean.copy_(value)
