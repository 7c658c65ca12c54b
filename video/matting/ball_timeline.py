"""Where the balls are in the real pictures and between them: tracks and motion brought together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Fit
from models.core.scene import Scene, apply_homography
from models.core.tracks import Tracks
from models.core.trajectory import State, Trajectory
from models.core.typing import BoolArray, FloatArray
from video.drawing.palette import lab_to_rgb
from video.matting.ball_matting import Outline

LEAST_SHIFT = 0.15
"""px between two pictures below which a ball is left as it is: no eye sees it."""
SEEN_SHIFT, SEEN_RADII = 2.0, 0.4
"""px, and radii, between the places seen in two pictures from which a ball moves, whatever the fit says: the circle of
a ball that rests half hidden jumps by less."""
OUTSIDE = 40.0
"""px beyond the border where a ball that is not seen is still followed."""
RADIUS_RATIO = (0.8, 1.3)
"""How far a ball's seen radius may lie from the expected one: glare, dark rims and calibration, no more."""
OVERLAP, SLOW_RADII = 0.9, 1.0
"""Share of the sum of two radii within which one ball hides a part of the other in the picture, and the radii that both
go in a gap up to which optical flow follows what is left of them better than it can be cut out."""
GUESSED_RADII = 2.0
"""The same of a ball that was not seen in one of both pictures: where it lies there is a guess, and what is cut out by
it holds half of the other ball."""
GAP_POINTS, LEAST_STEP = 17, 0.01
"""Places of a ball from one picture to the next by which it is told when it moves, and px between two of them by which
it does."""
LEAST_SPEED, LONGER, BLURRED_RADII = 0.1, 1.2, 1.0
"""m/s from which a streak tells how long the shutter was open, how many times longer than from picture to picture an
error may make that, and the radii that a ball goes in it from which detectors see a streak."""
STREAK_POINTS = 7
"""Points along the way of a streaked ball: enough to follow a rebound within one exposure."""


@dataclass(frozen=True, slots=True)
class Sightings:
    """Where the balls are in the real pictures and between them; T pictures, N balls, pixels of each picture."""

    scene: Scene
    trajectory: Trajectory
    span: FloatArray
    """(N, 2) s, first and last time at which a ball is known; NaN for a ball that never is."""
    frame: NDArray[np.int64]
    """(T,)"""
    t: FloatArray
    """(T,) s"""
    centre: FloatArray
    """(T, N, 2) px where seen, else where the motion puts it; NaN if neither."""
    offset: FloatArray
    """(T, N, 2) px, seen minus put; 0 where not both."""
    radius: FloatArray
    """(T, N) px"""
    observed: BoolArray
    """(T, N)"""
    moves: BoolArray
    """(T - 1, N) the ball moves between this picture and the next."""
    way: FloatArray
    """(T, P, N, 2) px, relative to the centre: where the ball goes while the shutter is open; P = 1 without streaks."""
    colour: NDArray[np.uint8]
    """(N, 3) sRGB"""
    gone: FloatArray
    """(T - 1, G, N) share of the time for which a ball moves, from this picture to the next, at evenly spaced times."""
    exposure: float = 0.0
    """s for which the shutter was open, by the streaks; 0 where none was seen."""

    def state(self, t: FloatArray) -> State:
        """State at times (K,); before and after a ball is known it is held at its ends."""
        state = self.trajectory.at(t)
        for ball in np.flatnonzero(np.isfinite(self.span[:, 0])):
            lost = ~np.isfinite(state.xy[:, ball, 0])
            if lost.any():
                state.xy[lost, ball] = self.trajectory.at(np.clip(t[lost], *self.span[ball])).xy[:, ball]
        return state

    def motion(self, t: float | FloatArray) -> FloatArray | None:
        """Reference pixels to the pictures at times t (...): (..., 3, 3), between two the mean; None if it is still."""
        motion = self.scene.camera.motion
        if motion is None:
            return None
        rows, share = self.places(t)
        here, there = motion[self.frame[rows]], motion[self.frame[np.minimum(rows + 1, len(self.t) - 1)]]
        share = share[..., None, None]
        mean: FloatArray = here / here[..., 2:, 2:] * (1 - share) + there / there[..., 2:, 2:] * share
        return mean

    def carry(self, start: float, end: float) -> FloatArray | None:
        """Pixels of the picture at one time to those of another (3, 3); None where the camera stands still."""
        here, there = self.motion(start), self.motion(end)
        return None if here is None or there is None else np.asarray(there @ np.linalg.inv(here), dtype=np.float64)

    def place(self, t: float) -> tuple[int, float]:
        """Row of the picture before time t, and the share of the way to the next."""
        row, share = self.places(t)
        return int(row), float(share)

    def places(self, t: float | FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """The same of times (...)."""
        rows = np.maximum(np.searchsorted(self.t, np.asarray(t), side="right") - 1, 0)
        rows = np.asarray(np.minimum(rows, max(len(self.t) - 2, 0)))
        if len(self.t) < 2:
            return rows, np.zeros(rows.shape)
        share = (t - self.t[rows]) / (self.t[rows + 1] - self.t[rows])
        return rows, np.asarray(np.minimum(np.maximum(share, 0.0), 1.0))

    def project(self, xy: FloatArray, t: float | FloatArray) -> FloatArray:
        """Table points (..., 2) in the plane of the centres, m, to pixels (..., 2) of the picture at time t.

        With times (K,) the points are (K, N, 2), those of each time.
        """
        return self.shown(self.scene.camera.to_pixels(xy, self.scene.table.ball_radius), t)

    def shown(self, px: FloatArray, t: float | FloatArray) -> FloatArray:
        """Reference pixels (..., 2) to those of the picture at time t; with times (K,) they are (K, N, 2)."""
        motion = self.motion(t)
        if motion is None:
            return px
        return apply_homography(motion[:, None] if np.ndim(t) else motion, px)

    def centres(self, t: float | FloatArray, xy: FloatArray) -> FloatArray:
        """Pixels (..., N, 2) of balls at `xy` (..., N, 2) m at times (...), carried by what was seen around.

        The miss of the motion in one picture passes into that in the next while the ball moves: one at rest that is
        about to be struck lies where it was seen.
        """
        rows, _ = self.places(t)
        share = self.gone_at(t)[..., None]
        drift = self.offset[rows] * (1 - share) + self.offset[np.minimum(rows + 1, len(self.t) - 1)] * share
        return np.asarray(self.project(xy, t) + drift, dtype=np.float64)

    def gone_at(self, t: float | FloatArray) -> FloatArray:
        """(..., N) share of the time for which a ball moves between two pictures that is past at times (...)."""
        rows, share = self.places(t)
        if not len(self.gone):
            return np.zeros((*rows.shape, self.centre.shape[1]))
        place = share * (self.gone.shape[1] - 1)
        low = np.minimum(place.astype(np.intp), self.gone.shape[1] - 2)
        part = (place - low)[..., None]
        return np.asarray(self.gone[rows, low] * (1 - part) + self.gone[rows, low + 1] * part, dtype=np.float64)

    def ways(self, t: FloatArray, exposure: float | FloatArray) -> FloatArray:
        """(K, P, N, 2) px, relative to the middle: every ball's way while a shutter is open for s around times (K,).

        The shutter is open equally long at all times, or as long as `exposure` (K,) says of each.
        """
        shares = np.linspace(-0.5, 0.5, STREAK_POINTS if np.max(exposure) > 0 else 1)
        times = np.clip(t[:, None] + np.reshape(exposure, (-1, 1)) * shares, self.t[0], self.t[-1])
        xy = self.trajectory.at(times).xy
        px = self.scene.camera.to_pixels(xy, self.scene.table.ball_radius)
        return np.asarray(px - px[:, [len(shares) // 2]], dtype=np.float64)

    def outline(self, row: int, ball: int) -> Outline:
        """Where a ball is during the exposure of a picture."""
        centre = self.centre[row, ball]
        way = self.way[row, :, ball]
        sharp = not np.isfinite(way).all() or np.ptp(way, axis=0).max() < 1
        return Outline(centre[None] if sharp else way + centre, centre, float(self.radius[row, ball]))

    def taken_out(self, row: int) -> tuple[int, ...]:
        """The balls that move between two pictures, and those at rest of which they hide or uncover a part.

        Without slow ones that lie over each other in the picture: their places are known too badly to cut them out.
        """
        moves, centre, radius = self.moves[row], self.centre[row], self.radius[row]
        behind = np.zeros_like(moves)
        for ball in np.flatnonzero(moves):
            start, end = self.centre[row : row + 2, ball]
            along, to = end - start, centre - start
            share = np.clip(to @ along / max(float(along @ along), 1e-6), 0, 1)
            apart = np.hypot(*(to - share[:, None] * along).T)
            behind |= (apart < radius + radius[ball]) & (centre[:, 1] < max(start[1], end[1]))
        return tuple(int(ball) for ball in np.flatnonzero((moves | behind) & ~self._entangled(row)))

    def _entangled(self, row: int) -> BoolArray:
        """(N,) balls that lie over others in a picture while neither they nor those go far before the next."""
        radius = self.radius[row]
        reach = OVERLAP * (radius[:, None] + radius)
        apart = np.linalg.norm(self.centre[row : row + 2, :, None] - self.centre[row : row + 2, None], axis=-1)
        over = (apart < reach).any(axis=0) & ~np.eye(len(radius), dtype=np.bool_)
        goes = np.linalg.norm(self.centre[row + 1] - self.centre[row], axis=-1)
        seen = self.observed[row] & self.observed[row + 1]
        fast = ~(goes < np.where(seen, SLOW_RADII, GUESSED_RADII) * radius)
        return np.asarray(over.any(axis=1) & ~fast & ~(over & fast).any(axis=1), dtype=np.bool_)


def sight(scene: Scene, tracks: Tracks, fit: Fit) -> Sightings:
    """Bring tracks and motion together in the pictures."""
    camera, height = scene.camera, scene.table.ball_radius
    if fit.trajectory.ids != tracks.ids:
        raise ValueError(f"tracks and trajectory must hold the same balls; got {tracks.ids} and {fit.trajectory.ids}")
    modelled = fit.trajectory.at(tracks.t)
    xy = modelled.xy
    frames = np.broadcast_to(tracks.frame[:, None], xy.shape[:2])
    put = camera.to_pixels(xy, height, frames if camera.motion is not None else None)
    observed = tracks.observed & np.isfinite(tracks.px[..., 0])
    size = np.array([camera.width_px, camera.height_px])
    inside = np.all((put > -OUTSIDE) & (put < size + OUTSIDE), axis=-1, keepdims=True)
    centre = np.where(observed[..., None], tracks.px, np.where(inside, put, np.nan))
    offset = tracks.px - put
    offset[~(observed & np.isfinite(put[..., 0]))] = 0
    exposure = _exposure(tracks, modelled.v, height)
    radius = _radii(scene, tracks, np.where(np.isfinite(xy), xy, tracks.xy))
    inside_gaps = _in_gaps(scene, tracks, fit.trajectory)
    moves = _moves(scene, tracks, inside_gaps[:, ::4], radius)
    if camera.motion is None:
        offset, centre = _steadied(offset, centre, put, observed, moves)
    return Sightings(
        scene=scene, trajectory=fit.trajectory, span=_spans(fit.trajectory), frame=tracks.frame, t=tracks.t,
        centre=centre, offset=offset, radius=radius, observed=observed,
        moves=moves, gone=_shares_gone(inside_gaps),
        way=_ways(scene, tracks, fit.trajectory, exposure), exposure=exposure,
        colour=np.array([lab_to_rgb(lab) for lab in tracks.colour], dtype=np.uint8).reshape(-1, 3),
    )  # fmt: skip


def _steadied(
    offset: FloatArray, centre: FloatArray, put: FloatArray, observed: BoolArray, moves: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Offsets and centres (T, N, 2) px where a ball that rests has one place from the first such picture to the last.

    The circle of a ball that another one half hides jumps; the median over its rest does not.
    """
    offset, centre = offset.copy(), centre.copy()
    for ball in range(moves.shape[1]):
        turns = np.flatnonzero(np.diff(np.concatenate([[False], ~moves[:, ball], [False]])))
        for start, end in turns.reshape(-1, 2):
            run = np.arange(start, end + 1)
            seen = run[observed[run, ball] & np.isfinite(put[run, ball, 0])]
            if len(seen):
                offset[run, ball] = np.median(offset[seen, ball], axis=0)
                centre[run, ball] = put[run, ball] + offset[run, ball]
    return offset, centre


def _radii(scene: Scene, tracks: Tracks, xy: FloatArray) -> FloatArray:
    """(T, N) px: the radius that the camera expects, in the proportion in which each ball was seen; NaN if nowhere."""
    radius = np.full(xy.shape[:2], np.nan)
    for ball in range(xy.shape[1]):
        known = np.isfinite(xy[:, ball, 0])
        radius[known, ball] = scene.camera.radius_px(xy[known, ball], scene.table.ball_radius)
        both = known & np.isfinite(tracks.radius_px[:, ball])
        if both.any():
            radius[:, ball] *= np.clip(np.median(tracks.radius_px[both, ball] / radius[both, ball]), *RADIUS_RATIO)
    usual = np.median(radius[np.isfinite(radius)]) if np.isfinite(radius).any() else np.nan
    return np.asarray(np.clip(radius, usual / 3, usual * 3), dtype=np.float64)


def _spans(trajectory: Trajectory) -> FloatArray:
    """(N, 2) s, first start and last end of every ball."""
    spans = np.full((len(trajectory.ids), 2), np.nan)
    for ball in range(len(trajectory.ids)):
        rows = trajectory.ball == ball
        if rows.any():
            spans[ball] = trajectory.start[rows].min(), trajectory.end[rows].max()
    return spans


def _in_gaps(scene: Scene, tracks: Tracks, trajectory: Trajectory) -> FloatArray:
    """(T - 1, G, N, 2) px of the reference picture, balls at evenly spaced times from one picture to the next."""
    share = np.linspace(0, 1, GAP_POINTS)
    times = tracks.t[:-1, None] + np.diff(tracks.t)[:, None] * share
    return scene.camera.to_pixels(trajectory.at(times).xy, scene.table.ball_radius)


def _shares_gone(px: FloatArray) -> FloatArray:
    """(T - 1, G, N) shares of the time in which balls move, of gaps (T - 1, G, N, 2) px; of all of it if they rest."""
    steps = np.linalg.norm(np.diff(px, axis=1), axis=-1)
    moving = (steps > LEAST_STEP).astype(np.float64)
    none = ~moving.any(axis=1, keepdims=True)
    moving = np.where(none, 1.0, moving)
    gone = np.concatenate([np.zeros_like(moving[:, :1]), np.cumsum(moving, axis=1)], axis=1)
    return np.asarray(gone / gone[:, -1:], dtype=np.float64)


def _moves(scene: Scene, tracks: Tracks, px: FloatArray, radius: FloatArray) -> BoolArray:
    """(T - 1, N) where a ball's way between two pictures, (T - 1, G, N, 2) px, is more than `LEAST_SHIFT`, or it was
    seen to move."""
    low = np.where(np.isfinite(px), px, np.inf).min(axis=1)
    high = np.where(np.isfinite(px), px, -np.inf).max(axis=1)
    put = (high - low).max(axis=-1) > LEAST_SHIFT
    seen = np.linalg.norm(np.diff(scene.camera.to_pixels(tracks.xy, scene.table.ball_radius), axis=0), axis=-1)
    return np.asarray(put | (seen > np.fmax(SEEN_SHIFT, SEEN_RADII * radius[1:])), dtype=np.bool_)


def _ways(scene: Scene, tracks: Tracks, trajectory: Trajectory, exposure: float) -> FloatArray:
    """(T, P, N, 2) px, relative to the middle: every ball's way while the shutter is open for `exposure` s."""
    if exposure == 0:
        return np.zeros((len(tracks.t), 1, len(tracks.ids), 2))
    times = tracks.t[:, None] + exposure * np.linspace(-0.5, 0.5, STREAK_POINTS)
    times = np.clip(times, tracks.t[0], tracks.t[-1])
    px = scene.camera.to_pixels(trajectory.at(times).xy, scene.table.ball_radius)
    return np.asarray(px - px[:, [STREAK_POINTS // 2]], dtype=np.float64)


def _exposure(tracks: Tracks, v: FloatArray, radius: float) -> float:
    """Median of streak length over speed where balls of a radius, m, are streaked, s; 0 where streaks are no measure.

    No shutter is open for longer than from one picture to the next, and one that blurs a ball blurs all that are as
    fast: what neither holds for is two balls taken for one, or a hand.
    """
    if len(tracks.t) < 2:
        return 0.0
    step = float(np.median(np.diff(tracks.t)))
    length, speed = np.linalg.norm(tracks.streak, axis=-1), np.linalg.norm(v, axis=-1)
    told = tracks.observed & np.isfinite(speed) & (speed > LEAST_SPEED)
    open_for = length[told] / speed[told]
    streaked = (open_for > 0) & (open_for < LONGER * step)
    if not streaked.any():
        return 0.0
    exposure = min(float(np.median(open_for[streaked])), step)
    blurred = speed[told] * exposure > BLURRED_RADII * radius
    return 0.0 if blurred.any() and streaked[blurred].mean() < 0.5 else exposure
