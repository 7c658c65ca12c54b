"""The network that measures one streak closer: from its straightened picture to where it is, with errors."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from detectors.network import convolved
from detectors.straightened import COLUMNS, ROWS

WIDTHS = (16, 32, 64)
"""Channels at a half, a quarter and an eighth of the picture's side."""
HIDDEN = 128
TOLD = ("ahead", "beside", "longer", "aside")
"""What is told of a streak beside the one that was shown, ball radii: see `Straight.told`."""


class Block(nn.Module):
    """Two convolutions beside the identity (He et al. 2015, arXiv:1512.03385)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        last = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.inner = nn.Sequential(convolved(width, width), last, nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, h, w) to the same."""
        out: Tensor = torch.relu(x + self.inner(x))
        return out


class StreakNetwork(nn.Module):
    """Straightened pictures (B, 3, ROWS, COLUMNS) in [0, 1] to (B, 8): TOLD, and the logarithms of their sigmas."""

    def __init__(self) -> None:
        super().__init__()
        half, quarter, eighth = WIDTHS
        self.seen = nn.Sequential(
            convolved(3, half, 5, 2),
            convolved(half, quarter, 3, 2),
            Block(quarter),
            convolved(quarter, eighth, 3, 2),
            Block(eighth),
        )
        cells = eighth * (ROWS // 8) * (COLUMNS // 8)
        self.told = nn.Sequential(nn.Flatten(), nn.Linear(cells, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 2 * len(TOLD)))

    def forward(self, picture: Tensor) -> Tensor:
        """(B, 3, ROWS, COLUMNS) to (B, 8)."""
        out: Tensor = self.told(self.seen((picture - 0.45) * 4))
        return out
