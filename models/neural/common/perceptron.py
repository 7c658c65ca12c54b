"""Fully connected networks, seeded without touching anybody else's randomness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn


def seeded(seed: int) -> torch.Generator:
    """Randomness of one training."""
    return torch.Generator().manual_seed(seed)


def count_parameters(network: nn.Module) -> int:
    """Numbers that training changes."""
    return sum(value.numel() for value in network.parameters() if value.requires_grad)


def layer(inputs: int, outputs: int, generator: torch.Generator, dtype: torch.dtype) -> nn.Linear:
    """Weights and biases uniform within 1 / sqrt(inputs): LeCun et al. 1998 (doi 10.1007/3-540-49430-8_2), as torch."""
    found = nn.Linear(inputs, outputs, dtype=dtype, device="meta").to_empty(device="cpu")  # draws nothing
    bound = 1 / math.sqrt(inputs)
    with torch.no_grad():
        found.weight.uniform_(-bound, bound, generator=generator)
        found.bias.uniform_(-bound, bound, generator=generator)
    return found


class Perceptron(nn.Module):
    """Layers of the given widths with an activation between them."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        widths: Sequence[int],
        activation: type[nn.Module],
        generator: torch.Generator,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        super().__init__()
        sizes = (inputs, *widths)
        hidden: list[nn.Module] = []
        for into, out in pairwise(sizes):
            hidden += [layer(into, out, generator, dtype), activation()]
        self.last = layer(sizes[-1], outputs, generator, dtype)
        self.layers = nn.Sequential(*hidden, self.last)

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) to (..., outputs)."""
        found: Tensor = self.layers(x)
        return found
