"""What the network's maps should be for balls that are known, and how far they are from it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from detectors.network.peak_decoding import CHANNELS, RADIUS_UNIT_PX, SIGMA_LIMITS, STREAK_UNIT_PX, STRIDE

LOOK = CHANNELS.index("white")
CLEAR_SHARE = 0.4
"""Visible share of a ball from which it must be found; hidden further, it may be found or not."""
LEAST_RADIUS_PX = 3.3
"""Smaller balls, far away in a low view, may be found or not."""
PEAK_RADII, LEAST_PEAK_PX = 0.3, 2.2
"""Standard deviation of a peak in the score's target."""
STREAK_PEAK_SHARE = 0.08
"""The same along a streak in addition, share of its length: its middle is less sharply placed."""
SURE_STREAK_SHARE, SURE_PX = 0.12, 2.0
"""How far off its middle a cell may still say that a streak is there: this share of its length along it, and as much
more as a cell reaches. One cell alone would have to know what the picture does not tell, and would say it faintly."""
IGNORED_RADII = 1.0
"""About a ball that may be found or not, the score is free within this."""
SHARP_PX = 1.0
"""A shorter streak has no direction."""
STREAK_WORTH = 10.0
"""What the streak of a moving ball counts beyond that of a ball at rest, of which there are many more."""
REACH_CELLS = (-1, 0, 1, 2)
"""A ball's place and size are learnt at so many cells about its centre, from the one left of and above it: wherever a
peak may come to stand, two balls that look like one included, the cell must know how far off it is."""
NEAR_SHARE, NEAR_RADII = 0.25, 0.6
"""What such a cell counts beside the four around the centre, within this."""
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
    """(K,) of the cells that tell of a ball, each beside the ball it tells of."""
    cell: Tensor
    """(K,) flat index of the cell into (B, h, w)."""
    ball: Tensor
    """(K, 7) columns of `training_data.COLUMNS`."""


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
    weight, cell = _around(balls, cells)  # (B, N, 16)
    weight = weight * clear[..., None]
    nearest = cell.gather(2, weight.argmax(dim=2, keepdim=True))[..., 0]
    score.flatten(1).scatter_reduce_(1, nearest, clear.float(), "amax")
    free = (there & ~clear)[..., None, None] & (dx**2 + dy**2 < (IGNORED_RADII * balls[..., 2, None, None]) ** 2)
    counted = (~free.any(dim=1) | (score > 0.6)).float()
    picture, ball, which = torch.nonzero(weight, as_tuple=True)
    flat = picture * cells**2 + cell[picture, ball, which]
    return Targets(score, counted, weight[picture, ball, which], flat, balls[picture, ball])


def _peaks(balls: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    """Gaussians (B, N, h, w), longer along streaks."""
    length, along = _direction(balls)
    length = length[..., None, None]
    sigma = torch.clamp(PEAK_RADII * balls[..., 2], min=LEAST_PEAK_PX)[..., None, None]
    ahead = dx * along[..., 0, None, None] + dy * along[..., 1, None, None]
    beside = dy * along[..., 0, None, None] - dx * along[..., 1, None, None]
    peaks = torch.exp(-0.5 * ((ahead / (sigma + STREAK_PEAK_SHARE * length)) ** 2 + (beside / sigma) ** 2))
    middle = (ahead.abs() < SURE_PX + SURE_STREAK_SHARE * length) & (beside.abs() < SURE_PX)
    return peaks.masked_fill(middle & (length > 2 * SHARP_PX), 1.0)


def _direction(balls: Tensor) -> tuple[Tensor, Tensor]:
    """Length (...) px and unit vector (..., 2) of the streaks of balls (..., 7); (1, 0) for sharp ones."""
    streak = balls[..., 3:5]
    length = streak.norm(dim=-1)
    flat = torch.tensor([1.0, 0.0]).expand_as(streak)
    return length, torch.where(length[..., None] > SHARP_PX, streak / length.clamp(min=1e-6)[..., None], flat)


def _around(balls: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Weights and flat indices (B, N, 16) of the cells around the centres; weight 0 outside the picture."""
    at = (balls[..., :2] + 0.5) / STRIDE - 0.5
    low = at.floor()
    far = NEAR_RADII * balls[..., 2] + SURE_STREAK_SHARE * balls[..., 3:5].norm(dim=-1)
    reach = (far / STRIDE)[..., None]  # (B, N, 1) cells
    weights, indices = [], []
    for below in REACH_CELLS:
        for right in REACH_CELLS:
            cell = low + torch.tensor([right, below])
            inside = ((cell >= 0) & (cell < cells)).all(dim=-1)
            off = cell - at
            bilinear = (1 - off.abs()).clamp(min=0).prod(dim=-1)
            near = NEAR_SHARE * (off.norm(dim=-1) < reach[..., 0])
            weights.append(torch.maximum(bilinear, near) * inside)
            x, y = cell.clamp(0, cells - 1).unbind(dim=-1)
            indices.append((y * cells + x).long())
    return torch.stack(weights, dim=-1), torch.stack(indices, dim=-1)


def loss_of(maps: Tensor, targets: Targets) -> tuple[Tensor, dict[str, float]]:
    """Loss of maps (B, 12, h, w), and its parts."""
    cells = maps.shape[-1]
    at = maps.movedim(1, -1).reshape(-1, maps.shape[1])[targets.cell]  # (K, 12)
    ball, weight = targets.ball, targets.weight / targets.weight.sum().clamp(min=1.0)
    place = targets.cell % cells**2
    middle = (torch.stack([place % cells, place // cells], dim=-1).float() + 0.5) * STRIDE - 0.5
    smooth, entropy = torch.nn.functional.smooth_l1_loss, torch.nn.functional.cross_entropy
    radius = torch.log(ball[:, 2] / RADIUS_UNIT_PX)
    rare = 1 + STREAK_WORTH * (ball[:, 3:5].norm(dim=-1) > 2 * SHARP_PX).float()
    off = smooth(at[:, 4:6], doubled(ball[:, 3:5]), reduction="none", beta=0.3).sum(-1)
    given = entropy(at[:, LOOK:], ball[:, 5].long(), reduction="none")
    parts = {
        "score": _score_loss(maps[:, 0], targets),
        "centre": (weight * _centre_loss(middle + STRIDE * at[:, 1:3] - ball[:, :2], at, ball)).sum(),
        "radius": 3 * (weight * smooth(at[:, 3], radius, reduction="none", beta=0.1)).sum(),
        "streak": (weight * rare * off).sum(),
        "look": 0.3 * (weight * given).sum(),
    }
    loss = torch.stack(list(parts.values())).sum()
    return loss, {name: float(part.detach()) for name, part in parts.items()}


def doubled(streak: Tensor) -> Tensor:
    """Streaks (..., 2) px to the maps' form: their length times cos and sin of twice the angle, in units."""
    x, y = streak[..., 0], streak[..., 1]
    length = torch.hypot(x, y).clamp(min=1e-6)
    return torch.stack([(x**2 - y**2) / length, 2 * x * y / length], dim=-1) / STREAK_UNIT_PX


def _score_loss(logit: Tensor, targets: Targets) -> Tensor:
    """Focal loss with soft neighbours (Law and Deng 2018, arXiv:1808.01244, eq. 1), per ball."""
    probability = torch.sigmoid(logit).clamp(1e-6, 1 - 1e-6)
    found = (targets.score > 0.999).float()
    missed = -found * (1 - probability) ** 2 * torch.log(probability)
    wrong = -(1 - found) * (1 - targets.score) ** 4 * probability**2 * torch.log(1 - probability)
    return ((missed + wrong) * targets.counted).sum() / found.sum().clamp(min=1.0)


def _centre_loss(miss: Tensor, at: Tensor, ball: Tensor) -> Tensor:
    """Negative log likelihood (K,) of misses (K, 2) px across and along the streaks."""
    _, along = _direction(ball)
    ahead = (miss * along).sum(-1)
    beside = miss[:, 1] * along[:, 0] - miss[:, 0] * along[:, 1]
    total = torch.zeros_like(ahead)
    for off, channel in ((beside, 6), (ahead, 7)):
        log_sigma = at[:, channel].clamp(*SIGMA_LIMITS)
        z = (off / log_sigma.exp()).abs()
        total = total + torch.where(z < HUBER, 0.5 * z**2, HUBER * z - 0.5 * HUBER**2) + log_sigma
    return total
