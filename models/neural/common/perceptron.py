"""Fully connected networks, initialised from their own random generator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn


def make_generator(seed: int) -> torch.Generator:
    """Create the random generator of one training.

    Args:
        seed: Random seed.

    Returns:
        A generator that is independent of torch's global one.
    """
    return torch.Generator().manual_seed(seed)


def count_parameters(network: nn.Module) -> int:
    """Count the trainable parameters of a network.

    Args:
        network: Any module.

    Returns:
        Number of scalars.
    """
    return sum(value.numel() for value in network.parameters() if value.requires_grad)


def build_layer(inputs: int, outputs: int, generator: torch.Generator, dtype: torch.dtype) -> nn.Linear:
    """Build a linear layer with weights and biases uniform within 1 / sqrt(inputs), like torch.

    LeCun et al. 1998, doi:10.1007/3-540-49430-8_2.
    """
    linear = nn.Linear(inputs, outputs, dtype=dtype, device="meta").to_empty(device="cpu")  # uses no random numbers
    bound = 1 / math.sqrt(inputs)
    with torch.no_grad():
        linear.weight.uniform_(-bound, bound, generator=generator)
        linear.bias.uniform_(-bound, bound, generator=generator)
    return linear


class Perceptron(nn.Module):
    """Fully connected network with hidden layers of given widths."""

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
            hidden += [build_layer(into, out, generator, dtype), activation()]
        self.last = build_layer(sizes[-1], outputs, generator, dtype)
        self.layers = nn.Sequential(*hidden, self.last)

    def forward(self, x: Tensor) -> Tensor:
        """Map inputs (..., inputs) to outputs (..., outputs)."""
        outputs: Tensor = self.layers(x)
        return outputs
