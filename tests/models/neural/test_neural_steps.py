"""Steps through a slope: their order is measured."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from models.neural.steps import Step, euler, printed_runge_kutta, runge_kutta


def slope(x: Tensor, t: Tensor) -> Tensor:
    """Its solution from 1 at time 0 is exp(sin t)."""
    return x * torch.cos(t)


def error(step: Step, count: int) -> float:
    h = torch.tensor([1.0], dtype=torch.float64) / count
    x = torch.ones(1, dtype=torch.float64)
    for k in range(count):
        x = step(slope, x, k * h, h)
    return abs(float(x) - math.exp(math.sin(1.0)))


@pytest.mark.parametrize(("step", "order"), [(euler, 1), (runge_kutta, 4), (printed_runge_kutta, 1)])
def test_a_step_has_its_order(step: Step, order: int) -> None:
    """As printed, the slopes come from half a step too late: that costs three orders."""
    assert math.log2(error(step, 16) / error(step, 32)) == pytest.approx(order, abs=0.25)


def test_a_velocity_of_one_period_a_step_moves_the_midpoint_and_no_end() -> None:
    """Why eq. 20 of the thesis cannot choose between smooth motions and such that swing between samples."""

    def wave(x: Tensor, t: Tensor) -> Tensor:
        return torch.sin(2 * torch.pi * t).expand_as(x)

    x, half = torch.zeros(1, dtype=torch.float64), torch.tensor([0.5], dtype=torch.float64)
    middle = runge_kutta(wave, x, 0 * half, half)
    assert float(middle) == pytest.approx(1 / 3)
    assert float(runge_kutta(wave, middle, half, half)) == pytest.approx(0.0, abs=1e-12)
