"""Scores of detected balls against true ones, formatted as one line per set."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.detection.detector_cases import DetectorCase
from models.core.detections import Detections
from video.rendering.random_scene import MAX_STREAK_PX


@dataclass
class DetectorTally:
    """Sums and errors over many cases."""

    required: int = 0
    hits: int = 0
    false_positives: int = 0
    detections: int = 0
    seconds: float = 0.0
    images: int = 0
    centre_errors: list[NDArray[np.float64]] = field(default_factory=list)
    """Errors of sharp balls: (dx, dy, sigma) px."""
    streak_errors: list[NDArray[np.float64]] = field(default_factory=list)
    """Errors of streaks: (across, along, sigma across, sigma along) px."""


def score_detections(case: DetectorCase, detections: Detections, tally: DetectorTally) -> None:
    """Match detections to true balls, nearest first, within 0.7 radii (plus half the streak), and add to the tally."""
    gap = np.linalg.norm(detections.centre[:, None] - case.centre[None], axis=-1)
    reach = np.maximum(0.7 * case.radius, 2.0) + 0.5 * np.linalg.norm(case.streak, axis=1)
    pairs = np.argwhere(gap < reach)
    pairs = pairs[np.argsort(gap[pairs[:, 0], pairs[:, 1]])]
    ball_of_detection: dict[int, int] = {}
    for row, ball in pairs.tolist():
        if row not in ball_of_detection and ball not in ball_of_detection.values():
            ball_of_detection[row] = ball
    tally.required += int(case.required.sum())
    tally.hits += sum(bool(case.required[ball]) for ball in ball_of_detection.values())
    tally.detections += len(detections)
    tally.false_positives += len(detections) - len(ball_of_detection)
    for row, ball in ball_of_detection.items():
        if not case.required[ball]:
            continue
        error = detections.centre[row] - case.centre[ball]
        length = float(np.linalg.norm(case.streak[ball]))
        if length < 1.5:
            tally.centre_errors.append(np.append(error, detections.sigma[row]))
        elif length < MAX_STREAK_PX:
            along = case.streak[ball] / length
            across = np.array([-along[1], along[0]])
            tally.streak_errors.append(
                np.array([error @ across, error @ along, detections.sigma[row], detections.sigma_along[row]])
            )


def format_row(name: str, tally: DetectorTally) -> str:
    """Format one row of the table."""
    errors = np.array(tally.centre_errors) if tally.centre_errors else np.full((1, 3), np.nan)
    streaks = np.array(tally.streak_errors) if tally.streak_errors else np.full((1, 4), np.nan)
    middle = np.median(errors[:, :2], axis=0)
    pulls = errors[:, :2] / errors[:, 2:]
    rms = np.sqrt((errors[:, :2] ** 2).mean(axis=0))
    centred = errors[:, :2] - errors[:, :2].mean(axis=0)
    precision = 1 - tally.false_positives / max(tally.detections, 1)
    cells = [
        f"{name:16s}", f"{tally.hits / max(tally.required, 1):6.3f}", f"{precision:6.3f}",
        f"{middle[0]:6.2f} {middle[1]:6.2f}", f"{rms[0]:5.2f} {rms[1]:5.2f}",
        f"{np.sqrt((centred**2).sum(axis=1).mean()):5.2f}", f"{np.std(pulls):5.2f} {robust_deviation(pulls):5.2f}",
        f"{np.sqrt((streaks[:, 0] ** 2).mean()):5.2f} {np.sqrt((streaks[:, 1] ** 2).mean()):5.2f}",
        f"{np.std(streaks[:, :2] / streaks[:, 2:]):5.2f}", f"{len(streaks) if tally.streak_errors else 0:4d}",
        f"{1e3 * tally.seconds / max(tally.images, 1):6.1f}",
    ]  # fmt: skip
    return "  ".join(cells)


def robust_deviation(values: NDArray[np.float64]) -> float:
    """Return the standard deviation estimated from the median of the absolute values."""
    return float(1.4826 * np.median(np.abs(values)))


HEADER = "set              recall  prec    median px      rms x  y   shift  pulls rob   streak a  l  pulls    n   ms"
