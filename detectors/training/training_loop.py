"""A training that can be interrupted: steps, schedule of the learning rate, averaged weights, checkpoints."""

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

RATE, DECAY = 3e-3, 1e-4
"""Highest learning rate and weight decay of AdamW (Loshchilov and Hutter 2019, arXiv:1711.05101)."""
WARM_SHARE = 0.04
"""Share of the steps in which the learning rate rises; then it falls along a half cosine."""
AVERAGED = 0.998
"""Share of the averaged weights that a step keeps: the averaged ones are exported (Polyak and Juditsky 1992,
doi:10.1137/0330046)."""
CHECKPOINT_S = 60.0


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """How long and on how much a network is trained."""

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


Watch = Callable[[int, float, dict[str, float]], None]
"""Told the step, how far the training is (0 to 1) and the parts of the step's loss."""


class Lesson(Protocol[N]):
    """What is learnt."""

    checkpoint: str
    """Name of the file that keeps the training."""

    def empty(self) -> N:
        """A network whose weights do not matter yet."""
        ...

    def fresh(self) -> N:
        """The network that training begins with."""
        ...

    def loss(self, network: N, step: int) -> tuple[Tensor, dict[str, float]]:
        """Of the pictures of a step, which are the same whenever it is asked; and the parts of it."""
        ...


@dataclass(slots=True)
class Training(Generic[N]):
    """The state of a training."""

    network: N
    average: N
    optimiser: torch.optim.AdamW
    step: int
    seconds: float
    """Spent so far."""

    def done(self, options: TrainOptions) -> float:
        """How far the training is, from 0 to 1."""
        return min(max(self.step / options.steps, self.seconds / (3600 * options.hours)), 1.0)


def trained(lesson: Lesson[N], folder: Path, options: TrainOptions, watch: Watch) -> N:
    """The trained network; `folder` keeps checkpoints, and a second call goes on where the first ended."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / lesson.checkpoint
    state = _resumed(lesson, kept, options)
    try:
        _continue(state, lesson, kept, options, watch)
    finally:
        _save(kept, state)
    return state.average.eval()


def steps_done(checkpoint: Path) -> int:
    """Steps of a checkpoint."""
    return int(torch.load(checkpoint, weights_only=True)["step"])


def _continue(state: Training[N], lesson: Lesson[N], kept: Path, options: TrainOptions, watch: Watch) -> None:
    last = saved = time.monotonic()
    while state.done(options) < 1:
        parts = _step(state, lesson, options)
        now = time.monotonic()
        state.seconds, last = state.seconds + now - last, now
        watch(state.step, state.done(options), parts)
        if now - saved > CHECKPOINT_S:
            _save(kept, state)
            saved = now


def _resumed(lesson: Lesson[N], kept: Path, options: TrainOptions) -> Training[N]:
    torch.manual_seed(options.seed)
    saved = torch.load(kept, weights_only=True) if kept.exists() else None
    network, average = _laid_out(lesson.fresh() if saved is None else lesson.empty()), _laid_out(lesson.empty())
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
    if saved is None:
        average.load_state_dict(network.state_dict())
        return Training(network, average, optimiser, 0, 0.0)
    network.load_state_dict(saved["network"])
    average.load_state_dict(saved["average"])
    optimiser.load_state_dict(saved["optimiser"])
    return Training(network, average, optimiser, saved["step"], saved["seconds"])


def _laid_out(network: N) -> N:
    """A network whose arrays hold the channels of a place side by side: a step takes two thirds of the time."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def _save(kept: Path, state: Training[N]) -> None:
    aside = kept.with_name(kept.name + ".part")
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
    aside.replace(kept)


def _step(state: Training[N], lesson: Lesson[N], options: TrainOptions) -> dict[str, float]:
    done = state.done(options)
    warm = min(done / WARM_SHARE, 1.0)
    for group in state.optimiser.param_groups:
        group["lr"] = RATE * warm * (0.5 + 0.5 * float(np.cos(np.pi * done))) + 1e-6
    state.network.train()
    loss, parts = lesson.loss(state.network, state.step)
    state.optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(state.network.parameters(), 5.0)
    state.optimiser.step()
    state.step += 1
    _follow(state)
    return parts


@torch.no_grad()
def _follow(state: Training[N]) -> None:
    """Move the averaged weights; early on they follow faster."""
    keep = min(AVERAGED, 1 - 1 / (1 + state.step / 10))
    for mean, value in zip(state.average.state_dict().values(), state.network.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(value, 1 - keep)
        else:
            mean.copy_(value)
