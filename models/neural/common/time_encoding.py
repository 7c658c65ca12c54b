"""How a network is told the time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Clock:
    """Time as numbers about 1: as it is, or with waves beside it (Fourier features)."""

    span: float
    """steps from the first sample to the last."""
    shortest: float = math.inf
    """steps: the shortest period of a wave; at 2 and below a network can move midpoints unseen by its loss."""

    @property
    def waves(self) -> int:
        """How many harmonics of the whole series there are."""
        return int(self.span / self.shortest)

    @property
    def width(self) -> int:
        """Numbers that tell one time."""
        return 1 + 2 * self.waves

    def tell(self, t: Tensor) -> Tensor:
        """Times (..., 1) in steps to (..., width)."""
        plain = 2 * t / self.span - 1
        if not self.waves:
            return plain
        angle = math.pi * plain * torch.arange(1, self.waves + 1, dtype=t.dtype)
        return torch.cat([plain, torch.sin(angle), torch.cos(angle)], dim=-1)
