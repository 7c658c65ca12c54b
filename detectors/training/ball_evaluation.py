"""Evaluation of a trained ball network on hold-out images, and calibration of its scores and sigmas."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from detectors.network.peak_decoding import MIN_PEAK_SCORE, CandidateDetections, decode_maps
from detectors.training.detector_networks import CLEAR_SHARE, MIN_RADIUS_PX, BallNetwork
from detectors.training.onnx_export import ExportedBallNetwork, NetworkCalibration
from detectors.training.training_shards import TrainingShard, prepare_shard_file, read_shard
from models.core.typing import FloatArray

# Numbers of the hold-out files for the calibration and for the figures.
CALIBRATION_FILE, FIGURES_FILE = 0, 1
# Distance, ball radii, within which a peak belongs to a ball.
MATCH_RADII = 0.7
# Confidence score from which a ball is reported.
REPORTED_SCORE = 0.5
# Length of a streak up to which a ball counts as sharp.
SHARP_PX = 1.0
# Standard deviations beyond which an error is attributed to a wrong match.
MAX_PULL = 6.0


@dataclass(frozen=True, slots=True)
class PeakMatches:
    """K peaks of many images, with the balls that they belong to."""

    score: FloatArray
    """(K,)"""
    is_ball: NDArray[np.bool_]
    """(K,) whether the peak belongs to a ball."""
    error: FloatArray
    """(K, 2) px, error of the centre across and along the streak (x and y for sharp balls); NaN without a ball."""
    sigma: FloatArray
    """(K, 2) px, likewise."""
    streak_length: FloatArray
    """(K,) px, true length of the streak."""
    is_appearance_correct: FloatArray
    """(K,) 1 or 0; NaN without a ball."""
    ball_count: int
    """Number of sufficiently visible balls."""
    detected_count: int
    """Number of those detected with a score above REPORTED_SCORE."""


def calibrate_and_evaluate(network: BallNetwork, folder: Path) -> tuple[NetworkCalibration, dict[str, float]]:
    """Fit the calibration on one file of hold-out images, and compute the figures on another."""
    calibration = fit_calibration(
        match_network(network, NetworkCalibration(), read_hold_out_shard(folder, CALIBRATION_FILE))
    )
    shard = read_hold_out_shard(folder, FIGURES_FILE)
    return calibration, summarize_matches(match_network(network, calibration, shard), len(shard))


def read_hold_out_shard(folder: Path, number: int) -> TrainingShard:
    """Read a file of hold-out images; it is rendered first if it does not exist."""
    return read_shard(prepare_shard_file(folder, number, held_out=True))


def match_network(network: BallNetwork, calibration: NetworkCalibration, shard: TrainingShard) -> PeakMatches:
    """Match the peaks of a network in all images of a shard with the balls; peaks on hidden balls are excluded."""
    shipped = ExportedBallNetwork(network, calibration).eval()
    rows, ball_count, detected_count = [], 0, 0
    for rgb, true_balls in zip(shard.rgb, shard.balls, strict=True):
        with torch.no_grad():
            maps = np.asarray(shipped(torch.from_numpy(rgb[None])).numpy()[0])
        there = true_balls[~np.isnan(true_balls[:, 0])].astype(np.float64)
        candidates = decode_maps(maps, MIN_PEAK_SCORE)
        part, of_ball = _match_peaks(candidates, there)
        clear = _is_clear(there)
        ball_count += int(clear.sum())
        detected_count += len(
            {ball for row, ball in of_ball.items() if clear[ball] and candidates.score[row] > REPORTED_SCORE}
        )
        rows.append(part)
    columns = np.concatenate(rows)
    return PeakMatches(
        columns[:, 0],
        columns[:, 1] > 0,
        columns[:, 2:4],
        columns[:, 4:6],
        columns[:, 6],
        columns[:, 7],
        ball_count,
        detected_count,
    )


def _is_clear(balls: FloatArray) -> NDArray[np.bool_]:
    """Which balls (N, 7) must be detected."""
    is_required: NDArray[np.bool_] = (balls[:, 6] >= CLEAR_SHARE) & (balls[:, 2] >= MIN_RADIUS_PX)
    return is_required


def _match_peaks(candidates: CandidateDetections, balls: FloatArray) -> tuple[FloatArray, dict[int, int]]:
    """Match peaks with balls, best first, every ball once: rows (K, 8) as in `PeakMatches`, and the ball of a peak."""
    rows: list[list[float]] = []
    of_ball: dict[int, int] = {}
    for k in range(len(candidates)):
        off = candidates.centre[k] - balls[:, :2]
        apart = np.linalg.norm(off, axis=1) / balls[:, 2] if len(balls) else np.empty(0)
        near = [ball for ball in np.argsort(apart).tolist() if apart[ball] < MATCH_RADII]
        free = [ball for ball in near if ball not in of_ball.values()]
        if free:
            of_ball[k] = free[0]
        if not near:
            rows.append([candidates.score[k], 0.0, np.nan, np.nan, np.nan, np.nan, 0.0, np.nan])
        elif free and _is_clear(balls)[free[0]]:
            rows.append(_match_row(candidates, k, balls[free[0]], off[free[0]]))
    return np.array(rows).reshape(-1, 8), of_ball


def _match_row(candidates: CandidateDetections, k: int, ball: FloatArray, off: FloatArray) -> list[float]:
    length = float(np.hypot(*ball[3:5]))
    along = ball[3:5] / length if length > SHARP_PX else np.array([0.0, 1.0])
    across = np.array([along[1], -along[0]])
    right = float(np.argmax(candidates.appearance[k]) == int(ball[5]))
    return [
        candidates.score[k],
        1.0,
        off @ across,
        off @ along,
        candidates.sigma_across[k],
        candidates.sigma_along[k],
        length,
        right,
    ]


def fit_calibration(matches: PeakMatches) -> NetworkCalibration:
    """Fit a logistic regression of the truth on the logit of the score, and the spread of the pulls."""
    logit = np.log(np.clip(matches.score, 1e-6, 1 - 1e-6)) - np.log1p(-np.clip(matches.score, 1e-6, 1 - 1e-6))
    slope, offset = fit_logistic(logit, matches.is_ball)
    good = matches.is_ball & (matches.score > REPORTED_SCORE)
    pulls = matches.error[good] / matches.sigma[good]
    small = pulls[np.abs(pulls) < MAX_PULL]
    return NetworkCalibration(slope, offset, float(np.std(small)) if len(small) > 1 else 1.0)


def fit_logistic(x: FloatArray, true: NDArray[np.bool_]) -> tuple[float, float]:
    """Fit slope and offset of a logistic curve to points (n,) by maximum likelihood (Newton's method)."""
    design = np.column_stack([x, np.ones_like(x)])
    beta = np.array([1.0, 0.0])
    for _ in range(30):
        p = 1 / (1 + np.exp(-np.clip(design @ beta, -30, 30)))
        # A weak prior at slope 1 keeps the result finite if the score separates all.
        gradient = design.T @ (true - p) - 0.1 * (beta - np.array([1.0, 0.0]))
        hessian = (design * (p * (1 - p))[:, None]).T @ design + 0.1 * np.eye(2)
        beta = beta + np.clip(np.linalg.solve(hessian, gradient), -1.0, 1.0)
    return float(beta[0]), float(beta[1])


def summarize_matches(matches: PeakMatches, image_count: int) -> dict[str, float]:
    """Summarize the matches of a calibrated network.

    Returns:
        Figures on rendered hold-out images, rounded, px of the network's input, balls of 4 to 12 px radius; without
        undefined ones. `look_right` is the share of balls whose appearance is classified correctly.
    """
    is_reported, good = matches.score > REPORTED_SCORE, (matches.score > REPORTED_SCORE) & matches.is_ball
    is_sharp, is_streak = good & (matches.streak_length <= SHARP_PX), good & (matches.streak_length > SHARP_PX)
    pulls = matches.error[good] / matches.sigma[good]
    small, appearance_correct = pulls[np.abs(pulls) < MAX_PULL], matches.is_appearance_correct[good]
    across, along = np.sqrt((matches.error[is_streak] ** 2).mean(axis=0)) if is_streak.any() else (np.nan, np.nan)
    return round_figures({
        "pictures": image_count,
        "balls": matches.ball_count,
        "recall": matches.detected_count / max(matches.ball_count, 1),
        "precision": matches.is_ball[is_reported].mean() if is_reported.any() else 0.0,
        "sharp_rms_px": np.sqrt((matches.error[is_sharp] ** 2).mean()) if is_sharp.any() else np.nan,
        "streak_across_rms_px": across,
        "streak_along_rms_px": along,
        "pull_std": np.std(small) if len(small) else np.nan,
        "look_right": np.nanmean(appearance_correct) if np.isfinite(appearance_correct).any() else 0.0,
    })  # fmt: skip


def round_figures(figures: dict[str, Any]) -> dict[str, float]:
    """Round figures for the metadata of the exported file; NaN is left out."""
    return {name: round(float(value), 4) for name, value in figures.items() if value == value}
