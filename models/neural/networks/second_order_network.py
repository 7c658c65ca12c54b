"""Newton's second law with a time-independent network for the acceleration, net(x, v)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from models.neural.common.integration_steps import RungeKuttaStep
from models.neural.common.perceptron import Perceptron
from models.neural.networks.neural_flow import FlowDimensions, NeuralFlowMethod


class AccelerationFlow(nn.Module):
    """Vector field dx/dt = v, dv/dt = net(x, v)."""

    def __init__(self, layers: Perceptron) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, z: Tensor) -> Tensor:
        """Evaluate dz/dt (..., 2 C) at z (..., 2 C)."""
        _, v = z.chunk(2, dim=-1)
        return torch.cat([v, self.layers(z)], dim=-1)


def build_acceleration_flow(
    sizes: FlowDimensions, generator: torch.Generator, widths: Sequence[int] = (64, 64, 64)
) -> nn.Module:
    """Build an untrained net(x, v)."""
    count = sizes.coordinates
    return AccelerationFlow(Perceptron(2 * count, count, widths, nn.Tanh, generator))


def build_first_order_flow(
    sizes: FlowDimensions, generator: torch.Generator, widths: Sequence[int] = (64, 64, 64)
) -> nn.Module:
    """Build an untrained dz/dt = net(z) without any structure of mechanics: the baseline of Greydanus et al. 2019."""
    return Perceptron(2 * sizes.coordinates, 2 * sizes.coordinates, widths, nn.Tanh, generator)


SECOND_ORDER = NeuralFlowMethod("net(x, v)", build_acceleration_flow, RungeKuttaStep())
PLAIN_FLOW = NeuralFlowMethod("net(x, v), first order", build_first_order_flow, RungeKuttaStep())
