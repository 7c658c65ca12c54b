"""Interaction networks (Battaglia et al. 2016, arXiv:1612.00222): accelerations from messages between points.

One network computes a message from the relative position and velocity of two points. Another computes the acceleration
of a point from its own state and the sum of its messages. Both are shared by all pairs and all points. A few learned
traits of each point represent properties such as its mass, or that it is fixed.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from models.neural.common.integration_steps import RungeKuttaStep
from models.neural.common.network_training import Perceptron
from models.neural.networks.neural_flow import FlowDimensions, NeuralFlowMethod

# Learned traits per point.
TRAIT_COUNT = 2
# Components of a message.
MESSAGE_SIZE = 16
# Most senders per point: those nearest to it, on average over the samples. The cost grows with it.
MAX_NEIGHBOURS = 8


class InteractionFlow(nn.Module):
    """Vector field of N points in D axes with E directed pairs."""

    def __init__(
        self, sizes: FlowDimensions, pairs: tuple[Tensor, Tensor], widths: Sequence[int], generator: torch.Generator
    ) -> None:
        super().__init__()
        self.points, self.axes = sizes.points, sizes.axes
        self.target, self.source = pairs  # (E,) receivers and senders
        self.traits = nn.Parameter(torch.randn(sizes.points, TRAIT_COUNT, generator=generator, dtype=torch.float64))
        state = 2 * sizes.axes
        self.relation = Perceptron(state + 2 * TRAIT_COUNT, MESSAGE_SIZE, widths, nn.Tanh, generator)
        self.response = Perceptron(state + TRAIT_COUNT + MESSAGE_SIZE, sizes.axes, widths, nn.Tanh, generator)

    def forward(self, z: Tensor) -> Tensor:
        """Evaluate dz/dt (B, 2 C) at z (B, 2 C)."""
        q, v = (part.reshape(-1, self.points, self.axes) for part in z.chunk(2, dim=-1))
        state = torch.cat([q, v], dim=-1)  # (B, N, 2 D)
        traits = self.traits.expand(len(z), -1, -1)  # (B, N, TRAIT_COUNT)
        pair = torch.cat(
            [state[:, self.source] - state[:, self.target], traits[:, self.target], traits[:, self.source]], dim=-1
        )  # (B, E, .)
        sent = z.new_zeros(len(z), self.points, MESSAGE_SIZE).index_add(1, self.target, self.relation(pair))
        pushed = self.response(torch.cat([state, traits, sent], dim=-1))  # (B, N, D)
        return torch.cat([v.flatten(1), pushed.flatten(1)], dim=-1)


def find_nearest(q: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Find the neighbours of every point.

    Args:
        q: Positions (T, N, D).
        count: Neighbours per point, at most N - 1.

    Returns:
        Receivers (E,) and senders (E,): every point, with each of its nearest others by mean distance.
    """
    points = q.shape[1]
    apart = torch.stack([torch.cdist(frame, frame) for frame in q]).mean(dim=0)
    apart.fill_diagonal_(torch.inf)
    neighbour_count = min(count, points - 1)
    source = apart.topk(neighbour_count, largest=False).indices
    return torch.arange(points).repeat_interleave(neighbour_count), source.reshape(-1)


def build_interaction_flow(
    sizes: FlowDimensions, generator: torch.Generator, widths: Sequence[int] = (32, 32)
) -> nn.Module:
    """Build untrained networks of accelerations and messages."""
    pairs = find_nearest(sizes.samples.reshape(-1, sizes.points, sizes.axes), MAX_NEIGHBOURS)
    return InteractionFlow(sizes, pairs, widths, generator)


INTERACTION = NeuralFlowMethod("interaction net", build_interaction_flow, RungeKuttaStep())
