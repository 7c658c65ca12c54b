"""Training loop that can be interrupted: steps, schedule of the learning rate, averaged weights, checkpoints."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

N = TypeVar("N", bound=nn.Module)

# Highest learning rate and weight decay of AdamW (Loshchilov and Hutter 2019, arXiv:1711.05101).
MAX_LEARNING_RATE, WEIGHT_DECAY = 3e-3, 1e-4
# Share of the steps in which the learning rate rises; then it falls along a half cosine.
WARM_UP_SHARE = 0.04
# Share of the averaged weights that remains after a step: the averaged ones are exported (Polyak and Juditsky 1992,
# doi:10.1137/0330046).
AVERAGE_DECAY = 0.998
# Seconds between checkpoints.
CHECKPOINT_INTERVAL_S = 60.0


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """Length of a training, amount of data, and seed."""

    steps: int = 12000
    """Total number of steps."""
    hours: float = 3.0
    """Hours after which the training ends in any case, interruptions not counted; the learning rate falls
    accordingly."""
    batch: int = 16
    """Samples per step."""
    files: int = 100
    """Files of 240 training images each, rendered before they are needed."""
    threads: int = 2
    """Threads of the processor."""
    seed: int = 0
    """Random seed of the network's initial weights and of the samples."""
    start: Path | None = None
    """ONNX file of a network to continue from; None for random initial weights."""


# Called with the step, the progress of the training (0 to 1) and the parts of the step's loss.
StepCallback = Callable[[int, float, dict[str, float]], None]


class TrainingTask(Protocol[N]):
    """A network, its loss and its data."""

    checkpoint: str
    """File name of the checkpoint."""

    def create_network(self) -> N:
        """Create a network to load weights into."""
        ...

    def create_initial_network(self) -> N:
        """Create the network that training begins with."""
        ...

    def compute_loss(self, network: N, step: int) -> tuple[Tensor, dict[str, float]]:
        """Compute the loss of the samples of a step, which depend on the step alone, and its parts."""
        ...


@dataclass(slots=True)
class TrainingState(Generic[N]):
    """The state of a training."""

    network: N
    average: N
    optimiser: torch.optim.AdamW
    step: int
    seconds: float
    """Training time so far."""

    def progress(self, options: TrainOptions) -> float:
        """How far the training is, from 0 to 1."""
        return min(max(self.step / options.steps, self.seconds / (3600 * options.hours)), 1.0)


def run_training(task: TrainingTask[N], folder: Path, options: TrainOptions, watch: StepCallback) -> N:
    """Run a training; a second call continues an interrupted one.

    Args:
        task: The network and its loss.
        folder: Folder of the checkpoint; created if missing.
        options: Length of the training and seed.
        watch: Called after each step.

    Returns:
        The network with averaged weights, in evaluation mode.
    """
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / task.checkpoint
    state = _load_state(task, checkpoint, options)
    try:
        _train_until_done(state, task, checkpoint, options, watch)
    finally:
        _save_state(checkpoint, state)
    return state.average.eval()


def read_step_count(checkpoint: Path) -> int:
    """Read the number of steps of a checkpoint.

    Args:
        checkpoint: The file.

    Returns:
        The number of steps.
    """
    return int(torch.load(checkpoint, weights_only=True)["step"])


def _train_until_done(
    state: TrainingState[N], task: TrainingTask[N], checkpoint: Path, options: TrainOptions, watch: StepCallback
) -> None:
    last = saved = time.monotonic()
    while state.progress(options) < 1:
        parts = _train_step(state, task, options)
        now = time.monotonic()
        state.seconds, last = state.seconds + now - last, now
        watch(state.step, state.progress(options), parts)
        if now - saved > CHECKPOINT_INTERVAL_S:
            _save_state(checkpoint, state)
            saved = now


def _load_state(task: TrainingTask[N], checkpoint: Path, options: TrainOptions) -> TrainingState[N]:
    torch.manual_seed(options.seed)
    saved = torch.load(checkpoint, weights_only=True) if checkpoint.exists() else None
    network, average = (
        _use_channels_last(task.create_initial_network() if saved is None else task.create_network()),
        _use_channels_last(task.create_network()),
    )
    optimiser = torch.optim.AdamW(network.parameters(), lr=MAX_LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    if saved is None:
        average.load_state_dict(network.state_dict())
        return TrainingState(network, average, optimiser, 0, 0.0)
    network.load_state_dict(saved["network"])
    average.load_state_dict(saved["average"])
    optimiser.load_state_dict(saved["optimiser"])
    return TrainingState(network, average, optimiser, saved["step"], saved["seconds"])


def _use_channels_last(network: N) -> N:
    """Store the arrays of a network channels-last: a step takes two thirds of the time."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def _save_state(checkpoint: Path, state: TrainingState[N]) -> None:
    aside = checkpoint.with_name(checkpoint.name + ".part")
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
    aside.replace(checkpoint)


def _train_step(state: TrainingState[N], task: TrainingTask[N], options: TrainOptions) -> dict[str, float]:
    progress = state.progress(options)
    warm = min(progress / WARM_UP_SHARE, 1.0)
    for group in state.optimiser.param_groups:
        group["lr"] = MAX_LEARNING_RATE * warm * (0.5 + 0.5 * float(np.cos(np.pi * progress))) + 1e-6
    state.network.train()
    loss, parts = task.compute_loss(state.network, state.step)
    state.optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(state.network.parameters(), 5.0)
    state.optimiser.step()
    state.step += 1
    _update_average(state)
    return parts


@torch.no_grad()
def _update_average(state: TrainingState[N]) -> None:
    """Move the averaged weights towards the current ones; faster in early steps."""
    keep = min(AVERAGE_DECAY, 1 - 1 / (1 + state.step / 10))
    for mean, value in zip(state.average.state_dict().values(), state.network.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(value, 1 - keep)
        else:
            mean.copy_(value)
