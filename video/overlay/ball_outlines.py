"""The balls on a picture of any time, as they are drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.trajectory import State
from models.core.typing import FloatArray
from video.matting.ball_timeline import Sightings
from video.overlay.frame_overlay import Balls
from video.overlay.motion_marks import LEAST_SPEED


def balls_at(sightings: Sightings, state: State, t: FloatArray) -> list[Balls]:
    """The balls on the pictures of times (K,), of which `state` is the state: (K, N)."""
    rows, share = sightings.places(t)
    after, moved = np.minimum(rows + 1, len(sightings.t) - 1), share[:, None, None]
    centre = sightings.centres(t, state.xy)
    still = sightings.centre[rows] * (1 - moved) + sightings.centre[after] * moved
    seen = np.isfinite(sightings.centre[rows, :, :1])
    centre = np.where(np.isfinite(centre), centre, np.where(seen, still, np.nan))
    speed = np.linalg.norm(state.v, axis=-1)
    moving = (np.nan_to_num(speed) > LEAST_SPEED) & sightings.moves[np.minimum(rows, len(sightings.moves) - 1)]
    sure = ~state.measured | sightings.observed[rows] | sightings.observed[after]
    near = np.where(share < 0.5, rows, after)
    radius = np.where(np.isfinite(sightings.radius[near]), sightings.radius[near], sightings.radius[rows])
    told = np.where(moving | ~np.isfinite(speed), speed, 0.0)  # NaN where it is not known, as in a pocket
    heading = _headings(sightings, state, t, moving)
    columns = (centre, radius, told, heading, moving, state.measured, sure)
    return [Balls(*row) for row in zip(*columns, strict=True)]


def _headings(sightings: Sightings, state: State, t: FloatArray, moving: NDArray[np.bool_]) -> FloatArray:
    """(K, N, 2) px, unit vectors of the motion; 0 at rest."""
    ahead = sightings.project(state.xy + 0.01 * state.v, t) - sightings.project(state.xy, t)
    length = np.linalg.norm(ahead, axis=-1, keepdims=True)
    return np.nan_to_num(np.where(moving[..., None] & (length > 1e-6), ahead / np.maximum(length, 1e-6), 0.0))
