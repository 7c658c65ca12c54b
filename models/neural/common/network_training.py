"""Training of all networks: full batches, a schedule of Adam and L-BFGS steps, and the state of lowest loss.

Adam (Kingma and Ba 2014, arXiv:1412.6980) runs first, with a learning rate that falls along a half cosine. L-BFGS with
a line search (Liu and Nocedal 1989, doi:10.1007/BF01589116) follows if the schedule has evaluations for it. Loss and
early stopping use visible samples only.
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
from models.neural.common.method_interface import MotionNotFoundError, TrainingBudget

Loss = Callable[[], Tensor]
"""Evaluates the loss of a network in its current state."""


@dataclass(frozen=True, slots=True)
class TrainingSchedule:
    """Training schedule at full effort."""

    adam_steps: int = 3000
    """Steps of Adam."""
    learning_rate: float = 1e-3
    """Learning rate of Adam at the first step."""
    final_learning_rate: float = 1e-5
    """Learning rate of Adam at the last step."""
    lbfgs_evaluations: int = 0
    """Evaluations of the loss by L-BFGS after Adam."""
    patience: int = 1000
    """Adam stops after this many steps without a gain of `MIN_GAIN`."""
    gradient_clip: float = float("inf")
    """Largest norm of the gradient in a step of Adam."""
    uses_minibatches: bool = False
    """Whether every step draws other samples. The last state is kept then, because the lowest loss is that of a
    favourable batch."""


MIN_GAIN = 0.01
"""Relative decrease of the lowest loss that counts as a gain."""
EVALUATIONS_PER_CHECK = 20
"""Most evaluations by L-BFGS between two checks of the elapsed time."""
LBFGS_MEMORY = 50
"""Steps in the history of L-BFGS."""


@contextmanager
def use_one_thread() -> Iterator[None]:
    """Restrict torch to one thread, so that sums keep their order and equal seeds give equal bits.

    Yields:
        None; the previous number of threads is restored afterwards.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class BestState:
    """The parameters of lowest loss during a training, and the loss curve."""

    def __init__(self, network: nn.Module, began: float) -> None:
        self.network = network
        self.start = began
        self.loss_curve: list[float] = []
        self.lowest_loss = math.inf
        self.best_values = [value.detach().clone() for value in network.parameters()]

    def record_loss(self, loss: float) -> None:
        """Append the loss of the current parameters, and copy them if it is the lowest."""
        self.loss_curve.append(loss)
        if loss < self.lowest_loss:
            self.lowest_loss = loss
            for best, value in zip(self.best_values, self.network.parameters(), strict=True):
                best.copy_(value.detach())

    def restore_best(self) -> None:
        """Copy the parameters of lowest loss back into the network."""
        with torch.no_grad():
            for best, value in zip(self.best_values, self.network.parameters(), strict=True):
                value.copy_(best)

    def cpu_seconds(self) -> float:
        """Return the CPU time of the training so far, s."""
        return time.process_time() - self.start


def train_network(network: nn.Module, loss: Loss, schedule: TrainingSchedule, budget: TrainingBudget) -> FloatArray:
    """Train a network in place.

    Afterwards the network has its parameters of lowest loss, or its last ones if the schedule uses minibatches.

    Args:
        network: Network to train.
        loss: Evaluates the loss of the network.
        schedule: Training schedule.
        budget: Limits on the training.

    Returns:
        Losses of all evaluations, in order.

    Raises:
        MotionNotFoundError: No evaluation has a finite loss.
    """
    best = BestState(network, time.process_time())
    with use_one_thread():
        _run_adam(network, loss, schedule, budget, best)
        if not schedule.uses_minibatches:
            best.restore_best()
        if schedule.lbfgs_evaluations:
            _run_lbfgs(network, loss, budget.scale_steps(schedule.lbfgs_evaluations), budget, best)
            best.restore_best()
    if not math.isfinite(best.lowest_loss):
        raise MotionNotFoundError("training found no finite loss; lower its rate, or check the units of the samples")
    return np.array(best.loss_curve)


def _run_adam(
    network: nn.Module, loss: Loss, schedule: TrainingSchedule, budget: TrainingBudget, best: BestState
) -> None:
    optimiser = torch.optim.Adam(network.parameters(), lr=schedule.learning_rate)
    steps, mark, marked = budget.scale_steps(schedule.adam_steps), math.inf, 0
    seconds = budget.seconds / 2 if schedule.lbfgs_evaluations else budget.seconds
    for step in range(steps):
        for group in optimiser.param_groups:  # falls to its final value at the limit that comes first
            group["lr"] = _learning_rate_at(schedule, min(max(step / steps, best.cpu_seconds() / seconds), 1.0))
        optimiser.zero_grad()
        value = loss()
        best.record_loss(float(value.detach()))
        if best.lowest_loss < (1 - MIN_GAIN) * mark:
            mark, marked = best.lowest_loss, step
        if step - marked > budget.scale_steps(schedule.patience) or best.cpu_seconds() > seconds:
            return
        value.backward()  # type: ignore[no-untyped-call]
        if math.isfinite(schedule.gradient_clip):
            nn.utils.clip_grad_norm_(network.parameters(), schedule.gradient_clip)
        optimiser.step()


def _learning_rate_at(schedule: TrainingSchedule, done: float) -> float:
    return schedule.final_learning_rate + (schedule.learning_rate - schedule.final_learning_rate) * 0.5 * (
        1 + math.cos(math.pi * done)
    )


def _run_lbfgs(network: nn.Module, loss: Loss, steps: int, budget: TrainingBudget, best: BestState) -> None:
    optimiser = torch.optim.LBFGS(
        network.parameters(), tolerance_grad=0.0, tolerance_change=0.0, history_size=LBFGS_MEMORY,
        line_search_fn="strong_wolfe",
    )  # fmt: skip

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss()
        best.record_loss(float(value.detach()))
        value.backward()  # type: ignore[no-untyped-call]
        return value

    end = len(best.loss_curve) + steps
    while len(best.loss_curve) < end and best.cpu_seconds() < budget.seconds:
        before = len(best.loss_curve), best.lowest_loss
        at_once = min(EVALUATIONS_PER_CHECK, steps, _count_affordable_evaluations(budget, best))
        optimiser.param_groups[0].update(max_iter=at_once, max_eval=at_once)
        optimiser.step(closure)  # type: ignore[no-untyped-call]
        stuck = not best.lowest_loss < before[1] or not math.isfinite(best.loss_curve[-1])
        if len(best.loss_curve) == before[0] or stuck:
            return


def _count_affordable_evaluations(budget: TrainingBudget, best: BestState) -> int:
    """Count the evaluations that fit into the remaining time, at the mean cost so far; at least one."""
    if not math.isfinite(budget.seconds):
        return EVALUATIONS_PER_CHECK
    each = best.cpu_seconds() / max(len(best.loss_curve), 1)
    return max(1, int((budget.seconds - best.cpu_seconds()) / max(each, 1e-9)))
