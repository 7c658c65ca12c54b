"""Balls from the maps of a centre network: peaks of the score, and what the other channels say there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import BoolArray, Float32Array, FloatArray

STRIDE = 4
"""px per cell of the maps."""
COARSE_STRIDE = 8
"""The sides of a picture are multiples of this."""
CHANNELS = (
    "score",
    "dx", "dy",
    "log_radius",
    "streak_cos", "streak_sin",
    "log_across", "log_along",
    "white", "black", "coloured", "striped",
)  # fmt: skip
"""Of a map: score (in the exported network a probability) that a cell holds a centre; from the cell's middle to the
centre, cells; radius over RADIUS_UNIT_PX; length of the streak over STREAK_UNIT_PX times cosine and sine of twice its
direction, which needs no sign; sigma in px across and along the streak; logits of the look."""
RADIUS_UNIT_PX, STREAK_UNIT_PX = 7.0, 8.0
LOOKS = CHANNELS[-4:]
SIGMA_LIMITS = (-4.0, 3.5)
"""Of log(sigma / px)."""
LEAST_SCORE = 0.05
"""Below this a peak is not read."""
APART_RADII, STREAK_RADII = 0.6, 0.5
"""Of two peaks nearer than this the weaker one is the other's echo; the same for one beside the middle of a streak."""
OWN_SCORE, OWN_WAY = 0.5, 0.5
"""What lies in a streak, is seen with such a score, and moves otherwise by this share of the streak, is a ball of its
own: an echo tells of the same way."""


@dataclass(frozen=True, slots=True)
class Centres:
    """K balls that a network sees, px of the picture it was shown, best first."""

    centre: FloatArray
    """(K, 2)"""
    radius: FloatArray
    """(K,)"""
    streak: FloatArray
    """(K, 2) way travelled during the exposure, sign unknown."""
    score: FloatArray
    """(K,) in [0, 1]."""
    across: FloatArray
    """(K,) sigma of the centre across the streak."""
    along: FloatArray
    """(K,) and along it."""
    look: FloatArray
    """(K, 4) probabilities of LOOKS; NaN where the network does not tell."""

    def __len__(self) -> int:
        return len(self.score)

    def take(self, rows: NDArray[np.int64] | BoolArray) -> Centres:
        """Some of the rows."""
        return Centres(*(getattr(self, name)[rows] for name in self.__slots__))

    def scaled(self, factor: float, shift: FloatArray | tuple[float, float]) -> Centres:
        """The same in a picture `factor` times as large whose pixel (0, 0) lies at -`shift`; pixels have centres."""
        return self.placed(lambda px: (px + 0.5) * factor - 0.5 + np.asarray(shift), factor)

    def placed(self, where: Callable[[FloatArray], FloatArray], factor: float) -> Centres:
        """The same with centres (K, 2) where a function of them says, and lengths `factor` times as large."""
        lengths = (self.across * factor, self.along * factor)
        return Centres(where(self.centre), self.radius * factor, self.streak * factor, self.score, *lengths, self.look)


def no_centres() -> Centres:
    """Nothing seen."""
    none, pairs = np.empty(0), np.empty((0, 2))
    return Centres(pairs, none, pairs, none, none, none, np.empty((0, len(LOOKS))))


def chained(parts: list[Centres]) -> Centres:
    """Centres one after another."""
    names = Centres.__slots__
    return Centres(*(np.concatenate([getattr(part, name) for part in [no_centres(), *parts]]) for name in names))


def read_maps(maps: Float32Array, least_score: float = LEAST_SCORE) -> Centres:
    """Balls in maps (12, h, w) whose score is a probability."""
    score = np.ascontiguousarray(maps[0])
    highest = cv2.dilate(score, np.ones((3, 3), np.uint8))
    row, column = np.nonzero((score >= highest) & (score > least_score))
    order = np.argsort(-score[row, column], kind="stable")
    row, column = row[order], column[order]
    at = maps[:, row, column].astype(np.float64)  # (12, K)
    cell = np.column_stack([column, row]) + 0.5 + at[1:3].T
    look = np.exp(at[8:] - at[8:].max(axis=0, initial=-np.inf))
    found = Centres(
        cell * STRIDE - 0.5,
        RADIUS_UNIT_PX * np.exp(np.clip(at[3], -3, 4)),
        halved(at[4:6].T),
        np.clip(at[0], 0, 1),
        np.exp(np.clip(at[6], *SIGMA_LIMITS)),
        np.exp(np.clip(at[7], *SIGMA_LIMITS)),
        (look / look.sum(axis=0)).T,
    )
    return found.take(not_echoes(found))


def halved(doubled: FloatArray) -> FloatArray:
    """Streaks (K, 2) px from their length times cosine and sine of twice their direction, units (K, 2)."""
    length = np.linalg.norm(doubled, axis=1)
    angle = np.arctan2(doubled[:, 1], doubled[:, 0]) / 2
    return np.asarray(STREAK_UNIT_PX * length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def not_echoes(found: Centres) -> BoolArray:
    """Which balls (K,), best first, have no better one near them and lie in no better one's streak."""
    length = np.linalg.norm(found.streak, axis=1)
    along = found.streak / np.maximum(length, 1e-9)[:, None]
    off = found.centre[:, None] - found.centre[None]  # (K, K, 2) of rows from columns
    ahead = np.einsum("rci,ci->rc", off, along)
    inside = np.clip(ahead, -length / 2, length / 2)
    apart = np.linalg.norm(off - inside[..., None] * along[None], axis=-1)
    near = apart < np.where(np.abs(inside) < 1, APART_RADII, STREAK_RADII) * found.radius[:, None]
    beside = np.linalg.norm(off, axis=-1) > APART_RADII * found.radius[:, None]
    near &= ~(beside & (found.score > OWN_SCORE)[:, None] & (_unlike(found.streak) > OWN_WAY * length))
    kept = np.zeros(len(found), dtype=bool)
    for row in range(len(found)):
        kept[row] = not (near[row] & kept).any()
    return kept


def _unlike(streaks: FloatArray) -> FloatArray:
    """Differences (K, K), px, between streaks (K, 2) whose signs are unknown."""
    apart = (np.linalg.norm(streaks[:, None] + sign * streaks[None], axis=-1) for sign in (-1, 1))
    return np.asarray(np.minimum(*apart), dtype=np.float64)
