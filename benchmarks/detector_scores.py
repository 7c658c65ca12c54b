"""How found balls compare with true ones, in one line a set."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from detector_cases import Case
from numpy.typing import NDArray

from models.core.detections import Detections
from video.rendering.ball_arrangement import MOST_STREAK_PX


@dataclass
class Tally:
    """What came of many cases."""

    asked: int = 0
    hit: int = 0
    wrong: int = 0
    given: int = 0
    seconds: float = 0.0
    pictures: int = 0
    offset: list[NDArray[np.float64]] = field(default_factory=list)
    """sharp balls: (dx, dy, sigma)."""
    swept: list[NDArray[np.float64]] = field(default_factory=list)
    """streaks: (across, along, sigma across, sigma along)."""


def score(case: Case, found: Detections, tally: Tally) -> None:
    """Match found balls to true ones, nearest first, within 0.7 radii (and half the streak)."""
    gap = np.linalg.norm(found.centre[:, None] - case.centre[None], axis=-1)
    reach = np.maximum(0.7 * case.radius, 2.0) + 0.5 * np.linalg.norm(case.streak, axis=1)
    pairs = np.argwhere(gap < reach)
    pairs = pairs[np.argsort(gap[pairs[:, 0], pairs[:, 1]])]
    of_found: dict[int, int] = {}
    for row, ball in pairs.tolist():
        if row not in of_found and ball not in of_found.values():
            of_found[row] = ball
    tally.asked += int(case.asked.sum())
    tally.hit += sum(bool(case.asked[ball]) for ball in of_found.values())
    tally.given += len(found)
    tally.wrong += len(found) - len(of_found)
    for row, ball in of_found.items():
        if not case.asked[ball]:
            continue
        miss = found.centre[row] - case.centre[ball]
        length = float(np.linalg.norm(case.streak[ball]))
        if length < 1.5:
            tally.offset.append(np.append(miss, found.sigma[row]))
        elif length < MOST_STREAK_PX:
            along = case.streak[ball] / length
            beside = np.array([-along[1], along[0]])
            tally.swept.append(np.array([miss @ beside, miss @ along, found.sigma[row], found.sigma_along[row]]))


def line(name: str, tally: Tally) -> str:
    """One row of the table."""
    offset = np.array(tally.offset) if tally.offset else np.full((1, 3), np.nan)
    swept = np.array(tally.swept) if tally.swept else np.full((1, 4), np.nan)
    middle = np.median(offset[:, :2], axis=0)
    pulls = offset[:, :2] / offset[:, 2:]
    rms = np.sqrt((offset[:, :2] ** 2).mean(axis=0))
    centred = offset[:, :2] - offset[:, :2].mean(axis=0)
    precision = 1 - tally.wrong / max(tally.given, 1)
    cells = [
        f"{name:16s}", f"{tally.hit / max(tally.asked, 1):6.3f}", f"{precision:6.3f}",
        f"{middle[0]:6.2f} {middle[1]:6.2f}", f"{rms[0]:5.2f} {rms[1]:5.2f}",
        f"{np.sqrt((centred**2).sum(axis=1).mean()):5.2f}", f"{np.std(pulls):5.2f} {robust(pulls):5.2f}",
        f"{np.sqrt((swept[:, 0] ** 2).mean()):5.2f} {np.sqrt((swept[:, 1] ** 2).mean()):5.2f}",
        f"{np.std(swept[:, :2] / swept[:, 2:]):5.2f}", f"{len(swept) if tally.swept else 0:4d}",
        f"{1e3 * tally.seconds / max(tally.pictures, 1):6.1f}",
    ]  # fmt: skip
    return "  ".join(cells)


def robust(values: NDArray[np.float64]) -> float:
    """Standard deviation by the median of the absolute values."""
    return float(1.4826 * np.median(np.abs(values)))


HEADER = "set              recall  prec    median px      rms x  y   shift  pulls rob   streak a  l  pulls    n   ms"
