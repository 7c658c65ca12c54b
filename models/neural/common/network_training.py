"""How every network here is trained: all samples at once, a schedule of steps, the best state kept.

Adam (Kingma and Ba 2014, arXiv:1412.6980) while its rate falls along a half cosine, then, where asked for, L-BFGS with
a line search (Liu and Nocedal 1989, doi 10.1007/BF01589116). The loss knows visible samples only; so does the early
stop.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.method_interface import Budget, LostMotion

Loss = Callable[[], Tensor]


@dataclass(frozen=True, slots=True)
class Schedule:
    """Steps of a training at full effort."""

    adam: int = 3000
    """steps."""
    rate: float = 1e-3
    """of Adam at its start."""
    last_rate: float = 1e-5
    """of Adam at its end."""
    lbfgs: int = 0
    """evaluations of the loss by L-BFGS afterwards."""
    patience: int = 1000
    """steps of Adam without a gain of `GAIN` after which it ends."""
    clip: float = float("inf")
    """the longest gradient that a step of Adam follows."""
    sampled: bool = False
    """every step sees other samples: the last state is kept, since the least loss is luck."""


GAIN = 0.01
"""share by which the least loss must fall to count as better."""
LOOKS = 20
"""evaluations by L-BFGS between two looks at the clock, at most."""
MEMORY = 50
"""steps that L-BFGS remembers."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Sums in one order, so that equal seeds give equal bits."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class Best:
    """The state of least loss, and the curve that led there."""

    def __init__(self, network: nn.Module, began: float) -> None:
        self.network = network
        self.began = began
        self.curve: list[float] = []
        self.least = math.inf
        self.kept = [value.detach().clone() for value in network.parameters()]

    def see(self, loss: float) -> None:
        """The loss of the network as it is now."""
        self.curve.append(loss)
        if loss < self.least:
            self.least = loss
            for kept, value in zip(self.kept, self.network.parameters(), strict=True):
                kept.copy_(value.detach())

    def restore(self) -> None:
        """Put the best state back."""
        with torch.no_grad():
            for kept, value in zip(self.kept, self.network.parameters(), strict=True):
                value.copy_(kept)

    def spent(self) -> float:
        """CPU s so far."""
        return time.process_time() - self.began


def train(network: nn.Module, loss: Loss, schedule: Schedule, budget: Budget) -> FloatArray:
    """Leave the network in its state of least loss, or in the last one where every step sees other samples; the losses
    (L,) on the way there.

    Raises `LostMotion` where no state has a finite loss.
    """
    best = Best(network, time.process_time())
    with one_thread():
        _adam(network, loss, schedule, budget, best)
        if not schedule.sampled:
            best.restore()
        if schedule.lbfgs:
            _lbfgs(network, loss, budget.steps(schedule.lbfgs), budget, best)
            best.restore()
    if not math.isfinite(best.least):
        raise LostMotion("training found no finite loss; lower its rate, or check the units of the samples")
    return np.array(best.curve)


def _adam(network: nn.Module, loss: Loss, schedule: Schedule, budget: Budget, best: Best) -> None:
    optimiser = torch.optim.Adam(network.parameters(), lr=schedule.rate)
    steps, mark, marked = budget.steps(schedule.adam), math.inf, 0
    seconds = budget.seconds / 2 if schedule.lbfgs else budget.seconds
    for step in range(steps):
        for group in optimiser.param_groups:  # the rate falls in time for whichever end comes first
            group["lr"] = _rate(schedule, min(max(step / steps, best.spent() / seconds), 1.0))
        optimiser.zero_grad()
        value = loss()
        best.see(float(value.detach()))
        if best.least < (1 - GAIN) * mark:
            mark, marked = best.least, step
        if step - marked > budget.steps(schedule.patience) or best.spent() > seconds:
            return
        value.backward()  # type: ignore[no-untyped-call]
        if math.isfinite(schedule.clip):
            nn.utils.clip_grad_norm_(network.parameters(), schedule.clip)
        optimiser.step()


def _rate(schedule: Schedule, done: float) -> float:
    return schedule.last_rate + (schedule.rate - schedule.last_rate) * 0.5 * (1 + math.cos(math.pi * done))


def _lbfgs(network: nn.Module, loss: Loss, steps: int, budget: Budget, best: Best) -> None:
    optimiser = torch.optim.LBFGS(
        network.parameters(), tolerance_grad=0.0, tolerance_change=0.0, history_size=MEMORY,
        line_search_fn="strong_wolfe",
    )  # fmt: skip

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss()
        best.see(float(value.detach()))
        value.backward()  # type: ignore[no-untyped-call]
        return value

    end = len(best.curve) + steps
    while len(best.curve) < end and best.spent() < budget.seconds:
        before = len(best.curve), best.least
        at_once = min(LOOKS, steps, _affordable(budget, best))
        optimiser.param_groups[0].update(max_iter=at_once, max_eval=at_once)
        optimiser.step(closure)  # type: ignore[no-untyped-call]
        stuck = not best.least < before[1] or not math.isfinite(best.curve[-1])
        if len(best.curve) == before[0] or stuck:
            return


def _affordable(budget: Budget, best: Best) -> int:
    """Evaluations for which there is time, going by those that were made; one at least."""
    if not math.isfinite(budget.seconds):
        return LOOKS
    each = best.spent() / max(len(best.curve), 1)
    return max(1, int((budget.seconds - best.spent()) / max(each, 1e-9)))
