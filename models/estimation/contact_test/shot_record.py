"""Record of a shot for the contact test: observations, events, and the fitted path of every ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.fit_result import ShotExplanation
from models.core.naming import Naming, build_naming
from models.core.scene import Camera, Table
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.contact_test.contact_moment import USUAL_CLOTH, ClothPriors
from models.estimation.segmentation.track_segmentation import BallSamples

# Relative: effect of lens and unequal heights on the distance of two touching balls in an image.
SCALE_SIGMA = 0.005
# Moments per second of the stored path.
PATH_RATE = 1000.0
# m: of a diameter, one set against another (WPA equipment specifications, section 16: 0.127 mm).
DIAMETER_TOLERANCE = 1.3e-4
# m: calibration errors and soft rubber, where a cushion was filmed.
NOSE_SIGMA = 2e-3
# Least number of residuals that give the noise of a ball.
MIN_RESIDUALS = 12

# Of a shot whose hypotheses are not weighed yet.
NO_EXPLANATION = ShotExplanation()


@dataclass(frozen=True, slots=True, eq=False)
class ShotRecord:
    """Record of N balls: K observations, and M moments of the fitted motion.

    It is hashable by identity, so that it can be a cache key.
    """

    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    frame: NDArray[np.int64]
    """(T,) frame numbers, ascending, with their presentation times."""
    shown: FloatArray
    """(T,) s."""
    ball: NDArray[np.int64]
    """(K,) ball index; sorted by ball, then by time."""
    t: FloatArray
    """(K,) s."""
    xy: FloatArray
    """(K, 2) m."""
    px: FloatArray
    """(K, 2) px in the image; NaN if unknown."""
    sigma: FloatArray
    """(K,) m."""
    events: Events
    moments: FloatArray
    """(M,) s, even steps but for the first and the last one."""
    path: FloatArray
    """(M, N, 2) m; NaN where a ball is absent."""
    velocity: FloatArray
    """(M, N, 2) m/s."""
    slip: FloatArray
    """(M, N, 2) m/s, velocity of the points that touch the cloth; NaN if unknown."""
    path_sigma: FloatArray
    """(M, N) m."""
    table: Table
    camera: Camera | None
    """None where the folder does not contain the calibration."""
    explanation: ShotExplanation
    """What may have happened, with the weight of every hypothesis."""
    naming: Naming
    """What balls, rails and pockets are called."""
    cloth: ClothPriors = USUAL_CLOTH
    """What is known about the friction of the cloth."""

    def ball_index(self, name: str) -> int:
        """Return the index of a ball; raise ValueError for an unknown name."""
        if name not in self.ids:
            raise ValueError(f"the balls are {', '.join(self.ids)}; there is no {name!r}")
        return self.ids.index(name)

    def frame_at(self, t: float) -> float:
        """Return the fractional frame number at t (s)."""
        if len(self.shown) < 2:
            return float(self.frame[0]) if len(self.frame) else float("nan")
        k = int(np.clip(np.searchsorted(self.shown, t, side="right") - 1, 0, len(self.shown) - 2))
        share = (t - self.shown[k]) / (self.shown[k + 1] - self.shown[k])
        return float(self.frame[k] + share * (self.frame[k + 1] - self.frame[k]))

    def position_at(self, ball: int, t: float) -> FloatArray:
        """Return the place (2,) m of a ball at t (s) on the fitted path; NaN where it is absent."""
        both: FloatArray = np.array([np.interp(t, self.moments, self.path[:, ball, k]) for k in (0, 1)])
        return both

    def state_at(self, ball: int, t: float) -> FloatArray | None:
        """Return place, velocity and slip (6,) of a ball at t (s) on the fitted path; None if unknown."""
        k = int(np.clip(np.searchsorted(self.moments, t), 0, len(self.moments) - 1))
        parts = (self.path[k, ball], self.velocity[k, ball], np.nan_to_num(self.slip[k, ball]))
        state: FloatArray = np.concatenate(parts)
        return state if np.isfinite(state).all() else None

    def gaps(self, one: int, two: int) -> FloatArray:
        """Return the gaps (M,) m of two balls on the fitted paths; negative where they overlap."""
        return np.asarray(np.linalg.norm(self.path[:, two] - self.path[:, one], axis=1) - 2 * self.table.ball_radius)

    def gap_sigma(self, one: int, two: int, k: int) -> float:
        """Return the standard deviation, m, of the gap of two balls at moment k."""
        return float(np.hypot(np.hypot(*self.path_sigma[k, [one, two]]), self.reach_sigma))

    def place_sigma(self, ball: int, k: int) -> float:
        """Return the standard deviation, m, of the distance of a ball from a cushion, pocket or line at moment k."""
        return float(np.hypot(self.path_sigma[k, ball], self.nose_sigma))

    def speed_at(self, ball: int, t: float) -> float:
        """Return the speed, m/s, at t (s) on the fitted path; NaN where the ball is absent."""
        k = int(np.clip(np.searchsorted(self.moments, t), 0, len(self.moments) - 1))
        return float(np.hypot(*self.velocity[k, ball]))

    def select_samples(self, ball: int, begin: float, end: float) -> BallSamples:
        """Return the samples of a ball from begin to end (s), with errors scaled to their scatter about the path."""
        is_own = self.ball == ball
        rows = is_own & (self.t >= begin) & (self.t <= end)
        return BallSamples(self.t[rows], self.xy[rows], self.sigma[rows] * self._noise_scale(is_own))

    def _noise_scale(self, is_own: NDArray[np.bool_]) -> float:
        """Return the scatter about the fitted path over the sigmas, 1/2 to 5; 1 with too few residuals."""
        ball = int(self.ball[is_own][0]) if is_own.any() else 0
        fitted = np.stack([np.interp(self.t[is_own], self.moments, self.path[:, ball, k]) for k in (0, 1)], axis=1)
        deviation = np.hypot(*(self.xy[is_own] - fitted).T) / self.sigma[is_own]
        return estimate_noise_scale(deviation[np.isfinite(deviation)])

    @property
    def reach_sigma(self) -> float:
        """m, of the distance at which two balls touch: their sizes, and the scale if a camera filmed them."""
        return estimate_reach_sigma(self.table, self.camera)

    @property
    def nose_sigma(self) -> float:
        """m, of the contact line of a cushion."""
        return NOSE_SIGMA if self.camera else DIAMETER_TOLERANCE


def estimate_noise_scale(deviation: FloatArray) -> float:
    """Estimate the scale of deviations (K,), in stated sigmas, from a path: 1/2 to 5; 1 with too few of them."""
    # half of a two-dimensional normal lies within 1.1774 standard deviations
    return float(np.clip(np.median(deviation) / 1.1774, 0.5, 5.0)) if len(deviation) >= MIN_RESIDUALS else 1.0


def estimate_reach_sigma(table: Table, camera: Camera | None) -> float:
    """Estimate the uncertainty of the distance at which two balls touch, m, from their sizes and the calibration."""
    if camera is None:
        return DIAMETER_TOLERANCE
    corners, covariance = camera.corners_px, camera.corner_covariance
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    relative_sigma = np.sqrt(np.trace(covariance) / 4) / float(
        sides.min()
    )  # errors of two corners over the shortest side
    return float(np.hypot(DIAMETER_TOLERANCE, np.hypot(SCALE_SIGMA, relative_sigma) * 2 * table.ball_radius))


def make_shot_record(
    tracks: Tracks, events: Events, motion: Trajectory, table: Table, camera: Camera | None,
    explanation: ShotExplanation = NO_EXPLANATION,
) -> ShotRecord:  # fmt: skip
    """Make the record of a shot that was just fitted.

    Args:
        tracks: Tracks of N balls over T frames.
        events: Events of the fit.
        motion: Trajectory of the fit.
        camera: The calibration, if any.
        explanation: What may have happened.

    Returns:
        The record.
    """
    row, ball = np.nonzero(tracks.is_observed)
    order = np.lexsort((row, ball))
    row, ball = row[order], ball[order]
    sigma = np.sqrt((tracks.sigma[row, ball] ** 2 + tracks.sigma_along[row, ball] ** 2) / 2)
    t = np.arange(np.floor(tracks.t[0] * PATH_RATE), np.ceil(tracks.t[-1] * PATH_RATE) + 1) / PATH_RATE
    t = np.clip(t, tracks.t[0], tracks.t[-1])  # a path has no place before the first frame, nor after the last one
    state = motion.at(t)
    spin_velocity = np.stack([state.w[..., 1], -state.w[..., 0]], axis=-1)
    return ShotRecord(
        tracks.ids, tracks.kinds, tracks.frame, tracks.t, ball.astype(np.int64), tracks.t[row], tracks.xy[row, ball],
        tracks.px[row, ball], sigma, events, t, state.xy, state.v, state.v - table.ball_radius * spin_velocity,
        state.sigma, table, camera, explanation, build_naming(table, camera, tracks.ids, tracks.looks),
    )  # fmt: skip
