"""A fan: where balls may go, as the shaded ways of the courses of an ensemble, on the plan of the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, ImageArray
from video.drawing.palette import INK, WHITE, Colour, mix
from video.drawing.table_inset import SHIFT, SUPERSAMPLE, Inset
from video.drawing.table_plan import draw_plan

SHARES = ((0.9, 0.28), (0.5, 0.42))
"""Which courses are shaded together, and how strongly."""
STROKE = 4
"""px of the final picture: courses are drawn so wide that the gaps between them close."""
STILL = 0.01
"""m: a ball that no course moves farther has no fan."""


@dataclass(frozen=True, slots=True)
class Fan:
    """The future of one ball, drawn over its past."""

    name: str
    seen: FloatArray
    """(n, 2) m, until the moment of the prediction."""
    courses: FloatArray
    """(M, T, 2) m; NaN once potted."""
    outlying: FloatArray
    """(M,) share of the courses that are nearer to the middle."""
    after: FloatArray
    """(m, 2) m, where it was seen afterwards; empty if it was not."""

    @property
    def middle(self) -> FloatArray:
        """(T, 2) m, the course nearest to all others: a way that the ball can go, which a mean over bounces is not.

        The medoid by mean distance (Kaufman and Rousseeuw, 1987); a potted ball counts where it was lost.
        """
        if not self.courses.size:
            return np.empty((0, 2))
        lost = np.isnan(self.courses[..., 0])
        last = np.maximum.accumulate(np.where(lost, 0, np.arange(lost.shape[1])), axis=1)
        places = np.take_along_axis(self.courses, last[..., None], axis=1)
        away = [float(np.nan_to_num(np.linalg.norm(places - one, axis=2)).mean()) for one in places]
        middle: FloatArray = self.courses[int(np.argmin(away))]
        return middle


def draw_fans(table: Table, fans: Sequence[Fan], title: str) -> ImageArray:
    """A still (h, w, 3): shaded where 90 and 50 % of the courses go, in white their middle, in dots what came after."""

    def below(inset: Inset, colours: Sequence[Colour]) -> None:
        for fan, colour in zip(fans, colours, strict=True):
            _shade(inset, fan, colour)
        for fan, colour in zip(fans, colours, strict=True):
            _line(inset, fan.middle, mix(colour, WHITE, 0.6))
            for place in fan.after[np.isfinite(fan.after).all(axis=1)]:
                cv2.circle(
                    inset.ground, inset.plan(place).tolist(), 2 * SUPERSAMPLE << SHIFT, INK, -1, cv2.LINE_AA, SHIFT
                )

    return draw_plan(table, [fan.name for fan in fans], [fan.seen for fan in fans], np.empty((0, 2)), title, below)


def _shade(inset: Inset, fan: Fan, colour: Colour) -> None:
    there = np.where(np.isfinite(fan.courses), fan.courses, fan.courses[:, :1])
    spread = float(np.ptp(there, axis=1).max(initial=0.0)) if there.size else 0.0
    if spread < STILL:
        return
    for share, strength in SHARES:
        mask = np.zeros(inset.ground.shape[:2], np.uint8)
        for course in fan.courses[fan.outlying <= share]:
            line = course[np.isfinite(course).all(axis=1)]
            if len(line) > 1:
                cv2.polylines(mask, [inset.plan(line).reshape(-1, 1, 2)], False, 255, STROKE * SUPERSAMPLE,
                              cv2.LINE_AA, SHIFT)  # fmt: skip
        closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
        cover = closed.astype(np.float32)[..., None] * (strength / 255)
        ground = inset.ground.astype(np.float32)
        inset.ground[:] = np.rint(ground + (np.asarray(colour, np.float32) - ground) * cover).astype(np.uint8)


def _line(inset: Inset, path: FloatArray, colour: Colour) -> None:
    line = path[np.isfinite(path).all(axis=1)]
    if len(line) > 1:
        cv2.polylines(
            inset.ground, [inset.plan(line).reshape(-1, 1, 2)], False, colour, SUPERSAMPLE, cv2.LINE_AA, SHIFT
        )
