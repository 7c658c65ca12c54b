"""How good a trained network is on halls that training never showed, and what makes its scores and errors honest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from detectors.network.peak_decoding import LEAST_SCORE, Centres, read_maps
from detectors.training.ball_export import Calibration, ShippedNetwork
from detectors.training.data.training_shards import Pictures, read_pictures, training_file
from detectors.training.networks.ball_network import BallNetwork
from detectors.training.networks.training_loss import CLEAR_SHARE, LEAST_RADIUS_PX
from models.core.typing import ByteArray, Float32Array, FloatArray

CALIBRATION_FILE, FIGURES_FILE = 0, 1
"""Which held-out pictures fit the calibration, and which others give the figures."""
NEAR_RADII = 0.7
"""A peak within this of a ball is that ball."""
SCORE = 0.5
SHARP_PX = 1.0
MOST_PULL = 6.0
"""Standard deviations beyond which a miss is a wrong match rather than an error of the centre."""


@dataclass(frozen=True, slots=True)
class Figures:
    """On held-out drawn pictures, px of the pictures that the network is shown, balls of 4 to 12 px radius."""

    pictures: int
    balls: int
    recall: float
    precision: float
    sharp_rms_px: float
    """Per axis."""
    streak_across_rms_px: float
    streak_along_rms_px: float
    pull_std: float
    look_right: float
    """Share of balls whose look is named right."""


@dataclass(frozen=True, slots=True)
class Matches:
    """Peaks in many pictures beside the balls they belong to."""

    score: FloatArray
    """(K,)"""
    true: NDArray[np.bool_]
    """(K,) whether there is a ball."""
    miss: FloatArray
    """(K, 2) px across and along the streak (x and y for sharp balls); NaN without a ball."""
    sigma: FloatArray
    """(K, 2) px, likewise."""
    streak: FloatArray
    """(K,) px, the true length."""
    look_right: FloatArray
    """(K,) 1 or 0; NaN without a ball."""
    balls: int
    """Clear balls there were."""
    found: int
    """Of them found with a score above SCORE."""


def checked(network: BallNetwork, folder: Path) -> tuple[Calibration, Figures]:
    """Calibration from one set of held-out pictures, figures from another."""
    fitted = calibration_of(matched(network, Calibration(), held_out(folder, CALIBRATION_FILE)))
    shown = held_out(folder, FIGURES_FILE)
    return fitted, figures_of(matched(network, fitted, shown), len(shown))


def held_out(folder: Path, number: int) -> Pictures:
    """A file of pictures that training never showed; drawn where it is missing."""
    return read_pictures(training_file(folder, number, held_out=True))


def matched(network: BallNetwork, calibration: Calibration, pictures: Pictures) -> Matches:
    """Every peak of every picture, beside the ball it belongs to; peaks on hidden balls are left out."""
    shipped = ShippedNetwork(network, calibration).eval()

    def maps_of(rgb: ByteArray) -> Float32Array:
        with torch.no_grad():
            return np.asarray(shipped(torch.from_numpy(rgb[None])).numpy()[0])

    return matched_maps(maps_of, pictures)


def matched_maps(maps_of: Callable[[ByteArray], Float32Array], pictures: Pictures) -> Matches:
    """The same of a function from a picture (S, S, 3) to maps (12, S / 4, S / 4) whose score is a probability."""
    rows, balls, found = [], 0, 0
    for rgb, given in zip(pictures.rgb, pictures.balls, strict=True):
        maps = maps_of(rgb)
        there = given[~np.isnan(given[:, 0])].astype(np.float64)
        seen = read_maps(maps, LEAST_SCORE)
        part, of_ball = _compared(seen, there)
        clear = _clear(there)
        balls += int(clear.sum())
        found += len({ball for row, ball in of_ball.items() if clear[ball] and seen.score[row] > SCORE})
        rows.append(part)
    columns = np.concatenate(rows)
    return Matches(
        columns[:, 0], columns[:, 1] > 0, columns[:, 2:4], columns[:, 4:6], columns[:, 6], columns[:, 7], balls, found
    )


def _clear(balls: FloatArray) -> NDArray[np.bool_]:
    """Which balls (N, 7) must be found."""
    asked: NDArray[np.bool_] = (balls[:, 6] >= CLEAR_SHARE) & (balls[:, 2] >= LEAST_RADIUS_PX)
    return asked


def _compared(seen: Centres, balls: FloatArray) -> tuple[FloatArray, dict[int, int]]:
    """Rows (K, 8) as in `Matches`, and which peak is which ball; every ball once, best peaks first."""
    rows: list[list[float]] = []
    of_ball: dict[int, int] = {}
    for k in range(len(seen)):
        off = seen.centre[k] - balls[:, :2]
        apart = np.linalg.norm(off, axis=1) / balls[:, 2] if len(balls) else np.empty(0)
        near = [ball for ball in np.argsort(apart).tolist() if apart[ball] < NEAR_RADII]
        free = [ball for ball in near if ball not in of_ball.values()]
        if free:
            of_ball[k] = free[0]
        if not near:
            rows.append([seen.score[k], 0.0, np.nan, np.nan, np.nan, np.nan, 0.0, np.nan])
        elif free and _clear(balls)[free[0]]:
            rows.append(_row(seen, k, balls[free[0]], off[free[0]]))
    return np.array(rows).reshape(-1, 8), of_ball


def _row(seen: Centres, k: int, ball: FloatArray, off: FloatArray) -> list[float]:
    length = float(np.hypot(*ball[3:5]))
    along = ball[3:5] / length if length > SHARP_PX else np.array([0.0, 1.0])
    across = np.array([along[1], -along[0]])
    right = float(np.argmax(seen.look[k]) == int(ball[5]))
    return [seen.score[k], 1.0, off @ across, off @ along, seen.across[k], seen.along[k], length, right]


def calibration_of(peaks: Matches) -> Calibration:
    """Logistic regression of truth on the score's logit, and the spread of the pulls."""
    logit = np.log(np.clip(peaks.score, 1e-6, 1 - 1e-6)) - np.log1p(-np.clip(peaks.score, 1e-6, 1 - 1e-6))
    slope, offset = logistic_fit(logit, peaks.true)
    good = peaks.true & (peaks.score > SCORE)
    pulls = peaks.miss[good] / peaks.sigma[good]
    small = pulls[np.abs(pulls) < MOST_PULL]
    return Calibration(slope, offset, float(np.std(small)) if len(small) > 1 else 1.0)


def logistic_fit(x: FloatArray, true: NDArray[np.bool_]) -> tuple[float, float]:
    """Slope and offset of the likeliest logistic curve through points (n,), by Newton's method."""
    design = np.column_stack([x, np.ones_like(x)])
    beta = np.array([1.0, 0.0])
    for _ in range(30):
        p = 1 / (1 + np.exp(-np.clip(design @ beta, -30, 30)))
        # A weak prior at slope 1 keeps the answer finite where a score separates all.
        gradient = design.T @ (true - p) - 0.1 * (beta - np.array([1.0, 0.0]))
        hessian = (design * (p * (1 - p))[:, None]).T @ design + 0.1 * np.eye(2)
        beta = beta + np.clip(np.linalg.solve(hessian, gradient), -1.0, 1.0)
    return float(beta[0]), float(beta[1])


def figures_of(peaks: Matches, pictures: int) -> Figures:
    """What the calibrated network did with so many pictures."""
    given, good = peaks.score > SCORE, (peaks.score > SCORE) & peaks.true
    sharp, swept = good & (peaks.streak <= SHARP_PX), good & (peaks.streak > SHARP_PX)
    pulls = peaks.miss[good] / peaks.sigma[good]
    small, told = pulls[np.abs(pulls) < MOST_PULL], peaks.look_right[good]
    across, along = np.sqrt((peaks.miss[swept] ** 2).mean(axis=0)) if swept.any() else (np.nan, np.nan)
    return Figures(
        pictures,
        peaks.balls,
        peaks.found / max(peaks.balls, 1),
        float(peaks.true[given].mean()) if given.any() else 0.0,
        float(np.sqrt((peaks.miss[sharp] ** 2).mean())) if sharp.any() else float("nan"),
        float(across),
        float(along),
        float(np.std(small)) if len(small) else float("nan"),
        float(np.nanmean(told)) if np.isfinite(told).any() else 0.0,
    )


def as_facts(calibration: Calibration, figures: Figures) -> dict[str, dict[str, float]]:
    """Both for the metadata of the exported file, rounded; NaN is left out."""
    rounded = {k: round(float(v), 4) for k, v in asdict(figures).items() if v == v}
    return {"trueroll.calibration": asdict(calibration), "trueroll.held_out": rounded}
