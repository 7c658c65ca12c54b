"""How far a made picture is from the withheld real one: on the paths of the balls, in the balls' places, elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from between_truth import Passing, path_masks

MISSING, DOUBLED = 0.5, 0.35
"""Share of a ball's contrast against the table: where half of it shows less than that, it is missing; left where it is
not, it is doubled."""
TOLD = 0.5
"""Times the mean contrast of a ball's pixels against the table that a pixel needs to tell a ball from none."""
STIRRED = 12.0
"""Levels of 255 between the visible pictures around, averaged over a few pixels, from which something moves there."""


@dataclass
class Tally:
    """What one method made of one class of places."""

    squares: list[float] = field(default_factory=list)
    """Mean squared error per withheld picture."""
    centres: list[float] = field(default_factory=list)
    """px per ball"""
    missing: int = 0
    doubled: int = 0
    ssim: list[float] = field(default_factory=list)

    @property
    def psnr(self) -> float:
        """dB of the mean squared error over all pictures."""
        return decibels(float(np.mean(self.squares))) if self.squares else np.nan

    @property
    def middle(self) -> float:
        """dB, median over pictures."""
        return float(np.median([decibels(s) for s in self.squares])) if self.squares else np.nan

    @property
    def centre(self) -> float:
        return float(np.median(self.centres)) if self.centres else np.nan


def decibels(square: float) -> float:
    return float(10 * np.log10(255**2 / max(square, 1e-2)))


@dataclass(frozen=True)
class Scored:
    """A withheld picture with all that it is scored by."""

    real: np.ndarray
    balls: list[Passing]
    masks: dict[str, np.ndarray]
    plate: np.ndarray

    @classmethod
    def of(
        cls, balls: list[Passing], real: np.ndarray, around: tuple[np.ndarray, np.ndarray], plate: np.ndarray
    ) -> Scored:
        masks = path_masks(balls, real.shape)
        change = np.abs(around[0].astype(np.float32) - around[1]).max(axis=2)
        stirred = (cv2.blur(change, (5, 5)) > STIRRED) & masks["elsewhere"]
        return cls(real, balls, masks | {"stirred": stirred}, plate)


def score_picture(scored: Scored, made: np.ndarray, tallies: dict[str, Tally]) -> None:
    """Add one made picture to the tallies by class."""
    square = ((made.astype(np.float32) - scored.real) ** 2).mean(axis=2)
    for kind, mask in scored.masks.items():
        if mask.sum() > 20:
            tallies[kind].squares.append(float(square[mask].mean()))
    similar = ssim(made, scored.real)
    tallies["elsewhere"].ssim.append(float(similar[scored.masks["elsewhere"]].mean()))
    for ball in scored.balls:
        found = find_ball(scored, ball, made)
        if found is None:
            continue
        error, strength, ghost = found
        tally = tallies[ball.kind]
        tally.centres.append(error)
        tally.missing += strength < MISSING
        tally.doubled += ghost > DOUBLED


def find_ball(scored: Scored, ball: Passing, made: np.ndarray) -> tuple[float, float, float] | None:
    """px from the real place to where the ball is found in `made`, its strength there, and the strongest ghost.

    The real ball is the template, a disc; it is sought along the path. None at the border of the picture.
    """
    half = int(np.ceil(ball.radius)) + 1
    x, y = np.rint(ball.centre).astype(int)
    reach = int(np.ceil(np.ptp(ball.way, axis=0).max() + ball.radius))
    height, width = made.shape[:2]
    if not (half <= x < width - half and half <= y < height - half):
        return None
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    disc = (np.hypot(u + x - ball.centre[0], v + y - ball.centre[1]) <= ball.radius).astype(np.float32)
    here = np.s_[y - half : y + half + 1, x - half : x + half + 1]
    pattern = scored.real[here].astype(np.float32)
    x0, y0 = max(x - half - reach, 0), max(y - half - reach, 0)
    wide = np.s_[y0 : min(y + half + reach + 1, height), x0 : min(x + half + reach + 1, width)]
    window = made[wide].astype(np.float32)
    error = cv2.matchTemplate(window, pattern, cv2.TM_SQDIFF, mask=np.repeat(disc[..., None], 3, axis=2))
    row, column = np.unravel_index(int(np.argmin(error)), error.shape)
    shift = np.array([column + x0 + half - x, row + y0 + half - y]) + _between_pixels(error, int(row), int(column))
    contrast = (pattern - scored.plate[here]) * disc[..., None]
    power = float((contrast**2).sum())
    if power < disc.sum() * 3 * 100:  # a ball of the colour of the cloth tells nothing
        return None
    at = np.s_[y0 + row : y0 + row + 2 * half + 1, x0 + column : x0 + column + 2 * half + 1]
    strength = _strength(made[at] - scored.plate[at], contrast)
    return float(np.hypot(*shift)), strength, _ghost(scored, ball, window, (x0, y0), contrast, power)


def _strength(found: np.ndarray, contrast: np.ndarray) -> float:
    """Median over a ball's pixels of the share of its contrast (h, w, 3) that is `found`.

    The median, for a number that has turned is no missing ball, though it holds most of the contrast of a dark one.
    """
    power = (contrast**2).sum(axis=2)
    tells = power > TOLD**2 * power[power > 0].mean()
    return float(np.median((found * contrast).sum(axis=2)[tells] / power[tells]))


def _between_pixels(error: np.ndarray, row: int, column: int) -> np.ndarray:
    """The minimum's offset (2,) from the least pixel, by parabolas."""
    offset = np.zeros(2)
    for axis, (at, size) in enumerate(((column, error.shape[1]), (row, error.shape[0]))):
        if 0 < at < size - 1:
            line = error[row, at - 1 : at + 2] if axis == 0 else error[at - 1 : at + 2, column]
            bend = float(line[0] - 2 * line[1] + line[2])
            offset[axis] = float(line[0] - line[2]) / (2 * bend) if bend > 0 else 0.0
    return np.clip(offset, -1, 1)


def _ghost(
    scored: Scored, ball: Passing, window: np.ndarray, corner: tuple[int, int], contrast: np.ndarray, power: float
) -> float:
    """The greatest share of the ball that `made` shows on its path, away from every real ball, and the truth not."""
    height, width = window.shape[:2]
    real = scored.real[corner[1] : corner[1] + height, corner[0] : corner[0] + width]
    shares = cv2.matchTemplate(window - real, contrast, cv2.TM_CCORR) / power
    half = contrast.shape[0] // 2
    v, u = np.mgrid[: shares.shape[0], : shares.shape[1]]
    centre = np.stack([u + corner[0] + half, v + corner[1] + half], axis=-1)
    on_path = np.min(np.linalg.norm(centre[:, :, None] - ball.way[None, None, ::4], axis=-1), axis=2) < ball.radius
    for other in scored.balls:
        on_path &= np.linalg.norm(centre - other.centre, axis=-1) > 1.6 * ball.radius
    return float(shares[on_path].max()) if on_path.any() else 0.0


def ssim(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Structural similarity (H, W) of the grey pictures (Wang et al. 2004, doi:10.1109/TIP.2003.819861)."""
    x, y = (cv2.cvtColor(p, cv2.COLOR_RGB2GRAY).astype(np.float32) for p in (a, b))

    def mean(p: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.GaussianBlur(p, (11, 11), 1.5))

    mx, my = mean(x), mean(y)
    vx, vy, vxy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    return np.asarray((2 * mx * my + c1) * (2 * vxy + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2)))
