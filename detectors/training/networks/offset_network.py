"""The torch network of an offset regressor, and its loss."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from detectors.network.offset_regressor import OffsetRegressorKind
from detectors.network.peak_decoding import LOG_SIGMA_LIMITS
from detectors.training.networks.ball_loss import huber_penalty
from detectors.training.networks.ball_network import build_convolution

HIDDEN_UNITS = 128


class ResidualBlock(nn.Module):
    """Two convolutions beside the identity (He et al. 2015, arXiv:1512.03385)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        last = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.inner = nn.Sequential(build_convolution(width, width), last, nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, h, w) to the same shape."""
        out: Tensor = torch.relu(x + self.inner(x))
        return out


class OffsetNetwork(nn.Module):
    """Crops (B, 3, rows, columns) in [0, 1], sides multiples of 8, to (B, 2 n): n offsets, and their log sigmas.

    The attribute names `seen` and `told` stand in checkpoints and exported files.
    """

    def __init__(self, kind: OffsetRegressorKind) -> None:
        super().__init__()
        self.kind = kind
        half, quarter, eighth = kind.widths
        self.seen = nn.Sequential(
            build_convolution(3, half, 5, 2),
            build_convolution(half, quarter, 3, 2),
            ResidualBlock(quarter),
            build_convolution(quarter, eighth, 3, 2),
            ResidualBlock(eighth),
        )
        cells = eighth * (kind.rows // 8) * (kind.columns // 8)
        outputs = 2 * len(kind.outputs)
        self.told = nn.Sequential(
            nn.Flatten(), nn.Linear(cells, HIDDEN_UNITS), nn.ReLU(), nn.Linear(HIDDEN_UNITS, outputs)
        )

    def forward(self, crops: Tensor) -> Tensor:
        """Map crops (B, 3, rows, columns) to (B, 2 n)."""
        out: Tensor = self.told(self.seen((crops - 0.45) * 4))
        return out


def offset_loss(outputs: Tensor, offsets: Tensor, names: tuple[str, ...]) -> tuple[Tensor, dict[str, float]]:
    """Compute the negative log likelihood of true offsets, with the tails of Huber's loss.

    Args:
        outputs: Outputs (B, 2 n) of the network.
        offsets: True offsets (B, n), ball radii.
        names: Names of the n offsets.

    Returns:
        The loss, and its part for each offset by name.
    """
    log_sigma = outputs[:, len(names) :].clamp(*LOG_SIGMA_LIMITS)
    pull = ((offsets - outputs[:, : len(names)]) * torch.exp(-log_sigma)).abs()
    parts = (huber_penalty(pull) + log_sigma).mean(dim=0)
    return parts.sum(), dict(zip(names, parts.tolist(), strict=True))
