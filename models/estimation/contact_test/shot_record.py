"""Record of a shot for the contact test: observations, events, and the fitted path of every ball.

From it come the candidate contacts of balls and cushions, each with its probability.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.fit_result import ShotExplanation
from models.core.naming import Naming, build_naming
from models.core.scene import Camera, Table
from models.core.shot import ClosePass, ContactTestResult
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.contact_test.contact_motion import (
    USUAL_CLOTH,
    BallWindow,
    ClothPriors,
    PossibleContact,
    make_ball_window,
)
from models.estimation.contact_test.contact_probability import evaluate_contact
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


# s to either side of a moment: farther away, deviations of a table from the laws of rolling exceed the noise.
WINDOW_TIME = 0.4
# Standard deviations of its time that samples keep from another event.
GUARD_SIGMAS = 3.0
# Ball radii: paths that pass each other within it may have met.
NEAR_PASS_RADII = 0.25
# s: an event and a near pass so close in time are one moment.
SAME_MOMENT_TIME = 0.06
# m/s below which a ball looks at rest.
REST_SPEED = 0.02


@dataclass(frozen=True, slots=True)
class CandidateContact:
    """A contact that may have happened."""

    ball: int
    other: str
    """The other ball or the cushion."""
    t: float
    t_sigma: float
    probability: float
    gap: float
    gap_sigma: float


def find_ball_candidates(record: ShotRecord, one: int, two: int) -> list[CandidateContact]:
    """Find every moment at which two balls may have touched, from the explanation of the shot.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.

    Returns:
        The moments, in order of time.
    """
    a, b = record.ids[one], record.ids[two]
    candidates: list[CandidateContact] = []
    for moment, probability in record.explanation.contacts_of(a, b):
        gap, gap_sigma = _gap_at(record, one, two, moment.t)
        candidate = CandidateContact(one, b, moment.t, moment.t_sigma, probability, gap, gap_sigma)
        if candidates and abs(candidates[-1].t - moment.t) < SAME_MOMENT_TIME:  # a moment of either ball lists it
            if candidates[-1].probability >= probability:
                continue
            candidates.pop()
        candidates.append(candidate)
    return candidates


def find_cushion_candidates(record: ShotRecord, one: int) -> list[CandidateContact]:
    """Find every moment at which a ball may have met a cushion, from the explanation of the shot.

    Args:
        record: The shot.
        one: Index of the ball.

    Returns:
        The moments, in order of time.
    """
    name, nan = record.ids[one], float("nan")
    return [
        CandidateContact(one, hypothesis.other, moment.t, moment.t_sigma, hypothesis.probability, nan, nan)
        for moment in record.explanation.moments
        if moment.ball == name
        for hypothesis in moment.hypotheses
        if hypothesis.cause == "cushion"
    ]


def find_unexplained_changes(record: ShotRecord, one: int) -> list[tuple[float, float]]:
    """Find when a moving ball changed its velocity for an unknown cause; a start that may be a strike is left out.

    A contact of two balls is a moment of one of them: of the other one, what is not that contact is unexplained.

    Args:
        record: The shot.
        one: Index of the ball.

    Returns:
        Time (s) and probability of each such moment.
    """
    name, changes = record.ids[one], {}
    for moment in record.explanation.moments:
        causes = {entry.cause: entry.probability for entry in moment.hypotheses}
        if "unexplained" not in causes or "strike" in causes:
            continue
        if moment.ball == name:
            changes[moment.t] = causes["unexplained"]
        elif (moment.best.cause, moment.best.other) == ("ball", name):
            changes.setdefault(moment.t, 1 - moment.best.probability)
    return list(changes.items())


def find_close_passes(record: ShotRecord) -> tuple[ClosePass, ...]:
    """Find where two balls pass each other so closely that they may have touched, and test that.

    Args:
        record: The shot.

    Returns:
        The passes with the results of the contact test; moments of listed contacts are left out.
    """
    passes = []
    for one in range(len(record.ids)):
        for two in range(one + 1, len(record.ids)):
            for t in _list_pass_times(record, one, two):
                result = evaluate_close_pass(record, one, two, t)
                if result is not None:
                    passes.append(ClosePass(one, two, result))
    return tuple(passes)


def evaluate_close_pass(record: ShotRecord, one: int, two: int, t: float) -> ContactTestResult | None:
    """Test whether two balls touched when they passed each other.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.
        t: s, about the time of the pass.

    Returns:
        The result; None with too few samples, or if the balls lie beside each other, so that neither comes nearer.
    """
    parties = {record.ids[one], record.ids[two]}
    with suppress(ValueError, np.linalg.LinAlgError):  # too few samples for a test
        balls = tuple(cut_ball_window(record, t, ball, parties) for ball in (one, two))
        question = PossibleContact(balls, 2 * record.table.ball_radius, record.reach_sigma, cloth=record.cloth)
        result = evaluate_contact(question, t)
        return result if result.t_sigma < WINDOW_TIME else None
    return None


def _gap_at(record: ShotRecord, one: int, two: int, t: float) -> tuple[float, float]:
    """Return the gap of two balls on free paths, and its sigma, m: of the event at t, else of the fitted paths."""
    events, names = record.events, {record.ids[one], record.ids[two]}
    for e in range(len(events)):
        is_pair = events.kind[e] == "ball" and {events.a[e], events.b[e]} == names
        if is_pair and abs(events.t[e] - t) < SAME_MOMENT_TIME and np.isfinite(events.gap[e]):
            return float(events.gap[e]), float(events.gap_sigma[e])
    k = int(np.argmin(np.abs(record.moments - t)))
    return float(record.gaps(one, two)[k]), record.gap_sigma(one, two, k)


def _list_pass_times(record: ShotRecord, one: int, two: int) -> list[float]:
    """List the times (s) of near passes of two paths without a listed contact of the balls."""
    names = record.ids[one], record.ids[two]
    contact_times = [moment.t for moment, _ in record.explanation.contacts_of(*names)]
    distance = record.gaps(one, two)
    speed = np.hypot(*(record.velocity[:, two] - record.velocity[:, one]).T)
    near = np.flatnonzero((distance < NEAR_PASS_RADII * record.table.ball_radius) & (speed > REST_SPEED))
    times = []
    for group in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        if len(group):
            t = float(record.moments[group[np.argmin(distance[group])]])
            if all(abs(t - recorded) > SAME_MOMENT_TIME for recorded in contact_times):
                times.append(t)
    return times


def cut_ball_window(record: ShotRecord, t: float, ball: int, parties: set[str]) -> BallWindow:
    """Cut the samples of a ball around a time, from its last event before to its next one after.

    Args:
        record: The shot.
        t: s.
        ball: Index of the ball.
        parties: Names of the bodies that take part in the event at t.

    Returns:
        The window with initial guesses of the state.

    Raises:
        ValueError: If there are no samples before t.
    """
    events, end = record.events, t + WINDOW_TIME
    begin = max(t - WINDOW_TIME, float(record.moments[0]))
    for e in range(len(events)):
        event_parties = {events.a[e], events.b[e]} - {""}
        if record.ids[ball] not in event_parties or events.kind[e] == "rest":
            continue
        if (
            events.kind[e] in ("ball", "cushion")
            and event_parties == parties
            and abs(events.t[e] - t) < SAME_MOMENT_TIME
        ):
            continue
        guard = GUARD_SIGMAS * float(events.t_sigma[e])
        if events.t[e] <= t:
            begin = max(begin, min(float(events.t[e]) + guard, t))
        else:
            end = min(end, max(float(events.t[e]) - guard, t))
    samples = record.select_samples(ball, begin, end)
    return make_ball_window(samples, t, begin, record.state_at(ball, begin))
