"""A shot as the folder of a run tells it: what was seen, what happened, and where every ball was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.scene import Camera, Table
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.segmentation.track_segmentation import Samples

SCALE_SIGMA = 0.005
"""relative: what lens and unequal heights may add to the distance of two touching balls in a picture."""
HZ = 1000.0
"""Moments a second at which a path is kept."""
BALL_TOLERANCE = 1.3e-4
"""m: of a diameter, one set against another (WPA equipment specifications, section 16: 0.127 mm)."""
NOSE_SIGMA = 2e-3
"""m: what calibration misses and the rubber gives, where a cushion was seen."""
FEWEST = 12
"""Residuals that tell how noisy a ball was seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """N balls; rows of what was seen, and M moments of the fitted motion. Each is itself alone: it can be a key."""

    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    frame: NDArray[np.int64]
    """(T,) pictures, ascending, with the times at which they were shown."""
    shown: FloatArray
    """(T,) s."""
    ball: NDArray[np.int64]
    """(K,) whose observation; sorted by ball, then by time."""
    t: FloatArray
    """(K,) s."""
    xy: FloatArray
    """(K, 2) m."""
    px: FloatArray
    """(K, 2) px of the picture; NaN where not known."""
    sigma: FloatArray
    """(K,) m."""
    events: Events
    moments: FloatArray
    """(M,) s, even steps."""
    path: FloatArray
    """(M, N, 2) m; NaN where a ball is not."""
    velocity: FloatArray
    """(M, N, 2) m/s."""
    slip: FloatArray
    """(M, N, 2) m/s, velocity of the points that touch the cloth; NaN where unknown."""
    path_sigma: FloatArray
    """(M, N) m."""
    table: Table
    camera: Camera | None
    """None where the folder does not say how the table was seen."""

    def number(self, name: str) -> int:
        """Of a ball; ValueError for a name that is not there."""
        if name not in self.ids:
            raise ValueError(f"the balls are {', '.join(self.ids)}; there is no {name!r}")
        return self.ids.index(name)

    def frame_at(self, t: float) -> float:
        """Fractional picture at t (s)."""
        if len(self.shown) < 2:
            return float(self.frame[0]) if len(self.frame) else float("nan")
        k = int(np.clip(np.searchsorted(self.shown, t, side="right") - 1, 0, len(self.shown) - 2))
        share = (t - self.shown[k]) / (self.shown[k + 1] - self.shown[k])
        return float(self.frame[k] + share * (self.frame[k + 1] - self.frame[k]))

    def place(self, ball: int, t: float) -> FloatArray:
        """Where a ball is at t (s), (2,) m, on the fitted path; NaN where it is not."""
        both: FloatArray = np.array([np.interp(t, self.moments, self.path[:, ball, k]) for k in (0, 1)])
        return both

    def state(self, ball: int, t: float) -> FloatArray | None:
        """Place, velocity and slip (6,) of a ball at t (s) on the fitted path; None where it is not known."""
        k = int(np.clip(np.searchsorted(self.moments, t), 0, len(self.moments) - 1))
        parts = (self.path[k, ball], self.velocity[k, ball], np.nan_to_num(self.slip[k, ball]))
        state: FloatArray = np.concatenate(parts)
        return state if np.isfinite(state).all() else None

    def speed(self, ball: int, t: float) -> float:
        """m/s at t (s) on the fitted path; NaN where the ball is not."""
        k = int(np.clip(np.searchsorted(self.moments, t), 0, len(self.moments) - 1))
        return float(np.hypot(*self.velocity[k, ball]))

    def samples(self, ball: int, begin: float, end: float) -> Samples:
        """What was seen of a ball from begin to end (s), its errors as large as they scatter about the fitted path."""
        own = self.ball == ball
        rows = own & (self.t >= begin) & (self.t <= end)
        return Samples(self.t[rows], self.xy[rows], self.sigma[rows] * self._noise(own))

    def _noise(self, own: NDArray[np.bool_]) -> float:
        """Scatter about the fitted path over what the sigmas promise, where that can be told; 1/2 to 5."""
        ball = int(self.ball[own][0]) if own.any() else 0
        there = np.stack([np.interp(self.t[own], self.moments, self.path[:, ball, k]) for k in (0, 1)], axis=1)
        miss = np.hypot(*(self.xy[own] - there).T) / self.sigma[own]
        miss = miss[np.isfinite(miss)]
        # half of a two-dimensional normal lies within 1.1774 standard deviations
        return float(np.clip(np.median(miss) / 1.1774, 0.5, 5.0)) if len(miss) >= FEWEST else 1.0

    @property
    def reach_sigma(self) -> float:
        """m, of the distance at which two balls touch: their sizes, and the scale where a camera saw them."""
        if self.camera is None:
            return BALL_TOLERANCE
        corners, covariance = self.camera.corners_px, self.camera.corner_covariance
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
        known = np.sqrt(np.trace(covariance) / 4) / float(sides.min())  # of the shortest side, two corners' errors
        return float(np.hypot(BALL_TOLERANCE, np.hypot(SCALE_SIGMA, known) * 2 * self.table.ball_radius))

    @property
    def nose_sigma(self) -> float:
        """m, of where balls meet a cushion."""
        return NOSE_SIGMA if self.camera else BALL_TOLERANCE


def record_of(tracks: Tracks, events: Events, motion: Trajectory, table: Table, camera: Camera | None) -> Record:
    """A shot that was just fitted."""
    row, ball = np.nonzero(tracks.observed)
    order = np.lexsort((row, ball))
    row, ball = row[order], ball[order]
    sigma = np.sqrt((tracks.sigma[row, ball] ** 2 + tracks.sigma_along[row, ball] ** 2) / 2)
    t = np.arange(np.floor(tracks.t[0] * HZ), np.ceil(tracks.t[-1] * HZ) + 1) / HZ
    state = motion.at(t)
    turned = np.stack([state.w[..., 1], -state.w[..., 0]], axis=-1)
    return Record(
        tracks.ids, tracks.kinds, tracks.frame, tracks.t, ball.astype(np.int64), tracks.t[row], tracks.xy[row, ball],
        tracks.px[row, ball], sigma, events, t, state.xy, state.v, state.v - table.ball_radius * turned, state.sigma,
        table, camera,
    )  # fmt: skip
