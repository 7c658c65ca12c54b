"""Steps through a slope: their order is measured."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from models.neural.common.integration_steps import Euler, Leapfrog, RungeKutta, Slope, Step, Yoshida, march, settled


def slope(x: Tensor, t: Tensor) -> Tensor:
    """Its solution from 1 at time 0 is exp(sin t)."""
    return x * torch.cos(t)


def swing(z: Tensor, t: Tensor) -> Tensor:
    """A pendulum: z = (q, p)."""
    q, p = z.chunk(2, dim=-1)
    return torch.cat([p, -torch.sin(q)], dim=-1)


def path(step: Step, change: Slope, start: list[float], span: float, count: int) -> Tensor:
    """State after so many steps."""
    h = torch.tensor([span / count], dtype=torch.float64)
    return march(step, change, torch.tensor(start, dtype=torch.float64), 0 * h, count * h, count)


def error(step: Step, count: int) -> float:
    h = torch.tensor([1.0], dtype=torch.float64) / count
    x = torch.ones(1, dtype=torch.float64)
    for k in range(count):
        x = step(slope, x, k * h, h)
    return abs(float(x) - math.exp(math.sin(1.0)))


@pytest.mark.parametrize(("step", "order"), [(Euler(), 1), (RungeKutta(), 4), (RungeKutta(late=2.0), 1)])
def test_a_step_has_its_order(step: Step, order: int) -> None:
    """As printed, the slopes come from half a step too late: that costs three orders."""
    assert math.log2(error(step, 16) / error(step, 32)) == pytest.approx(order, abs=0.25)


def test_a_velocity_of_one_period_a_step_moves_the_midpoint_and_no_end() -> None:
    """Why eq. 20 of the thesis cannot choose between smooth motions and such that swing between samples."""

    def wave(x: Tensor, t: Tensor) -> Tensor:
        return torch.sin(2 * torch.pi * t).expand_as(x)

    x, half = torch.zeros(1, dtype=torch.float64), torch.tensor([0.5], dtype=torch.float64)
    middle = RungeKutta()(wave, x, 0 * half, half)
    assert float(middle) == pytest.approx(1 / 3)
    assert float(RungeKutta()(wave, middle, half, half)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("step", "order"), [(Leapfrog(), 2), (Yoshida(), 4)])
def test_a_symplectic_step_has_its_order_and_turns_back(step: Step, order: int) -> None:
    exact = path(RungeKutta(), swing, [1.0, 0.3], 2.0, 2000)
    coarse, fine = (float((path(step, swing, [1.0, 0.3], 2.0, n) - exact).norm()) for n in (20, 40))
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.3)
    there = path(step, swing, [1.0, 0.3], 2.0, 20)
    assert torch.allclose(path(step, swing, there.tolist(), -2.0, 20), torch.tensor([1.0, 0.3], dtype=torch.float64))


def test_a_symplectic_step_keeps_the_energy_where_runge_kutta_loses_it() -> None:
    def energy(z: Tensor) -> float:
        return float(z[1] ** 2 / 2 + 1 - torch.cos(z[0]))

    start = [2.0, 0.0]
    lost = {step: abs(energy(path(step, swing, start, 1000.0, 2000)) / energy(torch.tensor(start)) - 1)
            for step in (RungeKutta(), Yoshida())}  # fmt: skip
    assert lost[Yoshida()] < 0.02 < 0.1 < lost[RungeKutta()]


def test_steps_are_halved_until_nothing_changes() -> None:
    h = torch.tensor([2.0], dtype=torch.float64)
    start = torch.tensor([1.0, 0.3], dtype=torch.float64)
    exact = path(RungeKutta(), swing, start.tolist(), 2.0, 2000)
    for tolerance in (1e-2, 1e-4, 1e-6):
        found = settled(RungeKutta(), swing, start, 0 * h, h, tolerance)
        assert float((found - exact).abs().max()) < tolerance
