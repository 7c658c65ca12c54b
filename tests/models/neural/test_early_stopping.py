"""Early stopping of networks by held-out visible samples."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from support.pendulum_swings import circle, mse

from models.core.typing import FloatArray
from models.neural.common.method_interface import EarlyStopping, FittedMotion, MotionMethod, TrainingBudget
from models.neural.common.network_training import TrainingSchedule
from models.neural.networks.constraint_net import CONSTRAINT_NET
from models.neural.networks.neural_runge_kutta import RUNGE_KUTTA_NET, SMOOTH_NET

TIMES = np.linspace(0, 1, 25)
MIDDLES = (TIMES[1:] + TIMES[:-1]) / 2
SMALL_NET = replace(
    SMOOTH_NET, widths=(24, 24), schedule=TrainingSchedule(adam_steps=60, learning_rate=3e-3, lbfgs_evaluations=200)
)


@dataclass(frozen=True)
class RecordingNetwork:
    """A network that records its samples and budgets; its error on held-out samples is least after 70 steps."""

    seconds: float = 1.0
    is_trained: bool = True
    fits: list[tuple[FloatArray, TrainingBudget]] = field(default_factory=list)
    name: str = "recording"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> FittedMotion:
        self.fits.append((times, budget))
        return FittedMotion(circle, np.ones(70), 5, self.seconds, is_trained=self.is_trained)


def test_held_out_samples_set_the_steps_of_the_training_on_all_samples() -> None:
    network = RecordingNetwork()
    fitted = EarlyStopping(network).fit(TIMES, circle(TIMES), 0, TrainingBudget(seconds=10.0))
    (part, first), (whole, second) = network.fits
    assert first.holdout is not None
    assert sorted([*part, *first.holdout.times]) == pytest.approx(TIMES)
    assert np.array_equal(whole, TIMES)
    assert (second.holdout, second.evaluations, second.seconds) == (None, 70, 9.0)
    assert fitted.is_trained
    assert fitted.seconds == 2.0


def test_a_training_that_the_time_limit_ended_is_not_repeated() -> None:
    network = RecordingNetwork(is_trained=False)
    assert not EarlyStopping(network).fit(TIMES, circle(TIMES), 0, TrainingBudget(seconds=10.0)).is_trained
    assert len(network.fits) == 1


def test_a_network_without_samples_to_hold_out_counts_as_not_trained() -> None:
    assert not EarlyStopping(RecordingNetwork()).fit(TIMES[:4], circle(TIMES[:4])).is_trained


@pytest.mark.parametrize("network", [RUNGE_KUTTA_NET, SMOOTH_NET, CONSTRAINT_NET], ids=lambda network: network.name)
def test_a_network_that_runs_out_of_time_is_not_trained(network: MotionMethod) -> None:
    assert not EarlyStopping(network).fit(TIMES, circle(TIMES), 0, TrainingBudget(seconds=0.2)).is_trained


def test_held_out_samples_end_the_training_before_it_fits_the_noise() -> None:
    """Noise of 3 px on a circle of 100 px, which the whole schedule fits."""
    noisy = circle(TIMES) + 3 * np.random.default_rng(0).standard_normal((25, 1, 2))
    early, whole = EarlyStopping(SMALL_NET).fit(TIMES, noisy), SMALL_NET.fit(TIMES, noisy)
    assert early.is_trained
    assert len(early.loss_curve) < len(whole.loss_curve)
    assert mse(early.at(MIDDLES), circle(MIDDLES)) < mse(whole.at(MIDDLES), circle(MIDDLES))


def test_a_schedule_that_ends_while_the_error_falls_is_no_end_of_the_training() -> None:
    short = replace(SMALL_NET, schedule=TrainingSchedule(adam_steps=60))
    assert not EarlyStopping(short).fit(TIMES, circle(TIMES)).is_trained
