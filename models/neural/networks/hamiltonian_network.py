"""Hamiltonian networks (Greydanus, Dzamba and Yosinski 2019, arXiv:1906.01563): a network for the energy.

dq/dt = dH/dp, dp/dt = -dH/dq. The paper trains H on given dq/dt and dp/dt. Here only q is observed, and p is estimated
together with the network (`models.neural.networks.neural_flow`). The separable form H = |p|^2 / 2 m + V(q)
(Chen et al. 2019, arXiv:1909.13334) allows symplectic steps.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from models.neural.common.integration_steps import RungeKuttaStep, YoshidaStep
from models.neural.common.network_training import Perceptron
from models.neural.networks.neural_flow import FlowDimensions, NeuralFlowMethod


def evaluate_gradient(layers: nn.Module, z: Tensor) -> Tensor:
    """Evaluate the gradient of the scalar network layers(z) at z (..., M).

    The result is differentiable if gradients are enabled.
    """
    wanted = torch.is_grad_enabled()
    with torch.enable_grad():
        at = z if z.requires_grad else z.detach().requires_grad_()
        (derivative,) = torch.autograd.grad(layers(at).sum(), at, create_graph=wanted)
    return derivative


class HamiltonianFlow(nn.Module):
    """Vector field of a general Hamiltonian H(q, p)."""

    def __init__(self, layers: Perceptron) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, z: Tensor) -> Tensor:
        """Evaluate dz/dt (..., 2 C) at z (..., 2 C)."""
        by_q, by_p = evaluate_gradient(self.layers, z).chunk(2, dim=-1)
        return torch.cat([by_p, -by_q], dim=-1)


class SeparableHamiltonianFlow(nn.Module):
    """Vector field of H = sum p^2 / 2 m + V(q), with one learned inverse mass per point."""

    def __init__(self, layers: Perceptron, points: int, axes: int) -> None:
        super().__init__()
        self.layers, self.axes = layers, axes
        self.log_inverse_mass = nn.Parameter(torch.zeros(points, dtype=torch.float64))
        """Logarithm of 1 / m."""

    def forward(self, z: Tensor) -> Tensor:
        """Evaluate dz/dt (..., 2 C) at z (..., 2 C)."""
        q, p = z.chunk(2, dim=-1)
        by_p = p * self.log_inverse_mass.exp().repeat_interleave(self.axes)
        return torch.cat([by_p, -evaluate_gradient(self.layers, q)], dim=-1)


def build_hamiltonian_flow(
    sizes: FlowDimensions, generator: torch.Generator, widths: Sequence[int] = (64, 64)
) -> nn.Module:
    """Build an untrained network for H."""
    return HamiltonianFlow(Perceptron(2 * sizes.coordinates, 1, widths, nn.Tanh, generator))


def build_separable_flow(
    sizes: FlowDimensions, generator: torch.Generator, widths: Sequence[int] = (64, 64)
) -> nn.Module:
    """Build an untrained network for V."""
    layers = Perceptron(sizes.coordinates, 1, widths, nn.Tanh, generator)
    return SeparableHamiltonianFlow(layers, sizes.points, sizes.axes)


HAMILTONIAN = NeuralFlowMethod("Hamiltonian net", build_hamiltonian_flow, RungeKuttaStep())
SEPARABLE = NeuralFlowMethod("Hamiltonian net, symplectic", build_separable_flow, YoshidaStep())
