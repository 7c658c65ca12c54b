"""A rally as columns: places of its ball or shuttle frame by frame, and its flights at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.rally import Rally
from models.core.typing import BoolArray, FloatArray
from models.estimation.rally.rally_views import PlacesInSpace, evaluate_rally


@dataclass(frozen=True, slots=True, repr=False)
class RallyTracks:
    """Places of one ball or shuttle in K frames in which it was seen, or in which a flight puts it."""

    ids: tuple[str]
    frame: NDArray[np.int64]
    """(K,) indices in the file."""
    t: FloatArray
    """(K,) s."""
    px: FloatArray
    """(K, 2) px, as seen; where it was not seen, as the camera would show it."""
    xyz: FloatArray
    """(K, 3) m, of the flights; NaN where none covers the time."""
    sigma: FloatArray
    """(K,) m, root mean square of the standard deviations of x, y and z."""
    radius_px: FloatArray
    """(K,) px."""
    is_observed: BoolArray
    """(K,) False where physics filled it in."""

    def __len__(self) -> int:
        return len(self.frame)

    def __repr__(self) -> str:
        return f"RallyTracks({self.ids[0]}: {len(self)} frames, {int(self.is_observed.sum())} observed)"


@dataclass(frozen=True, slots=True)
class RallyTrajectory:
    """The flights of a rally as a function of time."""

    rally: Rally

    @property
    def ids(self) -> tuple[str]:
        """Id of the ball or shuttle."""
        return (self.rally.scene.sport.object.name,)

    def at(self, t: FloatArray | float) -> PlacesInSpace:
        """Evaluate the flights at times t (K,) s; NaN where none covers a time."""
        return evaluate_rally(self.rally, np.atleast_1d(np.asarray(t, np.float64)))


def tabulate_tracks(rally: Rally) -> RallyTracks:
    """Tabulate where the object is in every frame in which it was seen or a flight covers it."""
    places, sport = evaluate_rally(rally, rally.t), rally.scene.sport
    is_observed = np.isfinite(rally.px[:, 0])
    rows = np.flatnonzero(is_observed | np.isfinite(places.xyz[:, 0]))
    camera, frame, xyz = rally.scene.camera, rally.frame[rows], places.xyz[rows]
    px = np.where(is_observed[rows, None], rally.px[rows], camera.to_pixels(xyz, frame))
    # A ball's outline is a circle of its radius across the line of sight; the camera's right is such a direction.
    rays = camera.rays(px, frame)
    aside = np.cross(rays, np.array([0.0, 0.0, 1.0]))
    aside *= sport.object.radius / np.linalg.norm(aside, axis=1, keepdims=True)
    radius = np.linalg.norm(camera.to_pixels(xyz + aside, frame) - camera.to_pixels(xyz, frame), axis=1)
    sigma = np.sqrt(np.trace(places.covariance[rows], axis1=1, axis2=2) / 3)
    return RallyTracks((sport.object.name,), frame, rally.t[rows], px, xyz, sigma, radius, is_observed[rows])
