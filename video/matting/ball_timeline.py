"""Positions of all balls in the frames and between them, from tracks and fitted motion together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Fit
from models.core.scene import Scene, apply_homography
from models.core.tracks import Tracks
from models.core.trajectory import State, Trajectory
from models.core.typing import BoolArray, FloatArray, ImageArray
from video.drawing.palette import lab_to_rgb
from video.io.clip import Clip, read_frames
from video.matting.ball_matting import BallOutline

# px between two frames below which a ball stays untouched, as nobody can see the motion.
MIN_SHIFT_PX = 0.15
# px, and radii, between the observed positions in two frames above which a ball moves regardless of the fit: the
# measured circle of a half-occluded resting ball jumps by less.
MIN_OBSERVED_SHIFT_PX, MIN_OBSERVED_SHIFT_RADII = 2.0, 0.4
# px outside the frame within which an unobserved ball is still followed.
BORDER_MARGIN_PX = 40.0
# Limits of measured over expected radius of a ball: glare, dark rims and calibration explain no more.
RADIUS_RATIO = (0.8, 1.3)
# Share of the sum of two radii within which one ball occludes the other, and the radii of motion of both in a gap up to
# which optical flow follows the visible part better than matting.
OVERLAP_SHARE, SLOW_RADII = 0.9, 1.0
# The same limit for a ball that is unobserved in one of the two frames: its position is uncertain, so its matte would
# hold half of the other ball.
UNOBSERVED_SLOW_RADII = 2.0
# Positions per gap that measure when a ball moves, and px between two of them above which it moves.
GAP_POINTS, MIN_STEP_PX = 17, 0.01
# m/s from which a streak measures the shutter time; largest measured shutter time in frame intervals, errors included;
# radii of motion blur from which detectors report a streak.
MIN_STREAK_SPEED, MAX_SHUTTER_FRAMES, BLURRED_RADII = 0.1, 1.2, 1.0
# Points along the path of a streaked ball: enough for a rebound during one shutter time.
STREAK_POINTS = 7


@dataclass(frozen=True, slots=True)
class BallTimeline:
    """Positions of the balls in the frames and between them; T frames, N balls, pixels of each frame."""

    scene: Scene
    trajectory: Trajectory
    time_span: FloatArray
    """(N, 2) s, first and last time of the fitted motion of a ball; NaN without a fit."""
    frame: NDArray[np.int64]
    """(T,) index of the frame in the clip."""
    t: FloatArray
    """(T,) s."""
    centre: FloatArray
    """(T, N, 2) px, observed, else predicted by the motion; NaN if neither."""
    offset: FloatArray
    """(T, N, 2) px, observed minus predicted; 0 where either is missing."""
    radius: FloatArray
    """(T, N) px."""
    observed: BoolArray
    """(T, N) a detection exists in the frame."""
    moving: BoolArray
    """(T - 1, N) the ball moves between this frame and the next."""
    streak_path: FloatArray
    """(T, P, N, 2) px, relative to the centre: path of the ball while the shutter is open; P = 1 without streaks."""
    colour: NDArray[np.uint8]
    """(N, 3) sRGB."""
    motion_progress: FloatArray
    """(T - 1, G, N) elapsed share of the time for which a ball moves in a gap, at G evenly spaced times."""
    shutter_time: float = 0.0
    """s, from the streaks; 0 where there are none."""

    def state_at(self, t: FloatArray) -> State:
        """Return the state at times (K,) s; outside its time span a ball keeps the state at the nearer end."""
        state = self.trajectory.at(t)
        for ball in np.flatnonzero(np.isfinite(self.time_span[:, 0])):
            lost = ~np.isfinite(state.xy[:, ball, 0])
            if lost.any():
                state.xy[lost, ball] = self.trajectory.at(np.clip(t[lost], *self.time_span[ball])).xy[:, ball]
        return state

    def camera_motion_at(self, t: float | FloatArray) -> FloatArray | None:
        """Return homographies (..., 3, 3) from reference pixels to the frames at times (...), interpolated linearly.

        None for a still camera.
        """
        if self.scene.camera.motion is None:
            return None
        rows, share = self.locate_times(t)
        ends = rows, np.minimum(rows + 1, len(self.t) - 1)
        before, after = (self.scene.camera.motion_of(self.frame[end]) for end in ends)
        if before is None or after is None:
            return None
        share = share[..., None, None]
        mean: FloatArray = before / before[..., 2:, 2:] * (1 - share) + after / after[..., 2:, 2:] * share
        return mean

    def camera_step(self, start: float, end: float) -> FloatArray | None:
        """Return the homography (3, 3) from the frame at one time to that at another; None for a still camera."""
        before, after = self.camera_motion_at(start), self.camera_motion_at(end)
        return None if before is None or after is None else np.asarray(after @ np.linalg.inv(before), dtype=np.float64)

    def locate_time(self, t: float) -> tuple[int, float]:
        """Return the row of the last frame at or before time t, and the elapsed share of the gap to the next."""
        row, share = self.locate_times(t)
        return int(row), float(share)

    def locate_times(self, t: float | FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the rows of the last frames at or before times (...), and the elapsed shares of the gaps."""
        rows = np.maximum(np.searchsorted(self.t, np.asarray(t), side="right") - 1, 0)
        rows = np.asarray(np.minimum(rows, max(len(self.t) - 2, 0)))
        if len(self.t) < 2:
            return rows, np.zeros(rows.shape)
        share = (t - self.t[rows]) / (self.t[rows + 1] - self.t[rows])
        return rows, np.asarray(np.minimum(np.maximum(share, 0.0), 1.0))

    def project(self, xy: FloatArray, t: float | FloatArray) -> FloatArray:
        """Project table points (..., 2) m at the height of the ball centres to pixels (..., 2) of the frame at time t.

        With times (K,) the points are (K, N, 2), those of each time.
        """
        return self.to_frame_pixels(self.scene.camera.to_pixels(xy, self.scene.table.ball_radius), t)

    def to_frame_pixels(self, px: FloatArray, t: float | FloatArray) -> FloatArray:
        """Map reference pixels (..., 2) to those of the frame at time t; with times (K,) they are (K, N, 2)."""
        motion = self.camera_motion_at(t)
        if motion is None:
            return px
        return apply_homography(motion[:, None] if np.ndim(t) else motion, px)

    def centres_at(self, t: float | FloatArray, xy: FloatArray) -> FloatArray:
        """Return pixels (..., N, 2) of balls at `xy` (..., N, 2) m at times (...), corrected by observations.

        The residual of the motion in one frame passes into that of the next while the ball moves, so a resting ball
        that is
        about to be struck stays at its observed position.
        """
        rows, _ = self.locate_times(t)
        share = self.motion_progress_at(t)[..., None]
        drift = self.offset[rows] * (1 - share) + self.offset[np.minimum(rows + 1, len(self.t) - 1)] * share
        return np.asarray(self.project(xy, t) + drift, dtype=np.float64)

    def motion_progress_at(self, t: float | FloatArray) -> FloatArray:
        """Return the elapsed share (..., N) of the time for which each ball moves in its gap, at times (...)."""
        rows, share = self.locate_times(t)
        if not len(self.motion_progress):
            return np.zeros((*rows.shape, self.centre.shape[1]))
        place = share * (self.motion_progress.shape[1] - 1)
        low = np.minimum(place.astype(np.intp), self.motion_progress.shape[1] - 2)
        part = (place - low)[..., None]
        return np.asarray(
            self.motion_progress[rows, low] * (1 - part) + self.motion_progress[rows, low + 1] * part, dtype=np.float64
        )

    def streak_paths(self, t: FloatArray, shutter_time: float | FloatArray) -> FloatArray:
        """Return every ball's path (K, P, N, 2) px, relative to its middle, while a shutter is open around times (K,).

        The shutter time, s, is one number, or one for each time (K,).
        """
        shares = np.linspace(-0.5, 0.5, STREAK_POINTS if np.max(shutter_time) > 0 else 1)
        times = np.clip(t[:, None] + np.reshape(shutter_time, (-1, 1)) * shares, self.t[0], self.t[-1])
        xy = self.trajectory.at(times).xy
        px = self.scene.camera.to_pixels(xy, self.scene.table.ball_radius)
        return np.asarray(px - px[:, [len(shares) // 2]], dtype=np.float64)

    def outline(self, row: int, ball: int) -> BallOutline:
        """Return the outline of a ball during the shutter time of a frame."""
        centre = self.centre[row, ball]
        path = self.streak_path[row, :, ball]
        sharp = not np.isfinite(path).all() or np.ptp(path, axis=0).max() < 1
        return BallOutline(centre[None] if sharp else path + centre, centre, float(self.radius[row, ball]))

    def balls_to_matte(self, row: int) -> tuple[int, ...]:
        """Return the balls that move between two frames, and the resting balls that they occlude or uncover.

        Slow balls that overlap each other are left out: their positions are too uncertain for matting.
        """
        moving, centre, radius = self.moving[row], self.centre[row], self.radius[row]
        behind = np.zeros_like(moving)
        for ball in np.flatnonzero(moving):
            start, end = self.centre[row : row + 2, ball]
            along, to = end - start, centre - start
            share = np.clip(to @ along / max(float(along @ along), 1e-6), 0, 1)
            distance = np.hypot(*(to - share[:, None] * along).T)
            behind |= (distance < radius + radius[ball]) & (centre[:, 1] < max(start[1], end[1]))
        return tuple(int(ball) for ball in np.flatnonzero((moving | behind) & ~self._find_entangled(row)))

    def _find_entangled(self, row: int) -> BoolArray:
        """Return the balls (N,) that overlap others in a frame while both move little until the next."""
        radius = self.radius[row]
        reach = OVERLAP_SHARE * (radius[:, None] + radius)
        distance = np.linalg.norm(self.centre[row : row + 2, :, None] - self.centre[row : row + 2, None], axis=-1)
        over = (distance < reach).any(axis=0) & ~np.eye(len(radius), dtype=np.bool_)
        goes = np.linalg.norm(self.centre[row + 1] - self.centre[row], axis=-1)
        observed = self.observed[row] & self.observed[row + 1]
        fast = ~(goes < np.where(observed, SLOW_RADII, UNOBSERVED_SLOW_RADII) * radius)
        return np.asarray(over.any(axis=1) & ~fast & ~(over & fast).any(axis=1), dtype=np.bool_)


def read_rows(clip: Clip, timeline: BallTimeline, rows: Iterable[int]) -> Iterator[tuple[int, ImageArray]]:
    """Read (row, frame (H, W, 3)) of some rows of a timeline in ascending order."""
    wanted = sorted({int(row) for row in rows})
    frames = read_frames(clip, indices=timeline.frame[wanted])
    return ((row, image) for row, (_, image) in zip(wanted, frames, strict=True))


def build_ball_timeline(scene: Scene, tracks: Tracks, fit: Fit) -> BallTimeline:
    """Build the timeline of all balls from tracks and fitted motion.

    Args:
        scene: Table and camera.
        tracks: Observed positions in the frames.
        fit: Fitted motion of the same balls.

    Returns:
        The timeline.

    Raises:
        ValueError: Tracks and fit hold different balls.
    """
    camera, height = scene.camera, scene.table.ball_radius
    if fit.trajectory.ids != tracks.ids:
        raise ValueError(f"tracks and trajectory must hold the same balls; got {tracks.ids} and {fit.trajectory.ids}")
    modelled = fit.trajectory.at(tracks.t)
    xy = modelled.xy
    frames = np.broadcast_to(tracks.frame[:, None], xy.shape[:2])
    predicted = camera.to_pixels(xy, height, frames if camera.motion is not None else None)
    observed = tracks.is_observed & np.isfinite(tracks.px[..., 0])
    size = np.array([camera.width_px, camera.height_px])
    inside = np.all((predicted > -BORDER_MARGIN_PX) & (predicted < size + BORDER_MARGIN_PX), axis=-1, keepdims=True)
    centre = np.where(observed[..., None], tracks.px, np.where(inside, predicted, np.nan))
    offset = tracks.px - predicted
    offset[~(observed & np.isfinite(predicted[..., 0]))] = 0
    shutter_time = _estimate_shutter_time(tracks, modelled.v, height)
    radius = _estimate_radii(scene, tracks, np.where(np.isfinite(xy), xy, tracks.xy))
    inside_gaps = _project_between_frames(scene, tracks, fit.trajectory)
    moving = _find_moving_balls(scene, tracks, inside_gaps[:, ::4], radius)
    if camera.motion is None:
        offset, centre = _stabilize_resting_balls(offset, centre, predicted, observed, moving)
    timeline = BallTimeline(
        scene=scene, trajectory=fit.trajectory, time_span=_ball_time_spans(fit.trajectory),
        frame=tracks.frame, t=tracks.t, centre=centre, offset=offset, radius=radius, observed=observed,
        moving=moving, motion_progress=_compute_motion_progress(inside_gaps),
        streak_path=np.zeros((len(tracks.t), 1, len(tracks.ids), 2)), shutter_time=shutter_time,
        colour=np.array([lab_to_rgb(lab) for lab in tracks.colour], dtype=np.uint8).reshape(-1, 3),
    )  # fmt: skip
    if shutter_time == 0:
        return timeline
    return replace(timeline, streak_path=timeline.streak_paths(tracks.t, shutter_time))


def _stabilize_resting_balls(
    offset: FloatArray, centre: FloatArray, predicted: FloatArray, observed: BoolArray, moving: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return offsets and centres (T, N, 2) px in which a resting ball has one position for the whole rest.

    The measured circle of a half-occluded ball jumps; the median over its rest does not.
    """
    offset, centre = offset.copy(), centre.copy()
    for ball in range(moving.shape[1]):
        turns = np.flatnonzero(np.diff(np.concatenate([[False], ~moving[:, ball], [False]])))
        for start, end in turns.reshape(-1, 2):
            run = np.arange(start, end + 1)
            rows = run[observed[run, ball] & np.isfinite(predicted[run, ball, 0])]
            if len(rows):
                offset[run, ball] = np.median(offset[rows, ball], axis=0)
                centre[run, ball] = predicted[run, ball] + offset[run, ball]
    return offset, centre


def _estimate_radii(scene: Scene, tracks: Tracks, xy: FloatArray) -> FloatArray:
    """Return radii (T, N) px: the expected radius times the measured ratio of each ball; NaN without a position."""
    radius = np.full(xy.shape[:2], np.nan)
    for ball in range(xy.shape[1]):
        located = np.isfinite(xy[:, ball, 0])
        radius[located, ball] = scene.camera.radius_px(xy[located, ball], scene.table.ball_radius)
        both = located & np.isfinite(tracks.radius_px[:, ball])
        if both.any():
            radius[:, ball] *= np.clip(np.median(tracks.radius_px[both, ball] / radius[both, ball]), *RADIUS_RATIO)
    typical = np.median(radius[np.isfinite(radius)]) if np.isfinite(radius).any() else np.nan
    return np.asarray(np.clip(radius, typical / 3, typical * 3), dtype=np.float64)


def _ball_time_spans(trajectory: Trajectory) -> FloatArray:
    """Return the first start and the last end of every ball's motion (N, 2), s."""
    spans = np.full((len(trajectory.ids), 2), np.nan)
    for ball in range(len(trajectory.ids)):
        rows = trajectory.ball == ball
        if rows.any():
            spans[ball] = trajectory.start[rows].min(), trajectory.end[rows].max()
    return spans


def _project_between_frames(scene: Scene, tracks: Tracks, trajectory: Trajectory) -> FloatArray:
    """Return the balls (T - 1, G, N, 2), px of the reference frame, at G evenly spaced times of each gap."""
    share = np.linspace(0, 1, GAP_POINTS)
    times = tracks.t[:-1, None] + np.diff(tracks.t)[:, None] * share
    return scene.camera.to_pixels(trajectory.at(times).xy, scene.table.ball_radius)


def _compute_motion_progress(px: FloatArray) -> FloatArray:
    """Return the elapsed shares (T - 1, G, N) of the time in which balls move, from positions (T - 1, G, N, 2) px.

    For a resting ball it is the elapsed share of the gap.
    """
    steps = np.linalg.norm(np.diff(px, axis=1), axis=-1)
    moving = (steps > MIN_STEP_PX).astype(np.float64)
    none = ~moving.any(axis=1, keepdims=True)
    moving = np.where(none, 1.0, moving)
    progress = np.concatenate([np.zeros_like(moving[:, :1]), np.cumsum(moving, axis=1)], axis=1)
    return np.asarray(progress / progress[:, -1:], dtype=np.float64)


def _find_moving_balls(scene: Scene, tracks: Tracks, px: FloatArray, radius: FloatArray) -> BoolArray:
    """Return where a ball moves between two frames (T - 1, N).

    It moves where its fitted path, (T - 1, G, N, 2) px, is longer than `MIN_SHIFT_PX`, or where its observed step is
    large.
    """
    low = np.where(np.isfinite(px), px, np.inf).min(axis=1)
    high = np.where(np.isfinite(px), px, -np.inf).max(axis=1)
    fit_moves = (high - low).max(axis=-1) > MIN_SHIFT_PX
    observed_step = np.linalg.norm(np.diff(scene.camera.to_pixels(tracks.xy, scene.table.ball_radius), axis=0), axis=-1)
    return np.asarray(
        fit_moves | (observed_step > np.fmax(MIN_OBSERVED_SHIFT_PX, MIN_OBSERVED_SHIFT_RADII * radius[1:])),
        dtype=np.bool_,
    )


def _estimate_shutter_time(tracks: Tracks, v: FloatArray, radius: float) -> float:
    """Return the median of streak length over speed, s; 0 where streaks are no reliable measure.

    The shutter time is at most the frame interval, and motion blur applies to all balls of the same speed. Streaks that
    violate either are two merged balls or a hand.
    """
    if len(tracks.t) < 2:
        return 0.0
    step = float(np.median(np.diff(tracks.t)))
    length, speed = np.linalg.norm(tracks.streak, axis=-1), np.linalg.norm(v, axis=-1)
    is_usable = tracks.is_observed & np.isfinite(speed) & (speed > MIN_STREAK_SPEED)
    open_for = length[is_usable] / speed[is_usable]
    streaked = (open_for > 0) & (open_for < MAX_SHUTTER_FRAMES * step)
    if not streaked.any():
        return 0.0
    shutter_time = min(float(np.median(open_for[streaked])), step)
    blurred = speed[is_usable] * shutter_time > BLURRED_RADII * radius
    return 0.0 if blurred.any() and streaked[blurred].mean() < 0.5 else shutter_time
