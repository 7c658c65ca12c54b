"""Which ball is struck: the first to leave its place, for that is the cue ball whatever its colour looks like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.core.typing import FloatArray, IntArray

LEFT_RADII = 1.0
"""A ball has left its place when it is farther from it, and stays so."""
FEWEST_AT_REST = 3
"""Pictures that show a ball at its place before it leaves: one that moves from the start may have been hit before."""
HEAD_START = 2
"""Pictures by which it is ahead of the next ball, or nobody knows which of the two came first."""


def struck_ball(paths: Sequence[tuple[IntArray, FloatArray]], radius: float) -> int | None:
    """Index of the ball that is struck, of (picture (M,), place (M, 2) m) per ball; None where it does not show."""
    leaving = [_leaves_at(picture, xy, radius) for picture, xy in paths]
    moving = sorted((at, ball) for ball, at in enumerate(leaving) if at is not None)
    if not moving or (len(moving) > 1 and moving[1][0] < moving[0][0] + HEAD_START):
        return None
    return moving[0][1]


def _leaves_at(picture: IntArray, xy: FloatArray, radius: float) -> int | None:
    """The picture in which a ball is seen away from its first place and does not come back; None for one that stays."""
    if len(picture) <= FEWEST_AT_REST:
        return None
    home = np.median(xy[:FEWEST_AT_REST], axis=0)
    away = np.linalg.norm(xy - home, axis=1) > LEFT_RADII * radius
    if not away[-1] or away[:FEWEST_AT_REST].any():
        return None
    gone = len(away) - int(np.argmin(away[::-1])) if not away.all() else 0
    return int(picture[gone])
