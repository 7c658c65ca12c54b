"""Integration steps through a vector field: their order is measured."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from models.neural.common.integration_steps import (
    EulerStep,
    IntegrationStep,
    LeapfrogStep,
    RungeKuttaStep,
    VectorField,
    YoshidaStep,
    integrate_steps,
    integrate_to_tolerance,
)


def slope(x: Tensor, t: Tensor) -> Tensor:
    """Evaluate a field whose solution from 1 at time 0 is exp(sin t)."""
    return x * torch.cos(t)


def swing(z: Tensor, t: Tensor) -> Tensor:
    """Evaluate the field of a pendulum, z = (q, p)."""
    q, p = z.chunk(2, dim=-1)
    return torch.cat([p, -torch.sin(q)], dim=-1)


def path(step: IntegrationStep, change: VectorField, start: list[float], span: float, count: int) -> Tensor:
    """Integrate over a duration in equal steps."""
    h = torch.tensor([span / count], dtype=torch.float64)
    return integrate_steps(step, change, torch.tensor(start, dtype=torch.float64), 0 * h, count * h, count)


def error(step: IntegrationStep, count: int) -> float:
    h = torch.tensor([1.0], dtype=torch.float64) / count
    x = torch.ones(1, dtype=torch.float64)
    for k in range(count):
        x = step(slope, x, k * h, h)
    return abs(float(x) - math.exp(math.sin(1.0)))


@pytest.mark.parametrize(
    ("step", "order"), [(EulerStep(), 1), (RungeKuttaStep(), 4), (RungeKuttaStep(time_factor=2.0), 1)]
)
def test_a_step_has_its_order(step: IntegrationStep, order: int) -> None:
    """As printed in the thesis, slopes are evaluated half a step too late, which costs three orders."""
    assert math.log2(error(step, 16) / error(step, 32)) == pytest.approx(order, abs=0.25)


def test_a_velocity_of_one_period_a_step_moves_the_midpoint_and_no_end() -> None:
    """Chen 2022, eq. 20 therefore cannot distinguish smooth motions from motions that oscillate between samples."""

    def wave(x: Tensor, t: Tensor) -> Tensor:
        return torch.sin(2 * torch.pi * t).expand_as(x)

    x, half = torch.zeros(1, dtype=torch.float64), torch.tensor([0.5], dtype=torch.float64)
    middle = RungeKuttaStep()(wave, x, 0 * half, half)
    assert float(middle) == pytest.approx(1 / 3)
    assert float(RungeKuttaStep()(wave, middle, half, half)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("step", "order"), [(LeapfrogStep(), 2), (YoshidaStep(), 4)])
def test_a_symplectic_step_has_its_order_and_turns_back(step: IntegrationStep, order: int) -> None:
    exact = path(RungeKuttaStep(), swing, [1.0, 0.3], 2.0, 2000)
    coarse, fine = (float((path(step, swing, [1.0, 0.3], 2.0, n) - exact).norm()) for n in (20, 40))
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.3)
    there = path(step, swing, [1.0, 0.3], 2.0, 20)
    assert torch.allclose(path(step, swing, there.tolist(), -2.0, 20), torch.tensor([1.0, 0.3], dtype=torch.float64))


def test_a_symplectic_step_keeps_the_energy_where_runge_kutta_loses_it() -> None:
    def energy(z: Tensor) -> float:
        return float(z[1] ** 2 / 2 + 1 - torch.cos(z[0]))

    start = [2.0, 0.0]
    lost = {step: abs(energy(path(step, swing, start, 1000.0, 2000)) / energy(torch.tensor(start)) - 1)
            for step in (RungeKuttaStep(), YoshidaStep())}  # fmt: skip
    assert lost[YoshidaStep()] < 0.02 < 0.1 < lost[RungeKuttaStep()]


def test_steps_are_halved_until_nothing_changes() -> None:
    h = torch.tensor([2.0], dtype=torch.float64)
    start = torch.tensor([1.0, 0.3], dtype=torch.float64)
    exact = path(RungeKuttaStep(), swing, start.tolist(), 2.0, 2000)
    for tolerance in (1e-2, 1e-4, 1e-6):
        state = integrate_to_tolerance(RungeKuttaStep(), swing, start, 0 * h, h, tolerance)
        assert float((state - exact).abs().max()) < tolerance
