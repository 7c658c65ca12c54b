"""Networks that measure one thing closer: a small picture of it tells how far off it is from where it was thought."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from detectors.network.peak_decoding import SIGMA_LIMITS
from detectors.training.networks.ball_network import convolved
from detectors.training.networks.training_loss import HUBER

HIDDEN = 128


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


class MeasuringNetwork(nn.Module):
    """Pictures (B, 3, rows, columns) in [0, 1], sides multiples of 8, to (B, 2 n): n numbers, and their log sigmas."""

    def __init__(self, rows: int, columns: int, widths: tuple[int, int, int], told: tuple[str, ...]) -> None:
        """`widths` are the channels at a half, a quarter and an eighth of the sides; `told` names the numbers."""
        super().__init__()
        self.names = told
        half, quarter, eighth = widths
        self.seen = nn.Sequential(
            convolved(3, half, 5, 2),
            convolved(half, quarter, 3, 2),
            Block(quarter),
            convolved(quarter, eighth, 3, 2),
            Block(eighth),
        )
        cells = eighth * (rows // 8) * (columns // 8)
        self.told = nn.Sequential(nn.Flatten(), nn.Linear(cells, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 2 * len(told)))

    def forward(self, picture: Tensor) -> Tensor:
        """(B, 3, rows, columns) to (B, 2 n)."""
        out: Tensor = self.told(self.seen((picture - 0.45) * 4))
        return out


def measuring_loss(said: Tensor, told: Tensor, names: tuple[str, ...]) -> tuple[Tensor, dict[str, float]]:
    """Negative log likelihood, with Huber's tails, of what is true (B, n) by what is said (B, 2 n); and its parts."""
    width = said[:, len(names) :].clamp(*SIGMA_LIMITS)
    pull = ((told - said[:, : len(names)]) * torch.exp(-width)).abs()
    missed = torch.where(pull < HUBER, 0.5 * pull**2, HUBER * pull - 0.5 * HUBER**2)
    each = (missed + width).mean(dim=0)
    return each.sum(), dict(zip(names, each.tolist(), strict=True))
