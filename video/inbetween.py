"""Pictures at any time: the real ones with their moving balls set where the motion puts them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.fit import Fit
from models.scene import Scene, apply_homography
from models.tracks import Tracks
from models.trajectory import State, Trajectory
from video.clip import Clip, read_frames
from video.palette import lab_to_rgb
from video.plate import Plate, learn_plate
from video.sprites import SHADOW_RADII, Outline, Peeled, Sprite, paste, peel

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Picture = NDArray[np.uint8]

LEAST_SHIFT = 0.15
"""px between two pictures below which a ball is left as it is: no eye sees it."""
SEEN_SHIFT = 2.0
"""px between the places seen in two pictures from which a ball moves, whatever the fit says: well above their noise."""
MOST_SAMPLES, FEWEST_SAMPLES = 32, 13
"""Pictures, spread over the clip, that the plate is learnt from."""
PLATE_BYTES = 64_000_000
"""Memory for the swept pixels of those pictures; larger areas are learnt from fewer."""
OUTSIDE = 40.0
"""px beyond the border where a ball that is not seen is still followed."""
RADIUS_RATIO = (0.8, 1.3)
"""How far a ball's seen radius may lie from the expected one: glare, dark rims and calibration, no more."""
STREAK_POINTS = 7
"""Points along the way of a streaked ball: enough to follow a rebound within one exposure."""
DISSOLVE = (0.3, 0.7)
"""Share of the time between two pictures in which what is no ball passes from one to the other: short, so that hands
and cues are seen double only briefly."""


@dataclass(frozen=True, slots=True)
class Sightings:
    """Where the balls are in the real pictures and between them; T pictures, N balls, pixels of each picture."""

    scene: Scene
    trajectory: Trajectory
    span: Floats
    """(N, 2) s, first and last time at which a ball is known; NaN for a ball that never is."""
    frame: NDArray[np.int64]
    """(T,)"""
    t: Floats
    """(T,) s"""
    centre: Floats
    """(T, N, 2) px where seen, else where the motion puts it; NaN if neither."""
    offset: Floats
    """(T, N, 2) px, seen minus put; 0 where not both."""
    radius: Floats
    """(T, N) px"""
    observed: Mask
    """(T, N)"""
    moves: Mask
    """(T - 1, N) the ball moves between this picture and the next."""
    way: Floats
    """(T, P, N, 2) px, relative to the centre: where the ball goes while the shutter is open; P = 1 without streaks."""
    colour: NDArray[np.uint8]
    """(N, 3) sRGB"""

    def state(self, t: Floats) -> State:
        """State at times (K,); before and after a ball is known it is held at its ends."""
        state = self.trajectory.at(t)
        for ball in np.flatnonzero(np.isfinite(self.span[:, 0])):
            lost = ~np.isfinite(state.xy[:, ball, 0])
            if lost.any():
                state.xy[lost, ball] = self.trajectory.at(np.clip(t[lost], *self.span[ball])).xy[:, ball]
        return state

    def motion(self, t: float) -> Floats | None:
        """Reference pixels to the picture at time t (3, 3), between pictures their mean; None if it is still."""
        motion = self.scene.camera.motion
        if motion is None:
            return None
        row, share = self.place(t)
        here, there = motion[self.frame[row]], motion[self.frame[min(row + 1, len(self.t) - 1)]]
        mean: Floats = here / here[2, 2] * (1 - share) + there / there[2, 2] * share
        return mean

    def place(self, t: float) -> tuple[int, float]:
        """Row of the picture before time t, and the share of the way to the next."""
        row = int(np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, max(len(self.t) - 2, 0)))
        if len(self.t) < 2:
            return 0, 0.0
        return row, float(np.clip((t - self.t[row]) / (self.t[row + 1] - self.t[row]), 0, 1))

    def project(self, xy: Floats, t: float) -> Floats:
        """Table points (..., 2) in the plane of the centres, m, to pixels (..., 2) of the picture at time t."""
        px = self.scene.camera.to_pixels(xy, self.scene.table.ball_radius)
        motion = self.motion(t)
        return px if motion is None else apply_homography(motion, px)

    def centres(self, t: float, xy: Floats) -> Floats:
        """Pixels (N, 2) of balls at `xy` (N, 2) m at time t, carried by what was seen in the pictures around it."""
        row, share = self.place(t)
        after = min(row + 1, len(self.t) - 1)
        drift = self.offset[row] * (1 - share) + self.offset[after] * share
        return np.asarray(self.project(xy, t) + drift, dtype=np.float64)

    def outline(self, row: int, ball: int) -> Outline:
        """Where a ball is during the exposure of a picture."""
        centre = self.centre[row, ball]
        way = self.way[row, :, ball]
        sharp = not np.isfinite(way).all() or np.ptp(way, axis=0).max() < 1
        return Outline(centre[None] if sharp else way + centre, centre, float(self.radius[row, ball]))


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
    radius = _radii(scene, tracks, np.where(np.isfinite(xy), xy, tracks.xy))
    return Sightings(
        scene=scene, trajectory=fit.trajectory, span=_spans(fit.trajectory), frame=tracks.frame, t=tracks.t,
        centre=centre, offset=offset, radius=radius, observed=observed,
        moves=_moves(scene, tracks, fit.trajectory),
        way=_ways(scene, tracks, fit.trajectory, _exposure(tracks, modelled.v)),
        colour=np.array([lab_to_rgb(lab) for lab in tracks.colour], dtype=np.uint8).reshape(-1, 3),
    )  # fmt: skip


def _radii(scene: Scene, tracks: Tracks, xy: Floats) -> Floats:
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


def _spans(trajectory: Trajectory) -> Floats:
    """(N, 2) s, first start and last end of every ball."""
    spans = np.full((len(trajectory.ids), 2), np.nan)
    for ball in range(len(trajectory.ids)):
        rows = trajectory.ball == ball
        if rows.any():
            spans[ball] = trajectory.start[rows].min(), trajectory.end[rows].max()
    return spans


def _moves(scene: Scene, tracks: Tracks, trajectory: Trajectory) -> Mask:
    """(T - 1, N) where a ball's way between two pictures is more than `LEAST_SHIFT`, or it was seen to move."""
    share = np.linspace(0, 1, 5)
    times = tracks.t[:-1, None] + np.diff(tracks.t)[:, None] * share
    px = scene.camera.to_pixels(trajectory.at(times).xy, scene.table.ball_radius)
    low = np.where(np.isfinite(px), px, np.inf).min(axis=1)
    high = np.where(np.isfinite(px), px, -np.inf).max(axis=1)
    put = (high - low).max(axis=-1) > LEAST_SHIFT
    seen = np.linalg.norm(np.diff(scene.camera.to_pixels(tracks.xy, scene.table.ball_radius), axis=0), axis=-1)
    return np.asarray(put | (seen > SEEN_SHIFT), dtype=np.bool_)


def _ways(scene: Scene, tracks: Tracks, trajectory: Trajectory, exposure: float) -> Floats:
    """(T, P, N, 2) px, relative to the middle: every ball's way while the shutter is open for `exposure` s."""
    if exposure == 0:
        return np.zeros((len(tracks.t), 1, len(tracks.ids), 2))
    times = tracks.t[:, None] + exposure * np.linspace(-0.5, 0.5, STREAK_POINTS)
    times = np.clip(times, tracks.t[0], tracks.t[-1])
    px = scene.camera.to_pixels(trajectory.at(times).xy, scene.table.ball_radius)
    return np.asarray(px - px[:, [STREAK_POINTS // 2]], dtype=np.float64)


def _exposure(tracks: Tracks, v: Floats) -> float:
    """Median of streak length over speed where balls are streaked, s, at most the time between two pictures."""
    length, speed = np.linalg.norm(tracks.streak, axis=-1), np.linalg.norm(v, axis=-1)
    streaked = tracks.observed & (length > 0) & np.isfinite(speed) & (speed > 0.1)
    if not streaked.any() or len(tracks.t) < 2:
        return 0.0
    return float(min(np.median(length[streaked] / speed[streaked]), np.median(np.diff(tracks.t))))


def plate_of(sightings: Sightings, clip: Clip) -> Plate:
    """Learn what moving balls hide from pictures spread evenly over the clip."""
    swept = swept_by(sightings)
    count = int(np.clip(PLATE_BYTES // (4 * max(1, int(swept.sum()))), FEWEST_SAMPLES, MOST_SAMPLES))
    rows = np.unique(np.linspace(0, len(sightings.t) - 1, count).round().astype(np.int64))
    pictures = read_frames(clip, indices=sightings.frame[rows])
    return learn_plate(swept, (_sample(sightings, int(row), rgb) for row, (_, rgb) in zip(rows, pictures, strict=True)))


def swept_by(sightings: Sightings) -> Mask:
    """(H, W) reference pixels that a moving ball with its surroundings ever touches."""
    camera = sightings.scene.camera
    swept = np.zeros((camera.height_px, camera.width_px), dtype=np.uint8)
    for row, ball in zip(*np.nonzero(sightings.moves), strict=True):
        for side in (row, row + 1):
            if np.isfinite(sightings.centre[side, ball]).all():
                _stamp(swept, sightings.outline(side, ball), sightings.motion(float(sightings.t[side])))
    return swept > 0


def _stamp(mask: Picture, outline: Outline, motion: Floats | None) -> None:
    """Mark in reference pixels all that a ball can touch."""
    back = np.eye(3) if motion is None else np.linalg.inv(motion)
    way = apply_homography(np.asarray(back, dtype=np.float64), outline.way)
    thickness = int(np.ceil(2 * outline.reach)) + 8
    points = np.rint(np.concatenate([way, way[-1:]])).astype(np.int32)
    cv2.polylines(mask, [points.reshape(-1, 1, 2)], isClosed=False, color=255, thickness=thickness)
    cv2.circle(mask, points[0].tolist(), thickness // 2, 255, -1)


def _sample(sightings: Sightings, row: int, picture: Picture) -> tuple[Picture, Mask, Floats | None]:
    """A picture with the mask of its balls and their shadows, and its motion."""
    covered = np.zeros(picture.shape[:2], dtype=np.uint8)
    for ball in np.flatnonzero(np.isfinite(sightings.centre[row, :, 0])):
        outline = sightings.outline(row, int(ball))
        radius = int(np.ceil(SHADOW_RADII * outline.radius + outline.edge))
        for point in np.rint(outline.way).astype(int):
            cv2.circle(covered, point.tolist(), radius, 255, -1)
    return picture, covered > 0, sightings.motion(float(sightings.t[row]))


@dataclass(frozen=True, slots=True)
class Interval:
    """Two neighbouring real pictures, taken apart."""

    sightings: Sightings
    row: int
    first: Picture
    second: Picture
    balls: tuple[int, ...]
    before: Peeled
    after: Peeled

    def at(self, t: float, centres: Floats) -> Picture:
        """The picture (H, W, 3) at time t with balls at `centres` (N, 2) px; a real one where it falls on one."""
        share = self.sightings.place(t)[1] if t < self.sightings.t[self.row + 1] else 1.0
        if share in (0.0, 1.0):
            return (self.first if share == 0 else self.second).copy()
        picture = self._behind(t, share)
        for slot, ball in enumerate(self.balls):
            pair = ((self.before.sprites[slot], 1 - share), (self.after.sprites[slot], share))
            layers: list[tuple[Sprite, Floats, float]] = [
                (sprite, centres[ball], weight) for sprite, weight in pair if sprite is not None
            ]
            if layers and np.isfinite(centres[ball]).all():
                paste(picture, layers)
        return picture

    def _behind(self, t: float, share: float) -> Picture:
        """The two pictures without moving balls, one passing into the other."""
        x = float(np.clip((share - DISSOLVE[0]) / (DISSOLVE[1] - DISSOLVE[0]), 0, 1))
        weight = x * x * (3 - 2 * x)
        motion = self.sightings.motion(t)
        if weight in (0.0, 1.0):
            return self._carried(0 if weight == 0 else 1, motion)
        mixed: Picture = cv2.addWeighted(self._carried(0, motion), 1 - weight, self._carried(1, motion), weight, 0)
        return mixed

    def _carried(self, side: int, motion: Floats | None) -> Picture:
        """A copy of one side without moving balls, as a drifting camera sees it with another motion."""
        picture = (self.before, self.after)[side].behind
        own = self.sightings.motion(float(self.sightings.t[self.row + side]))
        if own is None or motion is None:
            return picture.copy()
        step, size = motion @ np.linalg.inv(own), (picture.shape[1], picture.shape[0])
        return np.asarray(cv2.warpPerspective(picture, step, size, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def open_interval(sightings: Sightings, plate: Plate, row: int, first: Picture, second: Picture) -> Interval:
    """Take the pictures of `row` and `row + 1` apart, to make any picture between them."""
    balls = tuple(int(ball) for ball in np.flatnonzero(sightings.moves[row]))
    sides = []
    for side, picture in ((row, first), (row + 1, second)):
        shown = _shown(sightings, plate, side, picture)
        sides.append(_part(sightings, plate, side, picture, balls, shown))
    return Interval(sightings, row, first, second, balls, sides[0], sides[1])


def _part(
    sightings: Sightings, plate: Plate, row: int, picture: Picture, balls: tuple[int, ...], shown: Mask
) -> Peeled:
    """Peel the shown ones of `balls` out of a picture."""
    mine = [ball for ball in balls if shown[ball]]
    if not mine:
        return Peeled(picture, (None,) * len(balls))
    others = [sightings.outline(row, int(ball)) for ball in np.flatnonzero(shown) if ball not in mine]
    motion = sightings.motion(float(sightings.t[row]))
    peeled = peel(picture, [sightings.outline(row, ball) for ball in mine], others, plate, motion)
    found = dict(zip(mine, peeled.sprites, strict=True))
    return Peeled(peeled.behind, tuple(found.get(ball) for ball in balls))


def _shown(sightings: Sightings, plate: Plate, row: int, picture: Picture) -> Mask:
    """(N,) balls in the picture: the observed, and where its colour is nearer to the ball's than to the plate's."""
    shown: Mask = sightings.observed[row].copy()
    for ball in np.flatnonzero(~shown & np.isfinite(sightings.centre[row, :, 0])):
        x, y = np.rint(sightings.centre[row, ball]).astype(int)
        half = max(1, int(sightings.radius[row, ball] / 2))
        height, width = picture.shape[:2]
        if not (half <= x < width - half and half <= y < height - half):
            continue
        box = (x - half, y - half, 2 * half + 1, 2 * half + 1)
        around, known = plate.patch(*box, sightings.motion(float(sightings.t[row])))
        if not known.all():
            continue
        seen = picture[box[1] : box[1] + box[3], box[0] : box[0] + box[2]].reshape(-1, 3).mean(axis=0)
        empty = around.reshape(-1, 3).mean(axis=0)
        shown[ball] = np.linalg.norm(seen - sightings.colour[ball]) < np.linalg.norm(seen - empty)
    return shown
