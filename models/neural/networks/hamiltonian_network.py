"""Hamiltonian networks (Greydanus, Dzamba and Yosinski 2019, arXiv:1906.01563): a network for the energy.

dq/dt = dH/dp, dp/dt = -dH/dq. The paper learns H from known dq/dt and dp/dt; here only q is seen, and p is sought with
the network as in `models.neural.networks.neural_flow`. The separable form H = |p|^2 / 2 m + V(q) (Chen et al. 2019, arXiv:1909.13334)
can be stepped by a symplectic rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.neural.common.integration_steps import RungeKutta, Yoshida
from models.neural.common.perceptron import Perceptron
from models.neural.networks.neural_flow import LearntFlow, Sizes


def gradient(layers: nn.Module, z: Tensor) -> Tensor:
    """Of the scalar layers(z) by z (..., K), differentiable where gradients are wanted."""
    wanted = torch.is_grad_enabled()
    with torch.enable_grad():
        at = z if z.requires_grad else z.detach().requires_grad_()
        (found,) = torch.autograd.grad(layers(at).sum(), at, create_graph=wanted)
    return found


class Hamiltonian(nn.Module):
    """H(q, p), any function."""

    def __init__(self, layers: Perceptron) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, z: Tensor) -> Tensor:
        """(..., 2 C) to its change."""
        by_q, by_p = gradient(self.layers, z).chunk(2, dim=-1)
        return torch.cat([by_p, -by_q], dim=-1)


class Separable(nn.Module):
    """H = sum p^2 / 2 m + V(q); the inverse masses are learnt, one a point."""

    def __init__(self, layers: Perceptron, points: int, axes: int) -> None:
        super().__init__()
        self.layers, self.axes = layers, axes
        self.lightness = nn.Parameter(torch.zeros(points, dtype=torch.float64))
        """logarithm of 1 / m"""

    def forward(self, z: Tensor) -> Tensor:
        """(..., 2 C) to its change."""
        q, p = z.chunk(2, dim=-1)
        by_p = p * self.lightness.exp().repeat_interleave(self.axes)
        return torch.cat([by_p, -gradient(self.layers, q)], dim=-1)


@dataclass(frozen=True, slots=True)
class HamiltonianLaw:
    """The sizes of H."""

    widths: tuple[int, ...] = (64, 64)
    activation: type[nn.Module] = nn.Tanh

    def __call__(self, sizes: Sizes, generator: torch.Generator) -> nn.Module:
        """A fresh one."""
        return Hamiltonian(Perceptron(2 * sizes.coordinates, 1, self.widths, self.activation, generator))


@dataclass(frozen=True, slots=True)
class SeparableLaw:
    """The sizes of V."""

    widths: tuple[int, ...] = (64, 64)
    activation: type[nn.Module] = nn.Tanh

    def __call__(self, sizes: Sizes, generator: torch.Generator) -> nn.Module:
        """A fresh one."""
        layers = Perceptron(sizes.coordinates, 1, self.widths, self.activation, generator)
        return Separable(layers, sizes.points, sizes.axes)


HAMILTONIAN = LearntFlow("Hamiltonian net", HamiltonianLaw(), RungeKutta())
SEPARABLE = LearntFlow("Hamiltonian net, symplectic", SeparableLaw(), Yoshida())
