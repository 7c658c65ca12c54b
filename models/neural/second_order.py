"""Newton's second law with a network for the acceleration, net(x, v), that does not know the time."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from models.neural.flow import Law, LearntFlow, Sizes
from models.neural.perceptron import Activation, Perceptron
from models.neural.steps import runge_kutta


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


def acceleration(widths: Sequence[int] = (64, 64, 64), activation: Activation = nn.Tanh) -> Law:
    """A law with a network of these layers."""

    def law(sizes: Sizes, generator: torch.Generator) -> nn.Module:
        count = sizes.coordinates
        return Acceleration(Perceptron(2 * count, count, widths, activation, generator))

    return law


def rate(widths: Sequence[int] = (64, 64, 64), activation: Activation = nn.Tanh) -> Law:
    """As `acceleration`, for the whole change of the state."""

    def law(sizes: Sizes, generator: torch.Generator) -> nn.Module:
        count = 2 * sizes.coordinates
        return Rate(Perceptron(count, count, widths, activation, generator))

    return law


SECOND_ORDER = LearntFlow("net(x, v)", acceleration(), runge_kutta)
PLAIN_FLOW = LearntFlow("net(x, v), first order", rate(), runge_kutta)
