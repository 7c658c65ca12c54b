"""Interaction networks (Battaglia et al. 2016, arXiv:1612.00222): accelerations from what passes between points.

One network sees two points, how they lie and move against each other, and sends what it makes of it to the one; another
sees a point, its own state and the sum of what it was sent, and tells its acceleration. Both are the same for all pairs
and all points; what differs between points (their mass, whether one is held) is told by a few learnt numbers for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.neural.common.integration_steps import RungeKutta
from models.neural.common.perceptron import Perceptron
from models.neural.networks.neural_flow import LearntFlow, Sizes

TRAITS = 2
"""learnt numbers that tell one point from another."""
MESSAGE = 16
"""numbers that a pair makes."""


class Interaction(nn.Module):
    """N points in D axes and the E pairs that act, both ways."""

    def __init__(
        self,
        sizes: Sizes,
        pairs: tuple[Tensor, Tensor],
        widths: Sequence[int],
        activation: type[nn.Module],
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        self.points, self.axes = sizes.points, sizes.axes
        self.target, self.source = pairs  # (E,) who hears, and whom
        self.traits = nn.Parameter(torch.randn(sizes.points, TRAITS, generator=generator, dtype=torch.float64))
        state = 2 * sizes.axes
        self.relation = Perceptron(state + 2 * TRAITS, MESSAGE, widths, activation, generator)
        self.answer = Perceptron(state + TRAITS + MESSAGE, sizes.axes, widths, activation, generator)

    def forward(self, z: Tensor) -> Tensor:
        """(B, 2 C) to its change."""
        q, v = (part.reshape(-1, self.points, self.axes) for part in z.chunk(2, dim=-1))
        state = torch.cat([q, v], dim=-1)  # (B, N, 2 D)
        traits = self.traits.expand(len(z), -1, -1)  # (B, N, TRAITS)
        pair = torch.cat(
            [state[:, self.source] - state[:, self.target], traits[:, self.target], traits[:, self.source]], dim=-1
        )  # (B, E, .)
        sent = z.new_zeros(len(z), self.points, MESSAGE).index_add(1, self.target, self.relation(pair))
        pushed = self.answer(torch.cat([state, traits, sent], dim=-1))  # (B, N, D)
        return torch.cat([v.flatten(1), pushed.flatten(1)], dim=-1)


def nearest(q: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """(E,) and (E,): every point of q (T, N, D) and, one after the other, its `count` nearest others."""
    points = q.shape[1]
    apart = torch.stack([torch.cdist(frame, frame) for frame in q]).mean(dim=0)
    apart.fill_diagonal_(torch.inf)
    kept = min(count, points - 1)
    source = apart.topk(kept, largest=False).indices
    return torch.arange(points).repeat_interleave(kept), source.reshape(-1)


@dataclass(frozen=True, slots=True)
class InteractionLaw:
    """The sizes of the two networks."""

    widths: tuple[int, ...] = (32, 32)
    activation: type[nn.Module] = nn.Tanh
    neighbours: int = 8
    """what a point hears at most: those nearest to it, on average over the samples. Time grows with it."""

    def __call__(self, sizes: Sizes, generator: torch.Generator) -> nn.Module:
        """Fresh ones."""
        pairs = nearest(sizes.seen.reshape(-1, sizes.points, sizes.axes), self.neighbours)
        return Interaction(sizes, pairs, self.widths, self.activation, generator)


INTERACTION = LearntFlow("interaction net", InteractionLaw(), RungeKutta())
