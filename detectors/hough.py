"""Balls without a network: discs of the size that the calibration predicts, which differ from the cloth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.candidates import candidate_centres
from detectors.cloth import Cloth, Floats32, learn_cloth, size
from detectors.colour import PLACES, ball_colours
from detectors.refine import Circles, fit_circles
from detectors.streaks import Streaks, find_streaks
from detectors.view import View, view_of
from models.detections import Detections
from models.scene import Scene, apply_homography

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

LEAST_SUPPORT = 0.55
"""Share of a circle's rays that must end at an edge."""
LEAST_COVER = 0.55
"""Share of the disc that must differ from the cloth."""
APART_RADII = 1.5
"""Two balls are at least two radii apart on the table; less than this, with the errors, and one of them is none."""
CUE_RADII = 0.5
"""Half width below which what touches a ball is left out of its shape: cues, lines."""
LEAST_SHARE = 0.72
"""Share of a shape that the discs found in it must cover, if they are balls."""
CLEAR_SCORE = 0.88
"""Score from which a ball needs no such proof."""
STREAK_SIGMA_PX, STREAK_SIGMA_SHARE = 0.35, 0.02
"""Error of a streak's middle: across it, working px, and along it in addition, share of its length."""


@dataclass(frozen=True, slots=True)
class Found:
    """Balls in one picture, columns as in `Detections`, px of that picture."""

    centre: Floats
    radius: Floats
    streak: Floats
    score: Floats
    sigma: Floats
    sigma_along: Floats

    def take(self, rows: NDArray[np.int64] | Bools) -> Found:
        """Some of the rows."""
        return Found(*(getattr(self, name)[rows] for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class BallFinder:
    """Finds the balls of one scene, picture by picture."""

    view: View
    cloth: Cloth

    def look(self, rgb: Bytes, frame: int = 0) -> Detections:
        """The balls in a picture (H, W, 3)."""
        working = self.view.picture(rgb, frame)
        contrast = self.cloth.contrast(working)
        strength = size(contrast)
        foreground = (strength > self.cloth.threshold) & self.view.area
        guesses, _ = candidate_centres(contrast, foreground, self.view)
        discs = self._discs(rgb, frame, guesses, foreground)
        streaks = find_streaks(self._moving(working, strength), strength, self.view)
        found = _without_overlaps(_joined(discs, self._swept(streaks, discs, frame)), self.view.scene, frame)
        return _as_detections(rgb, found, frame)

    def _discs(self, rgb: Bytes, frame: int, guesses: Floats, foreground: Bools) -> Found:
        scene = self.view.scene
        guessed = self.view.to_picture(guesses)
        circles = fit_circles(rgb, _moved(scene, guessed, frame), self.view.predicted_radius(guessed), self.cloth.basis)
        home = self.view.to_working(_moved_back(scene, circles.centre, frame))
        cover = _cover(foreground, home, self.view)
        allowed = _at(self.view.centres, home)
        good = np.asarray(allowed & (circles.support > LEAST_SUPPORT) & (cover > LEAST_COVER))
        found = _without_overlaps(_of_circles(circles, cover).take(good), scene, frame)
        return self._without_intruders(found, foreground, frame)

    def _without_intruders(self, found: Found, foreground: Bools, frame: int) -> Found:
        """Balls that account for the shape they are part of; hands and sleeves are larger than the discs on them."""
        radius = float(np.median(self.view.radius))
        half = max(1, round(CUE_RADII * radius))
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * half + 1, 2 * half + 1))
        wide = cv2.morphologyEx(foreground.astype(np.uint8), cv2.MORPH_OPEN, kernel)
        _, labels = cv2.connectedComponents(wide)
        home = self.view.to_working(_moved_back(self.view.scene, found.centre, frame))
        discs = np.zeros(labels.shape, np.uint8)
        for (x, y), r in zip(home, _at(self.view.radius, home), strict=True):
            cv2.circle(discs, (round(x * 16), round(y * 16)), round(1.15 * r * 16), 1, -1, shift=4)
        whole = np.bincount(labels.ravel())
        share = np.bincount(labels[discs > 0], minlength=len(whole)) / np.maximum(whole, 1)
        part = _at(labels, home)
        return found.take((part == 0) | (share[part] > LEAST_SHARE) | (found.score > CLEAR_SCORE))

    def _moving(self, working: Bytes, strength: Floats32) -> Bools:
        """What is neither cloth nor part of the median picture; the ends of a streak are faint."""
        faint = 0.6 * self.cloth.threshold
        moving: Bools = (strength > faint) & (self.cloth.moved(working) > faint) & self.view.area
        return moving

    def _swept(self, streaks: Streaks, discs: Found, frame: int) -> Found:
        """Streaks in px of the picture, without those that discs explain."""
        ends = [self.view.to_picture(streaks.centre + side * streaks.vector / 2) for side in (-1, 1)]
        first, last = (_moved(self.view.scene, end, frame) for end in ends)
        centre, vector = (first + last) / 2, last - first
        scale = float(np.sqrt(np.prod(self.view.scale)))
        length = np.linalg.norm(vector, axis=1)
        across = np.full(len(length), STREAK_SIGMA_PX / scale)
        along = np.hypot(across, STREAK_SIGMA_SHARE * length)
        swept = Found(centre, streaks.radius / scale, vector, streaks.fill, across, along)
        area = np.pi * swept.radius**2 + 2 * swept.radius * length
        inside = _inside(discs.centre, swept)
        explained = (inside * np.pi * discs.radius**2 * (discs.score > 0.7)).sum(axis=1) / area
        return swept.take(np.asarray(explained < 0.7))


def ball_finder(scene: Scene, pictures: Iterable[tuple[int, Bytes]]) -> BallFinder:
    """A finder for a scene that learns the cloth from (frame, picture (H, W, 3)) of the clip."""
    view = view_of(scene)
    return BallFinder(view, learn_cloth([view.picture(rgb, frame) for frame, rgb in pictures], view))


def _moved(scene: Scene, px: Floats, frame: int) -> Floats:
    motion = scene.camera.motion
    return px if motion is None else apply_homography(motion[frame], px)


def _moved_back(scene: Scene, px: Floats, frame: int) -> Floats:
    motion = scene.camera.motion
    return px if motion is None else apply_homography(np.linalg.inv(motion[frame]), px)


def _at(mask: NDArray[Any], working: Floats) -> NDArray[Any]:
    """Values (n,) of a picture at working px (n, 2)."""
    h, w = mask.shape
    u = np.clip(np.rint(working[..., 0]).astype(int), 0, w - 1)
    v = np.clip(np.rint(working[..., 1]).astype(int), 0, h - 1)
    return np.asarray(mask[v, u])


def _cover(foreground: Bools, home: Floats, view: View) -> Floats:
    radius = _at(view.radius, home)
    return np.asarray(_at(foreground, home[:, None] + 0.85 * radius[:, None, None] * PLACES).mean(axis=1))


def _of_circles(circles: Circles, cover: Floats) -> Found:
    score = np.clip(circles.support, 0, 1) * np.minimum(cover / 0.85, 1.0)
    none = np.zeros_like(circles.centre)
    return Found(circles.centre, circles.radius, none, score, circles.sigma, circles.sigma)


def _joined(discs: Found, streaks: Found) -> Found:
    """Discs outside the streaks, and the streaks first."""
    free = discs.take(~_inside(discs.centre, streaks).any(axis=0))
    return Found(*(np.concatenate([getattr(streaks, n), getattr(free, n)]) for n in Found.__slots__))


def _inside(points: Floats, streaks: Found) -> Bools:
    """Whether points (n, 2) lie in streaks: (K, n)."""
    length = np.maximum(np.linalg.norm(streaks.streak, axis=1), 1e-9)
    unit = streaks.streak / length[:, None]
    at = points[None] - streaks.centre[:, None]
    along = np.clip(np.einsum("kni,ki->kn", at, unit), -length[:, None] / 2, length[:, None] / 2)
    beside = np.linalg.norm(at - along[..., None] * unit[:, None], axis=-1)
    return np.asarray(beside < streaks.radius[:, None])


def _without_overlaps(found: Found, scene: Scene, frame: int) -> Found:
    """The best ones of those that cannot stand beside each other."""
    radius = scene.table.ball_radius
    xy = scene.camera.to_table(found.centre, radius, frame)
    kept: list[int] = []
    streaked = np.linalg.norm(found.streak, axis=1) > 0
    for row in np.lexsort((-found.score, ~streaked)):
        if all(np.linalg.norm(xy[row] - xy[other]) > APART_RADII * radius for other in kept):
            kept.append(int(row))
    return found.take(np.array(kept, dtype=np.int64))


def _as_detections(rgb: Bytes, found: Found, frame: int) -> Detections:
    colour, white = ball_colours(rgb, found.centre, found.radius)
    frames = np.full(len(found.score), frame, dtype=np.int64)
    score = np.clip(found.score, 0, 1)
    return Detections(
        frames, found.centre, found.radius, found.streak, colour, white, score, found.sigma, found.sigma_along
    )
