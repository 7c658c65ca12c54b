"""The networks of the detector in torch, and their losses.

The ball network is fully convolutional, with one output cell per 4 x 4 px of the working image. Centres are the peaks
of a map; offset, size and the rest are read at the peak (Zhou et al. 2019, CenterNet, arXiv:1904.07850). The blocks are
depthwise (Howard et al. 2017, arXiv:1704.04861). A stem with strides does most of the work
at a sixteenth and a sixty-fourth of the pixels: 2.8 thousand multiplications a pixel in all.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from detectors.network.offset_regressor import OffsetRegressorKind
from detectors.network.peak_decoding import CHANNELS, LOG_SIGMA_LIMITS, RADIUS_UNIT_PX, STREAK_UNIT_PX, STRIDE

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


FIRST_APPEARANCE_CHANNEL = CHANNELS.index("white")
# Visible share of a ball from which it must be detected; otherwise detection is optional.
CLEAR_SHARE = 0.4
# Least radius of a ball that must be detected; smaller ones, far away in a low view, are optional.
MIN_RADIUS_PX = 3.3
# Standard deviation of a peak in the score's target.
PEAK_RADII, MIN_PEAK_PX = 0.3, 2.2
# Addition to it along a streak, share of its length: the middle of a streak is less precise.
STREAK_PEAK_SHARE = 0.08
# Distance from the middle of a streak within which the target of the score is 1: along it this share of its length and
# the px, across it the px. The image does not determine a single cell, which would get a low score.
STREAK_PLATEAU_SHARE, STREAK_PLATEAU_PX = 0.12, 2.0
# Radius about a ball whose detection is optional, ball radii, within which the score does not count.
IGNORED_RADII = 1.0
# Length of a streak up to which it has no direction.
SHARP_PX = 1.0
# Additional weight of the streak of a moving ball; balls at rest are much more frequent.
STREAK_WEIGHT = 10.0
# Offsets of the cells about a ball's centre, from the one to the left and above, that learn its position and size:
# wherever the peak is, also that of two balls that look like one, the cell must give the offset to the centre.
CELL_OFFSETS = (-1, 0, 1, 2)
# Weight of such a cell besides the four around the centre, and distance, ball radii, within which it has it.
NEAR_SHARE, NEAR_RADII = 0.25, 0.6
# Standard deviations from which an error counts linearly (Huber 1964, doi:10.1214/aoms/1177703732).
HUBER_THRESHOLD = 2.5


@dataclass(frozen=True, slots=True)
class BallTargets:
    """Targets for B images with N balls each; h, w cells."""

    score: Tensor
    """(B, h, w) in [0, 1], 1 at a centre."""
    counted: Tensor
    """(B, h, w) 0 where the score does not count."""
    weight: Tensor
    """(K,) weight of a cell for the ball that it describes."""
    cell: Tensor
    """(K,) flat index of the cell into (B, h, w)."""
    ball: Tensor
    """(K, 7) the ball, columns as in `training_shards.COLUMNS`."""


def build_targets(balls: Tensor, side: int) -> BallTargets:
    """Build the targets for balls.

    Args:
        balls: Balls (B, N, 7), rows of NaN for none.
        side: Side of the images, px.

    Returns:
        The targets.
    """
    cells = side // STRIDE
    there = ~torch.isnan(balls[..., 0])
    balls = torch.nan_to_num(balls)
    clear = there & (balls[..., 6] >= CLEAR_SHARE) & (balls[..., 2] >= MIN_RADIUS_PX)
    grid = (torch.arange(cells) + 0.5) * STRIDE - 0.5
    dx = grid[None, None, None, :] - balls[..., 0, None, None]  # (B, N, 1, w)
    dy = grid[None, None, :, None] - balls[..., 1, None, None]  # (B, N, h, 1)
    peaks = _render_peaks(balls, dx, dy) * clear[..., None, None]
    score = peaks.amax(dim=1)
    weight, cell = _cells_around(balls, cells)  # (B, N, 16)
    weight = weight * clear[..., None]
    nearest = cell.gather(2, weight.argmax(dim=2, keepdim=True))[..., 0]
    score.flatten(1).scatter_reduce_(1, nearest, clear.float(), "amax")
    free = (there & ~clear)[..., None, None] & (dx**2 + dy**2 < (IGNORED_RADII * balls[..., 2, None, None]) ** 2)
    counted = (~free.any(dim=1) | (score > 0.6)).float()
    image, ball, which = torch.nonzero(weight, as_tuple=True)
    flat = image * cells**2 + cell[image, ball, which]
    return BallTargets(score, counted, weight[image, ball, which], flat, balls[image, ball])


def _render_peaks(balls: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    """Render Gaussians (B, N, h, w), longer along streaks."""
    length, along = _streak_direction(balls)
    length = length[..., None, None]
    sigma = torch.clamp(PEAK_RADII * balls[..., 2], min=MIN_PEAK_PX)[..., None, None]
    ahead = dx * along[..., 0, None, None] + dy * along[..., 1, None, None]
    beside = dy * along[..., 0, None, None] - dx * along[..., 1, None, None]
    peaks = torch.exp(-0.5 * ((ahead / (sigma + STREAK_PEAK_SHARE * length)) ** 2 + (beside / sigma) ** 2))
    middle = (ahead.abs() < STREAK_PLATEAU_PX + STREAK_PLATEAU_SHARE * length) & (beside.abs() < STREAK_PLATEAU_PX)
    return peaks.masked_fill(middle & (length > 2 * SHARP_PX), 1.0)


def _streak_direction(balls: Tensor) -> tuple[Tensor, Tensor]:
    """Length (...) px and unit vector (..., 2) of the streaks of balls (..., 7); (1, 0) for sharp ones."""
    streak = balls[..., 3:5]
    length = streak.norm(dim=-1)
    flat = torch.tensor([1.0, 0.0]).expand_as(streak)
    return length, torch.where(length[..., None] > SHARP_PX, streak / length.clamp(min=1e-6)[..., None], flat)


def _cells_around(balls: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Weights and flat indices (B, N, 16) of the cells around the centres; weight 0 outside the image."""
    at = (balls[..., :2] + 0.5) / STRIDE - 0.5
    low = at.floor()
    far = NEAR_RADII * balls[..., 2] + STREAK_PLATEAU_SHARE * balls[..., 3:5].norm(dim=-1)
    reach = (far / STRIDE)[..., None]  # (B, N, 1) cells
    weights, indices = [], []
    for below in CELL_OFFSETS:
        for right in CELL_OFFSETS:
            cell = low + torch.tensor([right, below])
            inside = ((cell >= 0) & (cell < cells)).all(dim=-1)
            off = cell - at
            bilinear = (1 - off.abs()).clamp(min=0).prod(dim=-1)
            near = NEAR_SHARE * (off.norm(dim=-1) < reach[..., 0])
            weights.append(torch.maximum(bilinear, near) * inside)
            x, y = cell.clamp(0, cells - 1).unbind(dim=-1)
            indices.append((y * cells + x).long())
    return torch.stack(weights, dim=-1), torch.stack(indices, dim=-1)


def compute_ball_loss(maps: Tensor, targets: BallTargets) -> tuple[Tensor, dict[str, float]]:
    """Compute the loss of maps.

    Args:
        maps: Maps (B, 12, h, w).
        targets: Their targets.

    Returns:
        The loss, and its parts by name.
    """
    cells = maps.shape[-1]
    at = maps.movedim(1, -1).reshape(-1, maps.shape[1])[targets.cell]  # (K, 12)
    ball, weight = targets.ball, targets.weight / targets.weight.sum().clamp(min=1.0)
    place = targets.cell % cells**2
    middle = (torch.stack([place % cells, place // cells], dim=-1).float() + 0.5) * STRIDE - 0.5
    smooth, entropy = torch.nn.functional.smooth_l1_loss, torch.nn.functional.cross_entropy
    radius = torch.log(ball[:, 2] / RADIUS_UNIT_PX)
    rare = 1 + STREAK_WEIGHT * (ball[:, 3:5].norm(dim=-1) > 2 * SHARP_PX).float()
    off = smooth(at[:, 4:6], encode_streaks(ball[:, 3:5]), reduction="none", beta=0.3).sum(-1)
    appearance_loss = entropy(at[:, FIRST_APPEARANCE_CHANNEL:], ball[:, 5].long(), reduction="none")
    parts = {
        "score": _score_loss(maps[:, 0], targets),
        "centre": (weight * _centre_loss(middle + STRIDE * at[:, 1:3] - ball[:, :2], at, ball)).sum(),
        "radius": 3 * (weight * smooth(at[:, 3], radius, reduction="none", beta=0.1)).sum(),
        "streak": (weight * rare * off).sum(),
        "look": 0.3 * (weight * appearance_loss).sum(),
    }
    loss = torch.stack(list(parts.values())).sum()
    return loss, {name: float(part.detach()) for name, part in parts.items()}


def huber_penalty(pull: Tensor) -> Tensor:
    """Huber's penalty of errors in standard deviations.

    Args:
        pull: Absolute errors (...) over their sigmas.

    Returns:
        Penalties (...).
    """
    return torch.where(pull < HUBER_THRESHOLD, 0.5 * pull**2, HUBER_THRESHOLD * pull - 0.5 * HUBER_THRESHOLD**2)


def encode_streaks(streak: Tensor) -> Tensor:
    """Encode streaks (..., 2) px as in the maps: length times cosine and sine of twice the angle, STREAK_UNIT_PX."""
    x, y = streak[..., 0], streak[..., 1]
    length = torch.hypot(x, y).clamp(min=1e-6)
    return torch.stack([(x**2 - y**2) / length, 2 * x * y / length], dim=-1) / STREAK_UNIT_PX


def _score_loss(logit: Tensor, targets: BallTargets) -> Tensor:
    """Focal loss with soft neighbours (Law and Deng 2018, arXiv:1808.01244, eq. 1), per ball."""
    probability = torch.sigmoid(logit).clamp(1e-6, 1 - 1e-6)
    is_centre = (targets.score > 0.999).float()
    missed = -is_centre * (1 - probability) ** 2 * torch.log(probability)
    wrong = -(1 - is_centre) * (1 - targets.score) ** 4 * probability**2 * torch.log(1 - probability)
    return ((missed + wrong) * targets.counted).sum() / is_centre.sum().clamp(min=1.0)


def _centre_loss(error: Tensor, at: Tensor, ball: Tensor) -> Tensor:
    """Negative log likelihood (K,) of errors (K, 2) px of the centres, by the sigmas across and along the streaks."""
    _, along = _streak_direction(ball)
    ahead = (error * along).sum(-1)
    beside = error[:, 1] * along[:, 0] - error[:, 0] * along[:, 1]
    total = torch.zeros_like(ahead)
    for off, channel in ((beside, 6), (ahead, 7)):
        log_sigma = at[:, channel].clamp(*LOG_SIGMA_LIMITS)
        z = (off / log_sigma.exp()).abs()
        total = total + huber_penalty(z) + log_sigma
    return total


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
