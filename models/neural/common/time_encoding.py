"""Encoding of time as input of a network."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class TimeEncoding:
    """Time scaled to -1 to 1, optionally with Fourier features."""

    span: float
    """Steps from the first sample to the last."""
    shortest_period: float = math.inf
    """Shortest period of a Fourier feature, in steps. At periods of 2 and below, a network can move midpoints without
    changing its loss."""

    @property
    def harmonic_count(self) -> int:
        """Number of harmonics of the whole series."""
        return int(self.span / self.shortest_period)

    @property
    def width(self) -> int:
        """Number of inputs that encode one time."""
        return 1 + 2 * self.harmonic_count

    def encode(self, t: Tensor) -> Tensor:
        """Encode times (..., 1) in steps as inputs (..., width)."""
        plain = 2 * t / self.span - 1
        if not self.harmonic_count:
            return plain
        angle = math.pi * plain * torch.arange(1, self.harmonic_count + 1, dtype=t.dtype)
        return torch.cat([plain, torch.sin(angle), torch.cos(angle)], dim=-1)
