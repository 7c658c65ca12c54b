"""The ball network: fully convolutional, one output cell per 4 x 4 px of the working image.

Centres as peaks of a map, with offset, size and the rest read at the peak (Zhou et al. 2019, CenterNet,
arXiv:1904.07850); depthwise blocks (Howard et al. 2017, arXiv:1704.04861). A stem with strides does most of the work
at a sixteenth and a sixty-fourth of the pixels: 2.8 thousand multiplications a pixel in all.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from detectors.network.peak_decoding import CHANNELS

# Channels at a half, a quarter and an eighth of the image's side.
CHANNEL_WIDTHS = (16, 28, 64)
# Number of blocks at an eighth; each enlarges the receptive field by 32 px.
BLOCK_COUNT = 6
# Initial logit of the score: one cell in a hundred is a centre (Lin et al. 2017, arXiv:1708.02002).
INITIAL_SCORE_LOGIT = -4.6


def build_convolution(into: int, out: int, side: int = 3, stride: int = 1, groups: int = 1) -> nn.Sequential:
    """Build a convolution with batch normalisation and ReLU."""
    conv = nn.Conv2d(into, out, side, stride, side // 2, groups=groups, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(out), nn.ReLU(inplace=True))


class DepthwiseBlock(nn.Module):
    """A depthwise 5 x 5 and two pointwise convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(
            build_convolution(width, width, side=5, groups=width),
            build_convolution(width, 2 * width, side=1),
            nn.Conv2d(2 * width, width, 1, bias=False),
            nn.BatchNorm2d(width),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, h, w) to the same shape."""
        out: Tensor = torch.relu(x + self.inner(x))
        return out


class BallNetwork(nn.Module):
    """Images (B, 3, H, W) in [0, 1] to maps (B, 12, H / 4, W / 4), channels as in CHANNELS."""

    def __init__(self) -> None:
        super().__init__()
        half, quarter, eighth = CHANNEL_WIDTHS
        self.stem = nn.Sequential(build_convolution(3, half, stride=2), build_convolution(half, quarter, stride=2))
        self.down = build_convolution(quarter, eighth, stride=2)
        self.blocks = nn.Sequential(*(DepthwiseBlock(eighth) for _ in range(BLOCK_COUNT)))
        self.side = nn.Conv2d(quarter, quarter, 1, bias=False)
        self.up = nn.Conv2d(eighth, quarter, 1, bias=False)
        self.merge = nn.Sequential(nn.BatchNorm2d(quarter), nn.ReLU(inplace=True), build_convolution(quarter, quarter))
        self.head = nn.Conv2d(quarter, len(CHANNELS), 1)
        start = torch.zeros(len(CHANNELS))
        start[CHANNELS.index("score")] = INITIAL_SCORE_LOGIT
        self.head.bias = nn.Parameter(start)
        nn.init.normal_(self.head.weight, std=0.01)

    def forward(self, image: Tensor) -> Tensor:
        """Map images (B, 3, H, W) to maps (B, 12, H / 4, W / 4)."""
        near = self.stem((image - 0.45) * 4)  # (B, 28, H / 4, W / 4)
        far = self.up(self.blocks(self.down(near)))  # (B, 28, H / 8, W / 8)
        far = nn.functional.interpolate(far, scale_factor=2.0, mode="nearest")
        maps: Tensor = self.head(self.merge(self.side(near) + far))
        return maps
