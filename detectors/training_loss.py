"""What the network's maps should be for balls that are known, and how far they are from it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from detectors.centres import CHANNELS, RADIUS_UNIT_PX, SIGMA_LIMITS, STREAK_UNIT_PX, STRIDE

LOOK = CHANNELS.index("white")
CLEAR_SHARE = 0.4
"""Visible share of a ball from which it must be found; hidden further, it may be found or not."""
LEAST_RADIUS_PX = 3.3
"""Smaller balls, far away in a low view, may be found or not."""
PEAK_RADII, LEAST_PEAK_PX = 0.3, 2.2
"""Standard deviation of a peak in the score's target."""
STREAK_PEAK_SHARE = 0.08
"""The same along a streak in addition, share of its length: its middle is less sharply placed."""
IGNORED_RADII = 1.0
"""About a ball that may be found or not, the score is free within this."""
SHARP_PX = 1.0
"""A shorter streak has no direction."""
STREAK_WORTH = 10.0
"""What the streak of a moving ball counts beyond that of a ball at rest, of which there are many more."""
HUBER = 2.5
"""Standard deviations from which a miss counts linearly (Huber 1964, doi:10.1214/aoms/1177703732)."""


@dataclass(frozen=True, slots=True)
class Targets:
    """Of B pictures with N balls each; h, w cells."""

    score: Tensor
    """(B, h, w) in [0, 1], 1 at a centre."""
    counted: Tensor
    """(B, h, w) 0 where the score is free."""
    weight: Tensor
    """(B, N, 4) of the four cells around every centre, bilinear, 0 for balls that are not there."""
    cell: Tensor
    """(B, N, 4) flat index of those cells."""
    balls: Tensor
    """(B, N, 7) columns of `training_data.COLUMNS`, 0 for none."""


def targets_of(balls: Tensor, side: int) -> Targets:
    """Targets for balls (B, N, 7), rows of NaN for none, in pictures of `side` px."""
    cells = side // STRIDE
    there = ~torch.isnan(balls[..., 0])
    balls = torch.nan_to_num(balls)
    clear = there & (balls[..., 6] >= CLEAR_SHARE) & (balls[..., 2] >= LEAST_RADIUS_PX)
    grid = (torch.arange(cells) + 0.5) * STRIDE - 0.5
    dx = grid[None, None, None, :] - balls[..., 0, None, None]  # (B, N, 1, w)
    dy = grid[None, None, :, None] - balls[..., 1, None, None]  # (B, N, h, 1)
    peaks = _peaks(balls, dx, dy) * clear[..., None, None]
    score = peaks.amax(dim=1)
    weight, cell = _around(balls, cells)
    weight = weight * clear[..., None]
    nearest = cell.gather(2, weight.argmax(dim=2, keepdim=True))[..., 0]
    score.flatten(1).scatter_reduce_(1, nearest, clear.float(), "amax")
    free = (there & ~clear)[..., None, None] & (dx**2 + dy**2 < (IGNORED_RADII * balls[..., 2, None, None]) ** 2)
    counted = (~free.any(dim=1) | (score > 0.6)).float()
    return Targets(score, counted, weight, cell, balls)


def _peaks(balls: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    """Gaussians (B, N, h, w), longer along streaks."""
    length, along = _direction(balls)
    sigma = torch.clamp(PEAK_RADII * balls[..., 2], min=LEAST_PEAK_PX)[..., None, None]
    longer = sigma + STREAK_PEAK_SHARE * length[..., None, None]
    ahead = dx * along[..., 0, None, None] + dy * along[..., 1, None, None]
    beside = dy * along[..., 0, None, None] - dx * along[..., 1, None, None]
    return torch.exp(-0.5 * ((ahead / longer) ** 2 + (beside / sigma) ** 2))


def _direction(balls: Tensor) -> tuple[Tensor, Tensor]:
    """Length (B, N) px and unit vector (B, N, 2) of the streaks; (1, 0) for sharp balls."""
    streak = balls[..., 3:5]
    length = streak.norm(dim=-1)
    flat = torch.tensor([1.0, 0.0]).expand_as(streak)
    return length, torch.where(length[..., None] > SHARP_PX, streak / length.clamp(min=1e-6)[..., None], flat)


def _around(balls: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Bilinear weights and flat indices (B, N, 4) of the cells around the centres; weight 0 outside the picture."""
    at = (balls[..., :2] + 0.5) / STRIDE - 0.5
    low = at.floor()
    share = at - low
    weights, indices = [], []
    for right in (0, 1):
        for below in (0, 1):
            x, y = low[..., 0] + right, low[..., 1] + below
            inside = (x >= 0) & (x < cells) & (y >= 0) & (y < cells)
            wx = share[..., 0] if right else 1 - share[..., 0]
            wy = share[..., 1] if below else 1 - share[..., 1]
            weights.append(wx * wy * inside)
            indices.append((y.clamp(0, cells - 1) * cells + x.clamp(0, cells - 1)).long())
    return torch.stack(weights, dim=-1), torch.stack(indices, dim=-1)


def loss_of(maps: Tensor, targets: Targets) -> tuple[Tensor, dict[str, float]]:
    """Loss of maps (B, 12, h, w), and its parts."""
    parts = {"score": _score_loss(maps[:, 0], targets)}
    at, weight = _read(maps, targets)  # (B, N, 4, 12), (B, N, 4)
    total = weight.sum().clamp(min=1.0)
    cells = maps.shape[-1]
    column, row = targets.cell % cells, targets.cell // cells
    middle = (torch.stack([column, row], dim=-1).float() + 0.5) * STRIDE - 0.5
    miss = middle + STRIDE * at[..., 1:3] - targets.balls[:, :, None, :2]
    parts["centre"] = (weight * _centre_loss(miss, at, targets.balls)).sum() / total
    radius = torch.log(targets.balls[..., 2].clamp(min=0.1) / RADIUS_UNIT_PX)[..., None]
    parts["radius"] = (
        3
        * (
            weight
            * torch.nn.functional.smooth_l1_loss(at[..., 3], radius.expand_as(weight), reduction="none", beta=0.1)
        ).sum()
        / total
    )
    streak = doubled(targets.balls[..., 3:5])[:, :, None].expand(*weight.shape, 2)
    rare = 1 + STREAK_WORTH * (targets.balls[..., 3:5].norm(dim=-1) > 2 * SHARP_PX).float()[..., None]
    off = torch.nn.functional.smooth_l1_loss(at[..., 4:6], streak, reduction="none", beta=0.3).sum(-1)
    parts["streak"] = (weight * rare * off).sum() / total
    look = targets.balls[..., 5].long()[..., None].expand_as(weight)
    given = torch.nn.functional.cross_entropy(at[..., LOOK:].flatten(0, 2), look.flatten(), reduction="none")
    parts["look"] = 0.3 * (weight.flatten() * given).sum() / total
    loss = torch.stack(list(parts.values())).sum()
    return loss, {name: float(part.detach()) for name, part in parts.items()}


def doubled(streak: Tensor) -> Tensor:
    """Streaks (..., 2) px to the maps' form: their length times cos and sin of twice the angle, in units."""
    x, y = streak[..., 0], streak[..., 1]
    length = torch.hypot(x, y).clamp(min=1e-6)
    return torch.stack([(x**2 - y**2) / length, 2 * x * y / length], dim=-1) / STREAK_UNIT_PX


def _read(maps: Tensor, targets: Targets) -> tuple[Tensor, Tensor]:
    """Channels (B, N, 4, 12) of the cells around every centre, with their weights (B, N, 4)."""
    flat = maps.flatten(2).transpose(1, 2)  # (B, hw, 12)
    b, n, _ = targets.cell.shape
    index = targets.cell.reshape(b, -1, 1).expand(-1, -1, maps.shape[1])
    return flat.gather(1, index).reshape(b, n, 4, maps.shape[1]), targets.weight


def _score_loss(logit: Tensor, targets: Targets) -> Tensor:
    """Focal loss with soft neighbours (Law and Deng 2018, arXiv:1808.01244, eq. 1), per ball."""
    probability = torch.sigmoid(logit).clamp(1e-6, 1 - 1e-6)
    found = (targets.score > 0.999).float()
    missed = -found * (1 - probability) ** 2 * torch.log(probability)
    wrong = -(1 - found) * (1 - targets.score) ** 4 * probability**2 * torch.log(1 - probability)
    return ((missed + wrong) * targets.counted).sum() / found.sum().clamp(min=1.0)


def _centre_loss(miss: Tensor, at: Tensor, balls: Tensor) -> Tensor:
    """Negative log likelihood (B, N, 4) of misses (B, N, 4, 2) px across and along the streaks."""
    _, along = _direction(balls)
    ahead = (miss * along[:, :, None]).sum(-1)
    beside = miss[..., 1] * along[:, :, None, 0] - miss[..., 0] * along[:, :, None, 1]
    total = torch.zeros_like(ahead)
    for off, channel in ((beside, 6), (ahead, 7)):
        log_sigma = at[..., channel].clamp(*SIGMA_LIMITS)
        z = (off / log_sigma.exp()).abs()
        total = total + torch.where(z < HUBER, 0.5 * z**2, HUBER * z - 0.5 * HUBER**2) + log_sigma
    return total
