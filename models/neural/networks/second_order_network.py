"""Newton's second law with a time-independent network for the acceleration, net(x, v)."""

from __future__ import annotations

from dataclasses import dataclass

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


class FirstOrderFlow(nn.Module):
    """Vector field dz/dt = net(z) without any structure of mechanics: the baseline of Greydanus et al. 2019."""

    def __init__(self, layers: Perceptron) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, z: Tensor) -> Tensor:
        """Evaluate dz/dt (..., 2 C) at z (..., 2 C)."""
        derivative: Tensor = self.layers(z)
        return derivative


@dataclass(frozen=True, slots=True)
class SecondOrderArchitecture:
    """Architecture of net(x, v)."""

    widths: tuple[int, ...] = (64, 64, 64)
    activation: type[nn.Module] = nn.Tanh

    def __call__(self, sizes: FlowDimensions, generator: torch.Generator) -> nn.Module:
        """Build an untrained network."""
        count = sizes.coordinates
        return AccelerationFlow(Perceptron(2 * count, count, self.widths, self.activation, generator))


@dataclass(frozen=True, slots=True)
class FirstOrderArchitecture:
    """Architecture of net(z)."""

    widths: tuple[int, ...] = (64, 64, 64)
    activation: type[nn.Module] = nn.Tanh

    def __call__(self, sizes: FlowDimensions, generator: torch.Generator) -> nn.Module:
        """Build an untrained network."""
        count = 2 * sizes.coordinates
        return FirstOrderFlow(Perceptron(count, count, self.widths, self.activation, generator))


SECOND_ORDER = NeuralFlowMethod("net(x, v)", SecondOrderArchitecture(), RungeKuttaStep())
PLAIN_FLOW = NeuralFlowMethod("net(x, v), first order", FirstOrderArchitecture(), RungeKuttaStep())
