"""The balls on a picture of any time, as they are drawn."""

from __future__ import annotations

import numpy as np

from models.trajectory import State
from video.motion_marks import LEAST_SPEED
from video.overlay import Balls
from video.sightings import Sightings


def balls_at(sightings: Sightings, state: State, k: int, t: float) -> Balls:
    """The balls on the picture of time `t`, from the k-th of the times of `state`."""
    row, share = sightings.place(t)
    after = min(row + 1, len(sightings.t) - 1)
    centre = sightings.centres(t, state.xy[k])
    seen = np.isfinite(sightings.centre[row, :, 0])
    still = sightings.centre[row] * (1 - share) + sightings.centre[after] * share
    centre = np.where(np.isfinite(centre), centre, np.where(seen[:, None], still, np.nan))
    speed = np.linalg.norm(state.v[k], axis=1)
    moving = (np.nan_to_num(speed) > LEAST_SPEED) & sightings.moves[min(row, len(sightings.moves) - 1)]
    sure = ~state.measured[k] | sightings.observed[row] | sightings.observed[after]
    ahead = sightings.project(state.xy[k] + 0.01 * state.v[k], t) - sightings.project(state.xy[k], t)
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    heading = np.where(moving[:, None] & (length > 1e-6), ahead / np.maximum(length, 1e-6), 0.0)
    near = row if share < 0.5 else after
    radius = np.where(np.isfinite(sightings.radius[near]), sightings.radius[near], sightings.radius[row])
    told = np.where(moving | ~np.isfinite(speed), speed, 0.0)  # NaN where it is not known, as in a pocket
    return Balls(centre, radius, told, np.nan_to_num(heading), moving, state.measured[k], sure)
