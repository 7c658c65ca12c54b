"""The training that all networks share."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.method_interface import (
    HeldOutSamples,
    MotionNotFoundError,
    TrainingBudget,
)
from models.neural.common.network_training import (
    HOLDOUT_INTERVAL,
    Motion,
    Perceptron,
    TrainingSchedule,
    count_parameters,
    make_generator,
    train_network,
)
from models.neural.networks.neural_runge_kutta import TimeEncoding


class Bowl(nn.Module):
    """A quadratic of condition number 1000 around (1, 1, 1, 1)."""

    def __init__(self) -> None:
        super().__init__()
        self.place = nn.Parameter(torch.zeros(4, dtype=torch.float64))
        self.width = torch.logspace(0, 3, 4, dtype=torch.float64)

    def loss(self) -> Tensor:
        return (self.width * (self.place - 1) ** 2).sum()

    def height(self) -> float:
        return float(self.loss().detach())


def test_lbfgs_finds_the_bottom_of_a_bowl_that_adam_only_nears() -> None:
    slow, fast = Bowl(), Bowl()
    train_network(slow, slow.loss, TrainingSchedule(adam_steps=100, learning_rate=0.03), TrainingBudget())
    train_network(
        fast, fast.loss, TrainingSchedule(adam_steps=50, learning_rate=0.03, lbfgs_evaluations=50), TrainingBudget()
    )
    assert fast.height() < 1e-20 < slow.height()


def test_the_best_state_is_kept() -> None:
    bowl = Bowl()
    curve = train_network(
        bowl, bowl.loss, TrainingSchedule(adam_steps=200, learning_rate=0.5, final_learning_rate=0.5), TrainingBudget()
    ).loss_curve
    assert len(curve) == 200
    assert bowl.height() == pytest.approx(curve.min())


def test_training_stops_when_nothing_is_gained() -> None:
    bowl = Bowl()
    curve = train_network(
        bowl,
        bowl.loss,
        TrainingSchedule(adam_steps=5000, learning_rate=0.0, final_learning_rate=0.0, patience=30),
        TrainingBudget(),
    ).loss_curve
    assert len(curve) < 40


def move_at_place(bowl: Bowl, best: float) -> Motion:
    """Build the motion of a bowl whose error on samples at 0 is least where all its parameters are `best`."""
    error = float((bowl.place.detach() - best).abs().max())
    return lambda t: np.full((len(t), 1, 1), error)


def train_with_holdout(schedule: TrainingSchedule, best: float) -> tuple[Bowl, FloatArray, bool]:
    """Train a bowl from 0 to 1 with held-out samples that are best explained at `best`."""
    bowl = Bowl()
    bowl.width = torch.ones(4, dtype=torch.float64)
    budget = TrainingBudget(holdout=HeldOutSamples(np.zeros(1), np.zeros((1, 1, 1))))
    result = train_network(bowl, bowl.loss, schedule, budget, lambda: move_at_place(bowl, best))
    return bowl, result.loss_curve, result.is_complete


def test_the_state_of_least_error_on_held_out_samples_is_kept_and_ends_the_training() -> None:
    steady = TrainingSchedule(adam_steps=100_000, learning_rate=2e-3, final_learning_rate=2e-3, patience=100_000)
    bowl, curve, is_complete = train_with_holdout(steady, 0.5)
    assert is_complete
    assert bowl.place.detach().numpy() == pytest.approx(0.5, abs=2e-3 * HOLDOUT_INTERVAL)
    assert 0.5 / 2e-3 - HOLDOUT_INTERVAL < len(curve) < 1.5 * 0.5 / 2e-3


def test_a_training_that_still_gains_at_its_last_step_is_incomplete() -> None:
    slow = TrainingSchedule(adam_steps=300, learning_rate=1e-3, final_learning_rate=1e-3)
    assert not train_with_holdout(slow, 1.0)[2]


def test_lbfgs_goes_on_until_held_out_samples_gain_nothing() -> None:
    schedule = TrainingSchedule(adam_steps=40, learning_rate=1e-3, lbfgs_evaluations=1)
    bowl, curve, is_complete = train_with_holdout(schedule, 1.0)
    assert is_complete
    assert len(curve) > 41
    assert bowl.place.detach().numpy() == pytest.approx(1.0)


def test_a_number_of_evaluations_replaces_that_of_the_schedule() -> None:
    bowl = Bowl()
    schedule = TrainingSchedule(adam_steps=100, lbfgs_evaluations=10)
    assert len(train_network(bowl, bowl.loss, schedule, TrainingBudget(evaluations=30)).loss_curve) == 30
    assert schedule.set_evaluations(150) == TrainingSchedule(adam_steps=100, lbfgs_evaluations=50)


def test_a_training_that_time_ends_is_incomplete() -> None:
    bowl = Bowl()
    schedule = TrainingSchedule(adam_steps=10**9)
    assert not train_network(bowl, bowl.loss, schedule, TrainingBudget(seconds=0.05)).is_complete
    assert train_network(bowl, bowl.loss, TrainingSchedule(adam_steps=5), TrainingBudget()).is_complete


def test_effort_sets_the_number_of_steps_and_seconds_end_them() -> None:
    bowl = Bowl()
    short = train_network(bowl, bowl.loss, TrainingSchedule(adam_steps=100), TrainingBudget(effort=0.25))
    assert len(short.loss_curve) == 25
    timed = train_network(bowl, bowl.loss, TrainingSchedule(adam_steps=10**9), TrainingBudget(seconds=0.05))
    assert len(timed.loss_curve) < 10**6


def test_a_loss_that_is_never_finite_is_an_error() -> None:
    bowl = Bowl()
    with pytest.raises(MotionNotFoundError, match="no finite loss"):
        train_network(bowl, lambda: bowl.loss() * torch.nan, TrainingSchedule(adam_steps=3), TrainingBudget())


def test_a_perceptron_has_the_layers_of_the_thesis_and_leaves_other_randomness_alone() -> None:
    before = torch.random.get_rng_state()
    net = Perceptron(7, 6, (512, 512, 512), nn.ReLU, make_generator(0))
    assert torch.equal(before, torch.random.get_rng_state())
    assert count_parameters(net) == 8 * 512 + 2 * 513 * 512 + 513 * 6
    again = Perceptron(7, 6, (512, 512, 512), nn.ReLU, make_generator(0))
    assert torch.equal(net(torch.ones(7, dtype=torch.float64)), again(torch.ones(7, dtype=torch.float64)))


def test_no_wave_of_a_clock_is_shorter_than_asked_for() -> None:
    clock = TimeEncoding(span=20.0, shortest_period=4.0)
    t = torch.linspace(0, 20, 201, dtype=torch.float64)[:, None]
    waves = clock.encode(t).numpy()
    assert waves.shape == (201, clock.width) == (201, 11)
    power = np.abs(np.fft.rfft(waves[:-1, 1:], axis=0)) ** 2  # bins are waves of 20 / k steps
    assert power[6:].max() < 1e-18 * power.max()
