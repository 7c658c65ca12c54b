"""The training that all networks share."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from models.neural.common.method_interface import MotionNotFoundError, TrainingBudget
from models.neural.common.network_training import TrainingSchedule, train_network
from models.neural.common.perceptron import Perceptron, count_parameters, make_generator
from models.neural.common.time_encoding import TimeEncoding


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
    )
    assert len(curve) == 200
    assert bowl.height() == pytest.approx(curve.min())


def test_training_stops_when_nothing_is_gained() -> None:
    bowl = Bowl()
    curve = train_network(
        bowl,
        bowl.loss,
        TrainingSchedule(adam_steps=5000, learning_rate=0.0, final_learning_rate=0.0, patience=30),
        TrainingBudget(),
    )
    assert len(curve) < 40


def test_effort_sets_the_number_of_steps_and_seconds_end_them() -> None:
    bowl = Bowl()
    assert len(train_network(bowl, bowl.loss, TrainingSchedule(adam_steps=100), TrainingBudget(effort=0.25))) == 25
    assert len(train_network(bowl, bowl.loss, TrainingSchedule(adam_steps=10**9), TrainingBudget(seconds=0.05))) < 10**6


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
