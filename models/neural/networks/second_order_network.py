"""Newton's second law with a network for the acceleration, net(x, v), that does not know the time."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.neural.common.integration_steps import RungeKutta
from models.neural.common.perceptron import Perceptron
from models.neural.networks.neural_flow import LearntFlow, Sizes


class Acceleration(nn.Module):
    """dx/dt = v, dv/dt = net(x, v)."""

    def __init__(self, layers: Perceptron) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, z: Tensor) -> Tensor:
        """(..., 2 C) to its change."""
        _, v = z.chunk(2, dim=-1)
        return torch.cat([v, self.layers(z)], dim=-1)


class Rate(nn.Module):
    """dz/dt = net(z): a plain network that knows nothing of mechanics, the rival of Greydanus 2019."""

    def __init__(self, layers: Perceptron) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, z: Tensor) -> Tensor:
        """(..., 2 C) to its change."""
        found: Tensor = self.layers(z)
        return found


@dataclass(frozen=True, slots=True)
class SecondOrder:
    """The sizes of net(x, v)."""

    widths: tuple[int, ...] = (64, 64, 64)
    activation: type[nn.Module] = nn.Tanh

    def __call__(self, sizes: Sizes, generator: torch.Generator) -> nn.Module:
        """A fresh one."""
        count = sizes.coordinates
        return Acceleration(Perceptron(2 * count, count, self.widths, self.activation, generator))


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """The sizes of a plain network."""

    widths: tuple[int, ...] = (64, 64, 64)
    activation: type[nn.Module] = nn.Tanh

    def __call__(self, sizes: Sizes, generator: torch.Generator) -> nn.Module:
        """A fresh one."""
        count = 2 * sizes.coordinates
        return Rate(Perceptron(count, count, self.widths, self.activation, generator))


SECOND_ORDER = LearntFlow("net(x, v)", SecondOrder(), RungeKutta())
PLAIN_FLOW = LearntFlow("net(x, v), first order", FirstOrder(), RungeKutta())
