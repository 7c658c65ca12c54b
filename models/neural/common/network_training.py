"""Training of all networks: full batches, a schedule of Adam and L-BFGS steps, and the state of lowest loss.

Adam (Kingma and Ba 2014, arXiv:1412.6980) runs first, with a learning rate that falls along a half cosine. L-BFGS with
a line search (Liu and Nocedal 1989, doi:10.1007/BF01589116) follows if the schedule has evaluations for it. Loss and
early stopping use visible samples only. If some of them are held out of the loss, the error on them decides when
training stops and which state is kept.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.method_interface import (
    HOLDOUT_PATIENCE,
    MIN_HOLDOUT_GAIN,
    FittedMotion,
    HeldOutSamples,
    MotionNotFoundError,
    TrainingBudget,
)


def make_generator(seed: int) -> torch.Generator:
    """Create the random generator of one training.

    Args:
        seed: Random seed.

    Returns:
        A generator that is independent of torch's global one.
    """
    return torch.Generator().manual_seed(seed)


def count_parameters(network: nn.Module) -> int:
    """Count the trainable parameters of a network.

    Args:
        network: Any module.

    Returns:
        Number of scalars.
    """
    return sum(value.numel() for value in network.parameters() if value.requires_grad)


def build_layer(inputs: int, outputs: int, generator: torch.Generator, dtype: torch.dtype) -> nn.Linear:
    """Build a linear layer with weights and biases uniform within 1 / sqrt(inputs), like torch.

    LeCun et al. 1998, doi:10.1007/3-540-49430-8_2.
    """
    linear = nn.Linear(inputs, outputs, dtype=dtype, device="meta").to_empty(device="cpu")  # uses no random numbers
    bound = 1 / math.sqrt(inputs)
    with torch.no_grad():
        linear.weight.uniform_(-bound, bound, generator=generator)
        linear.bias.uniform_(-bound, bound, generator=generator)
    return linear


class Perceptron(nn.Module):
    """Fully connected network with hidden layers of given widths."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        widths: Sequence[int],
        activation: type[nn.Module],
        generator: torch.Generator,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        super().__init__()
        sizes = (inputs, *widths)
        hidden: list[nn.Module] = []
        for into, out in pairwise(sizes):
            hidden += [build_layer(into, out, generator, dtype), activation()]
        self.last = build_layer(sizes[-1], outputs, generator, dtype)
        self.layers = nn.Sequential(*hidden, self.last)

    def forward(self, x: Tensor) -> Tensor:
        """Map inputs (..., inputs) to outputs (..., outputs)."""
        outputs: Tensor = self.layers(x)
        return outputs


# Evaluates the loss of a network in its current state.
Loss = Callable[[], Tensor]
# Maps times (M,) in s to coordinates (M, N, D).
Motion = Callable[[FloatArray], FloatArray]


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

    def set_evaluations(self, count: int) -> TrainingSchedule:
        """Return the schedule with a number of evaluations: Adam first, L-BFGS if it has any for the rest."""
        rest = max(count - self.adam_steps, 0) if self.lbfgs_evaluations else 0
        return replace(self, adam_steps=min(count, self.adam_steps), lbfgs_evaluations=rest)


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """Course of a training."""

    loss_curve: FloatArray
    """Losses of all evaluations, in order; with held-out samples, of those up to the kept state."""
    is_complete: bool
    """Whether the training ended by itself: not at the time limit and, with held-out samples, not at the end of the
    schedule while their error still decreased."""


# Relative decrease of the lowest loss that counts as a gain.
MIN_GAIN = 0.01
# Most evaluations by L-BFGS between two checks of the elapsed time.
EVALUATIONS_PER_CHECK = 20
# Steps in the history of L-BFGS.
LBFGS_MEMORY = 50
# Evaluations between two checks of the error on held-out samples.
HOLDOUT_INTERVAL = 20


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


class HoldoutCheck:
    """The error on held-out samples during a training."""

    def __init__(self, samples: HeldOutSamples, build_motion: Callable[[], Motion]) -> None:
        self.samples, self.build_motion = samples, build_motion
        self.lowest_error, self.best_count = math.inf, 0
        self.last_gain = math.inf, 0
        """Error and number of evaluations at the last gain of `MIN_HOLDOUT_GAIN`."""

    def is_best(self, count: int) -> bool:
        """Evaluate the error after `count` evaluations of the loss; return whether it is the lowest."""
        error = float(np.mean((self.build_motion()(self.samples.times) - self.samples.states) ** 2))
        if error < (1 - MIN_HOLDOUT_GAIN) * self.last_gain[0]:
            self.last_gain = error, count
        if not error < self.lowest_error:
            return False
        self.lowest_error, self.best_count = error, count
        return True

    def has_settled(self, count: int, start: int = 0) -> bool:
        """Return whether no gain occurred within the patience, counted from `start` at the earliest."""
        return count - max(self.last_gain[1], start) >= HOLDOUT_PATIENCE


class BestState:
    """The parameters of lowest loss, or of lowest error on held-out samples, during a training; the loss curve."""

    def __init__(self, network: nn.Module, began: float, holdout: HoldoutCheck | None = None) -> None:
        self.network = network
        self.start = began
        self.holdout = holdout
        self.loss_curve: list[float] = []
        self.lowest_loss = math.inf
        self.best_values = [value.detach().clone() for value in network.parameters()]

    def record_loss(self, loss: float) -> None:
        """Append the loss of the current parameters, and copy them if it is the lowest and no samples are held out."""
        self.loss_curve.append(loss)
        if loss < self.lowest_loss:
            self.lowest_loss = loss
            if self.holdout is None:
                self._copy_parameters()

    def check_holdout(self) -> None:
        """Copy the current parameters if their error on held-out samples is the lowest."""
        if self.holdout is not None and self.holdout.is_best(len(self.loss_curve)):
            self._copy_parameters()

    def has_settled(self, start: int = 0) -> bool:
        """Return whether the error on held-out samples no longer decreases."""
        return self.holdout is not None and self.holdout.has_settled(len(self.loss_curve), start)

    def _copy_parameters(self) -> None:
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


def train_network(
    network: nn.Module,
    loss: Loss,
    schedule: TrainingSchedule,
    budget: TrainingBudget,
    build_motion: Callable[[], Motion] | None = None,
) -> TrainingResult:
    """Train a network in place.

    Afterwards the network has its parameters of lowest loss, of lowest error on held-out samples if the budget has any,
    or its last ones if the schedule uses minibatches.

    Args:
        network: Network to train.
        loss: Evaluates the loss of the network.
        schedule: Training schedule.
        budget: Limits on the training.
        build_motion: Builds the motion of the network in its current state, for the error on held-out samples.

    Returns:
        The course of the training.

    Raises:
        MotionNotFoundError: No evaluation has a finite loss, or no state a finite error on held-out samples.
    """
    began = time.process_time()
    holdout = HoldoutCheck(budget.holdout, build_motion) if budget.holdout and build_motion else None
    best = BestState(network, began, holdout)
    if budget.evaluations is not None:
        schedule = schedule.set_evaluations(budget.evaluations)
    with use_one_thread():
        _run_adam(network, loss, schedule, budget, best)
        best.check_holdout()
        if not schedule.uses_minibatches:
            best.restore_best()
        if schedule.lbfgs_evaluations:
            _run_lbfgs(network, loss, budget.scale_steps(schedule.lbfgs_evaluations), budget, best)
            best.restore_best()
    if not math.isfinite(best.lowest_loss) or (holdout and not math.isfinite(holdout.lowest_error)):
        raise MotionNotFoundError("training found no finite loss; lower its rate, or check the units of the samples")
    is_complete = best.cpu_seconds() < budget.seconds
    if holdout is None:
        return TrainingResult(np.array(best.loss_curve), is_complete)
    has_settled = best.has_settled() or schedule.lbfgs_evaluations > 0  # L-BFGS goes on until nothing is gained
    return TrainingResult(np.array(best.loss_curve[: holdout.best_count]), is_complete and has_settled)


def _run_adam(
    network: nn.Module, loss: Loss, schedule: TrainingSchedule, budget: TrainingBudget, best: BestState
) -> None:
    optimiser = torch.optim.Adam(network.parameters(), lr=schedule.learning_rate)
    steps, mark, marked = budget.scale_steps(schedule.adam_steps), math.inf, 0
    seconds = budget.seconds / 2 if schedule.lbfgs_evaluations else budget.seconds
    stops_early = best.holdout is not None or budget.evaluations is not None
    for step in range(steps):
        # falls to its final value at the limit that comes first; with early stopping, time has no influence
        done = step / steps if stops_early else max(step / steps, best.cpu_seconds() / seconds)
        for group in optimiser.param_groups:
            group["lr"] = _learning_rate_at(schedule, min(done, 1.0))
        if step and step % HOLDOUT_INTERVAL == 0:
            best.check_holdout()
            if best.has_settled() and not schedule.lbfgs_evaluations:
                return
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

    start = len(best.loss_curve)
    while best.cpu_seconds() < budget.seconds:
        if best.has_settled(start) if best.holdout else len(best.loss_curve) >= start + steps:
            return
        before = len(best.loss_curve), best.lowest_loss
        at_once = min(EVALUATIONS_PER_CHECK, steps, _count_affordable_evaluations(budget, best))
        optimiser.param_groups[0].update(max_iter=at_once, max_eval=at_once)
        optimiser.step(closure)  # type: ignore[no-untyped-call]
        best.check_holdout()
        stuck = not best.lowest_loss < before[1] or not math.isfinite(best.loss_curve[-1])
        if len(best.loss_curve) == before[0] or stuck:
            return


def _count_affordable_evaluations(budget: TrainingBudget, best: BestState) -> int:
    """Count the evaluations that fit into the remaining time, at the mean cost so far; at least one."""
    if not math.isfinite(budget.seconds):
        return EVALUATIONS_PER_CHECK
    each = best.cpu_seconds() / max(len(best.loss_curve), 1)
    return max(1, int((budget.seconds - best.cpu_seconds()) / max(each, 1e-9)))


def summarize_training(motion: Motion, result: TrainingResult, network: nn.Module, began: float) -> FittedMotion:
    """Return the motion of a trained network; `began` is the CPU time at the start of the fit, s."""
    seconds = time.process_time() - began
    return FittedMotion(motion, result.loss_curve, count_parameters(network), seconds, is_trained=result.is_complete)
