"""The struck ball: the first one to leave its place is the cue ball, whatever its colour looks like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.core.typing import FloatArray, IntArray

MIN_DEPARTURE_RADII = 1.0
"""Radii from its first place beyond which a ball has left it, if it stays away."""
MIN_REST_FRAMES = 3
"""Frames at rest before a ball leaves: one that moves from the start may have been hit before."""
MIN_HEAD_START = 2
"""Frames between the first and the second departure; with fewer the order is uncertain."""


def find_struck_ball(paths: Sequence[tuple[IntArray, FloatArray]], radius: float) -> int | None:
    """Find the ball struck first from frame indices (M,) and places (M, 2) m of each ball; None if uncertain."""
    departures = [_departure_frame(frame_index, xy, radius) for frame_index, xy in paths]
    ordered = sorted((at, ball) for ball, at in enumerate(departures) if at is not None)
    if not ordered or (len(ordered) > 1 and ordered[1][0] < ordered[0][0] + MIN_HEAD_START):
        return None
    return ordered[0][1]


def _departure_frame(frame_index: IntArray, xy: FloatArray, radius: float) -> int | None:
    """Find the frame index from which a ball stays away from its first place; None for one that stays."""
    if len(frame_index) <= MIN_REST_FRAMES:
        return None
    home = np.median(xy[:MIN_REST_FRAMES], axis=0)
    away = np.linalg.norm(xy - home, axis=1) > MIN_DEPARTURE_RADII * radius
    if not away[-1] or away[:MIN_REST_FRAMES].any():
        return None
    first_away = len(away) - int(np.argmin(away[::-1])) if not away.all() else 0
    return int(frame_index[first_away])
