"""Decoding of the maps of a centre network: peaks of the score, with the values of the other channels there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.array_columns import concatenate_rows, take_rows
from models.core.typing import BoolArray, Float32Array, FloatArray

# px of the image per cell of the maps.
STRIDE = 4
# The sides of the input are multiples of this, px.
COARSE_STRIDE = 8
# Channels of the maps: score that a cell holds a centre (a probability in the exported network); offset from the middle
# of the cell to the centre, cells; log of radius over RADIUS_UNIT_PX; length of the streak over STREAK_UNIT_PX times
# cosine and sine of twice its direction, which needs no sign; log of the sigmas in px across and along the streak;
# logits of the appearance.
CHANNELS = (
    "score",
    "dx", "dy",
    "log_radius",
    "streak_cos", "streak_sin",
    "log_across", "log_along",
    "white", "black", "coloured", "striped",
)  # fmt: skip
# Units of the radius and of the streak in the maps.
RADIUS_UNIT_PX, STREAK_UNIT_PX = 7.0, 8.0
# Classes of the appearance of a ball.
APPEARANCES = CHANNELS[-4:]
# Limits of log(sigma / px).
LOG_SIGMA_LIMITS = (-4.0, 3.5)
# Least score of a peak.
MIN_PEAK_SCORE = 0.05
# Distance, radii of the weaker ball, within which it is an echo of a stronger one, and the same beside the middle of a
# streak.
ECHO_RADII, STREAK_ECHO_RADII = 0.6, 0.5
# A candidate within a streak is no echo with at least this score and a displacement that differs by this share of the
# streak: an echo has the same displacement.
MIN_SEPARATE_SCORE, MIN_STREAK_DIFFERENCE_SHARE = 0.5, 0.5


@dataclass(frozen=True, slots=True)
class CandidateDetections:
    """K candidate detections of a network, px of its image, best first."""

    centre: FloatArray
    """(K, 2)"""
    radius: FloatArray
    """(K,)"""
    streak: FloatArray
    """(K, 2) displacement during the exposure, sign unknown."""
    score: FloatArray
    """(K,) confidence scores in [0, 1]."""
    sigma_across: FloatArray
    """(K,) standard deviation of the centre across the streak."""
    sigma_along: FloatArray
    """(K,) the same along it."""
    appearance: FloatArray
    """(K, 4) probabilities of APPEARANCES; NaN if the network does not classify."""

    def __len__(self) -> int:
        return len(self.score)

    def take(self, rows: NDArray[np.int64] | BoolArray) -> CandidateDetections:
        """Select rows."""
        return take_rows(self, rows)

    def scale(self, factor: float, shift: FloatArray | tuple[float, float]) -> CandidateDetections:
        """Scale to an image `factor` times as large, shifted by `shift` px; pixel centres are at whole numbers."""
        return self.transform(lambda px: (px + 0.5) * factor - 0.5 + np.asarray(shift), factor)

    def transform(self, mapping: Callable[[FloatArray], FloatArray], factor: float) -> CandidateDetections:
        """Map the centres (K, 2) by a function, and scale all lengths by `factor`."""
        lengths = (self.sigma_across * factor, self.sigma_along * factor)
        return CandidateDetections(
            mapping(self.centre), self.radius * factor, self.streak * factor, self.score, *lengths, self.appearance
        )


NO_CANDIDATES = CandidateDetections(
    np.empty((0, 2)), np.empty(0), np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0), np.empty((0, 4))
)


def concatenate_candidates(parts: list[CandidateDetections]) -> CandidateDetections:
    """Concatenate any number of candidates.

    Args:
        parts: Candidates in px of the same image.

    Returns:
        Their rows in that order.
    """
    return concatenate_rows([NO_CANDIDATES, *parts])


def decode_maps(maps: Float32Array, min_score: float = MIN_PEAK_SCORE) -> CandidateDetections:
    """Decode maps to candidate detections.

    Args:
        maps: Maps (12, h, w); channels as in CHANNELS, the score as a probability.
        min_score: Least score of a peak.

    Returns:
        Candidates without echoes, px of the network's input, best first.
    """
    score = np.ascontiguousarray(maps[0])
    highest = cv2.dilate(score, np.ones((3, 3), np.uint8))
    row, column = np.nonzero((score >= highest) & (score > min_score))
    order = np.argsort(-score[row, column], kind="stable")
    row, column = row[order], column[order]
    at = maps[:, row, column].astype(np.float64)  # (12, K)
    cell = np.column_stack([column, row]) + 0.5 + at[1:3].T
    look = np.exp(at[8:] - at[8:].max(axis=0, initial=-np.inf))
    candidates = CandidateDetections(
        cell * STRIDE - 0.5,
        RADIUS_UNIT_PX * np.exp(np.clip(at[3], -3, 4)),
        decode_streaks(at[4:6].T),
        np.clip(at[0], 0, 1),
        np.exp(np.clip(at[6], *LOG_SIGMA_LIMITS)),
        np.exp(np.clip(at[7], *LOG_SIGMA_LIMITS)),
        (look / look.sum(axis=0)).T,
    )
    return candidates.take(select_non_echoes(candidates))


def decode_streaks(encoded: FloatArray) -> FloatArray:
    """Decode streaks (K, 2) px from their length times cosine and sine of twice their direction, units (K, 2)."""
    length = np.linalg.norm(encoded, axis=1)
    angle = np.arctan2(encoded[:, 1], encoded[:, 0]) / 2
    return np.asarray(STREAK_UNIT_PX * length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def select_non_echoes(candidates: CandidateDetections) -> BoolArray:
    """Select candidates that are no echoes of a better one near them or with a streak around them.

    Args:
        candidates: K candidates, best first.

    Returns:
        Mask (K,).
    """
    length = np.linalg.norm(candidates.streak, axis=1)
    along = candidates.streak / np.maximum(length, 1e-9)[:, None]
    off = candidates.centre[:, None] - candidates.centre[None]  # (K, K, 2) of rows from columns
    ahead = np.einsum("rci,ci->rc", off, along)
    inside = np.clip(ahead, -length / 2, length / 2)
    apart = np.linalg.norm(off - inside[..., None] * along[None], axis=-1)
    near = apart < np.where(np.abs(inside) < 1, ECHO_RADII, STREAK_ECHO_RADII) * candidates.radius[:, None]
    beside = np.linalg.norm(off, axis=-1) > ECHO_RADII * candidates.radius[:, None]
    near &= ~(
        beside
        & (candidates.score > MIN_SEPARATE_SCORE)[:, None]
        & (_streak_differences(candidates.streak) > MIN_STREAK_DIFFERENCE_SHARE * length)
    )
    is_selected = np.zeros(len(candidates), dtype=bool)
    for row in range(len(candidates)):
        is_selected[row] = not (near[row] & is_selected).any()
    return is_selected


def _streak_differences(streaks: FloatArray) -> FloatArray:
    """Differences (K, K), px, between streaks (K, 2) whose signs are unknown."""
    apart = (np.linalg.norm(streaks[:, None] + sign * streaks[None], axis=-1) for sign in (-1, 1))
    return np.asarray(np.minimum(*apart), dtype=np.float64)
