"""Scores of synthesised frames against the withheld real ones: on the balls' paths, at the balls, and elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from benchmarks.interpolation.withheld_truth import Passing, path_masks

# Shares of a ball's contrast against the table.
#
# A ball is missing if its median strength is below the first; it is doubled if a ghost above the second remains.
MISSING, DOUBLED = 0.5, 0.35
# Least contrast of a pixel that is used to detect a ball, as a share of the mean contrast of the ball.
CONTRAST_SHARE = 0.5
# Difference of the neighbouring visible frames, in levels of 255, above which an area counts as changing.
CHANGE_LEVELS = 12.0


@dataclass
class FrameTally:
    """Scores of one method on one class of areas."""

    squared_errors: list[float] = field(default_factory=list)
    """Mean squared error per withheld frame."""
    centre_errors: list[float] = field(default_factory=list)
    """Distance of every ball from its real position, px."""
    missing: int = 0
    doubled: int = 0
    ssim: list[float] = field(default_factory=list)

    @property
    def psnr(self) -> float:
        """PSNR of the mean squared error over all frames, dB."""
        return to_decibels(float(np.mean(self.squared_errors))) if self.squared_errors else np.nan

    @property
    def median_psnr(self) -> float:
        """Median PSNR over frames, dB."""
        return float(np.median([to_decibels(s) for s in self.squared_errors])) if self.squared_errors else np.nan

    @property
    def median_centre_error(self) -> float:
        return float(np.median(self.centre_errors)) if self.centre_errors else np.nan


def to_decibels(square: float) -> float:
    return float(10 * np.log10(255**2 / max(square, 1e-2)))


@dataclass(frozen=True)
class WithheldFrame:
    """A withheld frame with the data for its scores."""

    real: np.ndarray
    balls: list[Passing]
    masks: dict[str, np.ndarray]
    plate: np.ndarray

    @classmethod
    def build(
        cls, balls: list[Passing], real: np.ndarray, around: tuple[np.ndarray, np.ndarray], plate: np.ndarray
    ) -> WithheldFrame:
        masks = path_masks(balls, real.shape)
        change = np.abs(around[0].astype(np.float32) - around[1]).max(axis=2)
        changing = (cv2.blur(change, (5, 5)) > CHANGE_LEVELS) & masks["elsewhere"]
        return cls(real, balls, masks | {"changing": changing}, plate)


def score_frame(scored: WithheldFrame, synthesised: np.ndarray, tallies: dict[str, FrameTally]) -> None:
    """Add one synthesised frame to the tallies by class."""
    square = ((synthesised.astype(np.float32) - scored.real) ** 2).mean(axis=2)
    for kind, mask in scored.masks.items():
        if mask.sum() > 20:
            tallies[kind].squared_errors.append(float(square[mask].mean()))
    similar = ssim(synthesised, scored.real)
    tallies["elsewhere"].ssim.append(float(similar[scored.masks["elsewhere"]].mean()))
    for ball in scored.balls:
        match = find_ball(scored, ball, synthesised)
        if match is None:
            continue
        error, strength, ghost = match
        tally = tallies[ball.kind]
        tally.centre_errors.append(error)
        tally.missing += strength < MISSING
        tally.doubled += ghost > DOUBLED


def find_ball(scored: WithheldFrame, ball: Passing, synthesised: np.ndarray) -> tuple[float, float, float] | None:
    """Return distance (px) from the real position, strength there, and strongest ghost of a ball in `synthesised`.

    The real ball, a disc, is the template for a search along the path. None at the border of the frame.
    """
    half = int(np.ceil(ball.radius)) + 1
    x, y = np.rint(ball.centre).astype(int)
    reach = int(np.ceil(np.ptp(ball.path, axis=0).max() + ball.radius))
    height, width = synthesised.shape[:2]
    if not (half <= x < width - half and half <= y < height - half):
        return None
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    disc = (np.hypot(u + x - ball.centre[0], v + y - ball.centre[1]) <= ball.radius).astype(np.float32)
    here = np.s_[y - half : y + half + 1, x - half : x + half + 1]
    pattern = scored.real[here].astype(np.float32)
    x0, y0 = max(x - half - reach, 0), max(y - half - reach, 0)
    wide = np.s_[y0 : min(y + half + reach + 1, height), x0 : min(x + half + reach + 1, width)]
    window = synthesised[wide].astype(np.float32)
    error = cv2.matchTemplate(window, pattern, cv2.TM_SQDIFF, mask=np.repeat(disc[..., None], 3, axis=2))
    row, column = np.unravel_index(int(np.argmin(error)), error.shape)
    shift = np.array([column + x0 + half - x, row + y0 + half - y]) + _between_pixels(error, int(row), int(column))
    contrast = (pattern - scored.plate[here]) * disc[..., None]
    power = float((contrast**2).sum())
    if power < disc.sum() * 3 * 100:  # a ball of the colour of the cloth cannot be located
        return None
    at = np.s_[y0 + row : y0 + row + 2 * half + 1, x0 + column : x0 + column + 2 * half + 1]
    strength = _ball_strength(synthesised[at] - scored.plate[at], contrast)
    return float(np.hypot(*shift)), strength, _ghost_strength(scored, ball, window, (x0, y0), contrast, power)


def _ball_strength(shown: np.ndarray, contrast: np.ndarray) -> float:
    """Return the median over a ball's pixels of the share of its contrast (h, w, 3) that is `shown`.

    The median ignores a number that has turned, although it has most of the contrast of a dark ball.
    """
    power = (contrast**2).sum(axis=2)
    is_used = power > CONTRAST_SHARE**2 * power[power > 0].mean()
    return float(np.median((shown * contrast).sum(axis=2)[is_used] / power[is_used]))


def _between_pixels(error: np.ndarray, row: int, column: int) -> np.ndarray:
    """Return the offset (2,) of the minimum from the least pixel, by parabolas."""
    offset = np.zeros(2)
    for axis, (at, size) in enumerate(((column, error.shape[1]), (row, error.shape[0]))):
        if 0 < at < size - 1:
            line = error[row, at - 1 : at + 2] if axis == 0 else error[at - 1 : at + 2, column]
            bend = float(line[0] - 2 * line[1] + line[2])
            offset[axis] = float(line[0] - line[2]) / (2 * bend) if bend > 0 else 0.0
    return np.clip(offset, -1, 1)


def _ghost_strength(
    scored: WithheldFrame,
    ball: Passing,
    window: np.ndarray,
    corner: tuple[int, int],
    contrast: np.ndarray,
    power: float,
) -> float:
    """Return the largest share of the ball that the synthesised frame shows on its path, away from every real ball."""
    height, width = window.shape[:2]
    real = scored.real[corner[1] : corner[1] + height, corner[0] : corner[0] + width]
    shares = cv2.matchTemplate(window - real, contrast, cv2.TM_CCORR) / power
    half = contrast.shape[0] // 2
    v, u = np.mgrid[: shares.shape[0], : shares.shape[1]]
    centre = np.stack([u + corner[0] + half, v + corner[1] + half], axis=-1)
    on_path = np.min(np.linalg.norm(centre[:, :, None] - ball.path[None, None, ::4], axis=-1), axis=2) < ball.radius
    for other in scored.balls:
        on_path &= np.linalg.norm(centre - other.centre, axis=-1) > 1.6 * ball.radius
    return float(shares[on_path].max()) if on_path.any() else 0.0


def ssim(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the structural similarity (H, W) of the grey images (Wang et al. 2004, doi:10.1109/TIP.2003.819861)."""
    x, y = (cv2.cvtColor(p, cv2.COLOR_RGB2GRAY).astype(np.float32) for p in (a, b))

    def mean(p: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.GaussianBlur(p, (11, 11), 1.5))

    mx, my = mean(x), mean(y)
    vx, vy, vxy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    return np.asarray((2 * mx * my + c1) * (2 * vxy + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2)))
