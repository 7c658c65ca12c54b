"""Balls without a network: discs of the size that the calibration predicts, which differ from the cloth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.hough.circle_candidates import candidate_centres
from detectors.hough.streak_candidates import Streaks, find_streaks, refine_streaks
from detectors.measurement.ball_colour import PLACES, ball_coats
from detectors.measurement.circle_fit import DIRECTIONS, Circles, fit_circles, measure_again, second_chances, softened
from detectors.measurement.cloth_background import Cloth, disc_kernel, learn_cloth, size
from detectors.measurement.frame_change import Memory, Scan, touched_places, windows
from detectors.measurement.frame_detections import NO_BALLS, Found, chained, inside, joined, without_overlaps
from detectors.measurement.working_view import View, view_of
from models.core.detections import Detections
from models.core.scene import Scene, apply_homography
from models.core.typing import BoolArray, ByteArray, FloatArray

LEAST_SUPPORT = 0.6
"""Share of a circle's rays that must end at an edge."""
LEAST_GUESS_COVER, LEAST_COVER = 0.3, 0.55
"""Share of the disc that must differ from the cloth, before and after the fit."""
LINK_RADII = 0.35
"""Half width below which what links a streak to something else is cut."""
CUE_RADII = 0.5
"""Half width below which what touches a ball is left out of its shape: cues, lines."""
MOST_REST, MOST_STILL_REST, MOST_REST_SHARE = 1.8, 5.0, 0.28
"""A shape of which this is left beside its discs is more than balls and their shadows: in discs, where it moves and
where it does not (shaded cushions do not), and as a share."""
FAINT = 0.6
"""Share of the threshold from which a moving pixel counts."""
CLEAR_SCORE, SURE_SCORE = 0.88, 0.955
"""Scores from which a ball on such a shape is believed: with cloth around it, and without."""
RING_RADII, MOST_RING = 1.3, 0.6
"""A ball beside a hand has cloth around it: the ring that is looked at, and how much of it may be something else."""
CLEAR_STRETCH, BESIDE_RADII = 0.8, 0.22
"""Length over radius up to which a clear disc is the better measure; a sure one up to twice as
much, if it is this far from the middle of the streak."""
STREAK_SIGMA_PX, STREAK_SIGMA_SHARE = 0.3, 0.03
"""Error of a streak's middle: across it, px, and along it in addition, share of its length."""


@dataclass(frozen=True, slots=True)
class BallFinder:
    """Finds the balls of one scene, picture by picture."""

    view: View
    cloth: Cloth

    def look(self, rgb: ByteArray, frame: int = 0) -> Detections:
        """The balls in a picture (H, W, 3)."""
        return self.follow(rgb, frame, None)[0]

    def follow(self, rgb: ByteArray, frame: int, memory: Memory | None) -> tuple[Detections, Memory]:
        """The balls in a picture (H, W, 3) of a clip, and what to hand over with the next one: that is faster.

        The memory's arrays are written over.
        """
        working = self.view.picture(rgb, frame)
        soft = softened(rgb)
        touched = touched_places(memory, working, self.view, self.cloth.threshold)
        known = self._known(rgb, soft, frame, memory, touched)
        parts = windows(touched, self.view)
        scan = self._scan(working, parts, memory)
        guesses = np.concatenate([np.empty((0, 2)), *(self._guesses(scan, part) for part in parts)])
        discs = self._discs(rgb, soft, frame, guesses[_at(touched, guesses)], known, scan)
        swept = self._swept(rgb, find_streaks(scan.moving, scan.strength, self.view), discs, frame)
        found = without_overlaps(joined(discs, swept), self.view.scene, frame)
        return _as_detections(rgb, found, frame), self._remembered(working, touched, scan, discs, frame, memory)

    def _known(self, rgb: ByteArray, soft: ByteArray, frame: int, memory: Memory | None, touched: BoolArray) -> Found:
        """Sharp balls of the picture before, measured anew; where one is lost, the place counts as touched."""
        if memory is None:
            return NO_BALLS
        home = memory.home[~_at(touched, memory.home)]
        relative = memory.relative[~_at(touched, memory.home)]
        reference = self.view.to_picture(home)
        expected = self.view.predicted_radius(reference)
        circles = measure_again(
            rgb,
            soft,
            _moved(self.view.scene, reference, frame),
            expected,
            relative,
            self._beneath(home),
            self.cloth.basis,
        )
        found = self._balls(circles, memory.scan.foreground, frame)
        if len(found.score) < len(home):
            gaps = np.linalg.norm(home[:, None] - self._home(found.centre, frame)[None], axis=-1)
            lost = home[~(gaps < _at(self.view.radius, home)[:, None]).any(axis=1)]
            touched |= self._discs_drawn(lost)
        return found

    def _remembered(
        self, working: ByteArray, touched: BoolArray, scan: Scan, discs: Found, frame: int, memory: Memory | None
    ) -> Memory:
        home = self._home(discs.centre, frame)
        relative = discs.radius / self.view.predicted_radius(self.view.to_picture(home))
        if memory is None or touched.all():
            return Memory(scan, working, home, relative, 0)
        cv2.copyTo(working, touched.astype(np.uint8), memory.searched)
        return Memory(scan, memory.searched, home, relative, memory.age + 1)

    def _scan(self, working: ByteArray, parts: list[tuple[slice, slice]], memory: Memory | None) -> Scan:
        """The scan of the picture before, done anew in parts of the picture."""
        h, w = self.view.radius.shape
        if memory is None:
            no = np.zeros((h, w), dtype=bool)
            scan = Scan(np.zeros((h, w, 3), np.float32), np.zeros((h, w), np.float32), no, no.copy())
        else:
            scan = memory.scan
        # The ends of a streak are faint.
        faint = FAINT * self.cloth.threshold
        kernel = disc_kernel(LINK_RADII * self.view.typical)
        for part in parts:
            contrast = self.cloth.contrast(working, part)
            strength = size(contrast)
            area = self.view.area[part]
            moving = (strength > faint) & (self.cloth.moved(working, part) > faint) & area
            opened = cv2.morphologyEx(moving.astype(np.uint8), cv2.MORPH_OPEN, kernel)
            scan.contrast[part], scan.strength[part] = contrast, strength
            scan.foreground[part] = (strength > self.cloth.threshold) & area
            scan.moving[part] = opened > 0
        return scan

    def _guesses(self, scan: Scan, part: tuple[slice, slice]) -> FloatArray:
        """Working px (n, 2) where balls may be in a part of the picture."""
        guesses, _ = candidate_centres(scan.contrast[part], scan.foreground[part], self.view.window(part))
        return np.add(guesses, (part[1].start, part[0].start), dtype=np.float64)

    def _discs(
        self, rgb: ByteArray, soft: ByteArray, frame: int, guesses: FloatArray, known: Found, scan: Scan
    ) -> Found:
        """Sharp balls near guesses (n, 2), working px, beside the known ones."""
        guesses = guesses[_cover(scan.foreground, guesses, self.view) > LEAST_GUESS_COVER]
        guessed = self.view.to_picture(guesses)
        expected = self.view.predicted_radius(guessed)
        cloth, basis = self._beneath(guesses), self.cloth.basis
        circles = fit_circles(rgb, soft, _moved(self.view.scene, guessed, frame), expected, cloth, basis)
        first = chained(self._balls(circles, scan.foreground, frame), known)
        intruders = self._intruders(first, scan, frame)
        free = ~_at(intruders, guesses)
        again = second_chances(rgb, soft, circles.take(free), expected[free], cloth[free], basis)
        found = chained(
            self._balls(again, scan.foreground, frame), self._balls(circles.take(~free), scan.foreground, frame)
        )
        found = without_overlaps(chained(found, known), self.view.scene, frame)
        home = self._home(found.centre, frame)
        alone = _ring(scan.foreground, home, self.view) < MOST_RING
        sure = (found.score > SURE_SCORE) | ((found.score > CLEAR_SCORE) & alone)
        doubtful = _at(intruders, home) | (_at(self.view.pockets, home) & (found.score < CLEAR_SCORE))
        return found.take(sure | ~doubtful)

    def _balls(self, circles: Circles, foreground: BoolArray, frame: int) -> Found:
        """Circles that are round, differ from the cloth and lie on the table."""
        home = self._home(circles.centre, frame)
        cover = _cover(foreground, home, self.view)
        good = _at(self.view.centres, home) & (circles.support > LEAST_SUPPORT) & (cover > LEAST_COVER)
        return without_overlaps(_of_circles(circles, cover).take(good), self.view.scene, frame)

    def _intruders(self, found: Found, scan: Scan, frame: int) -> BoolArray:
        """Shapes (h, w) that balls do not account for: hands and sleeves are larger than the discs on them."""
        inside = (scan.foreground & self.view.centres & ~self.view.pockets).astype(np.uint8)
        wide = cv2.morphologyEx(inside, cv2.MORPH_OPEN, disc_kernel(CUE_RADII * self.view.typical))
        spare = wide & ~self._discs_drawn(self._home(found.centre, frame))
        disc = np.pi * self.view.typical**2
        restless = np.count_nonzero((spare > 0) & scan.moving)
        if restless <= MOST_REST * disc and cv2.countNonZero(spare) <= MOST_STILL_REST * disc:
            return np.zeros(wide.shape, dtype=bool)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(wide)
        rest = np.bincount(labels[spare > 0], minlength=count)
        moved = np.bincount(labels[(spare > 0) & scan.moving], minlength=count)
        large = (moved > MOST_REST * disc) | (rest > MOST_STILL_REST * disc)
        intruder = large & (rest > MOST_REST_SHARE * stats[:, cv2.CC_STAT_AREA])
        intruder[0] = False
        return np.asarray(intruder[labels] if intruder.any() else np.zeros(labels.shape, dtype=bool))

    def _home(self, px: FloatArray, frame: int) -> FloatArray:
        """Px (n, 2) of a frame to working px."""
        return self.view.to_working(_moved_back(self.view.scene, px, frame))

    def _beneath(self, home: FloatArray) -> FloatArray:
        """RGB (n, 3) of the empty table at working px (n, 2)."""
        return np.asarray(_at(self.cloth.colour, home), dtype=np.float64)

    def _discs_drawn(self, home: FloatArray) -> BoolArray:
        """(h, w) working px within 1.15 radii of balls at working px (n, 2)."""
        drawn = np.zeros(self.view.radius.shape, np.uint8)
        for (x, y), r in zip(home, _at(self.view.radius, home), strict=True):
            cv2.circle(drawn, (round(x * 16), round(y * 16)), round(1.15 * float(r) * 16), 1, -1, shift=4)
        return np.asarray(drawn > 0)

    def _swept(self, rgb: ByteArray, streaks: Streaks, discs: Found, frame: int) -> Found:
        """Streaks in px of the picture, without short ones that a disc explains."""
        ends = [self.view.to_picture(streaks.centre + side * streaks.vector / 2) for side in (-1, 1)]
        first, last = (_moved(self.view.scene, end, frame) for end in ends)
        rough = Streaks((first + last) / 2, last - first, streaks.radius / self.view.scale, streaks.fill)
        fine = refine_streaks(rgb, rough, self.cloth.basis)
        length = np.linalg.norm(fine.vector, axis=1)
        across = np.full(len(length), STREAK_SIGMA_PX)
        along = np.hypot(across, STREAK_SIGMA_SHARE * length)
        swept = Found(fine.centre, fine.radius, fine.vector, fine.fill, across, along)
        within = inside(discs.centre, swept)
        beside = (
            np.linalg.norm(discs.centre[None] - swept.centre[:, None], axis=-1) > BESIDE_RADII * swept.radius[:, None]
        )
        stretch = (length / swept.radius)[:, None]
        # A whole outline that is not about the middle is a ball's, and the rest its shadow.
        short = (discs.score > CLEAR_SCORE) & (stretch < CLEAR_STRETCH)
        shadow = (discs.score > SURE_SCORE) & beside & (stretch < 2 * CLEAR_STRETCH)
        explained = np.asarray((within & (short | shadow)).any(axis=1))
        return swept.take(~explained)


def ball_finder(scene: Scene, pictures: Iterable[tuple[int, ByteArray]]) -> BallFinder:
    """A finder for a scene that learns the cloth from (frame, picture (H, W, 3)) of the clip."""
    view = view_of(scene)
    return BallFinder(view, learn_cloth([view.picture(rgb, frame) for frame, rgb in pictures], view))


def _moved(scene: Scene, px: FloatArray, frame: int) -> FloatArray:
    motion = scene.camera.motion
    return px if motion is None else apply_homography(motion[frame], px)


def _moved_back(scene: Scene, px: FloatArray, frame: int) -> FloatArray:
    motion = scene.camera.motion
    return px if motion is None else apply_homography(np.linalg.inv(motion[frame]), px)


def _at(mask: NDArray[Any], working: FloatArray) -> NDArray[Any]:
    """Values (n,) of a picture at working px (n, 2)."""
    h, w = mask.shape[:2]
    u = np.clip(np.rint(working[..., 0]).astype(int), 0, w - 1)
    v = np.clip(np.rint(working[..., 1]).astype(int), 0, h - 1)
    return np.asarray(mask[v, u])


def _ring(foreground: BoolArray, home: FloatArray, view: View) -> FloatArray:
    """Share (n,) of the ring around discs at working px (n, 2) that is not cloth."""
    radius = _at(view.radius, home)
    ring = home[:, None] + RING_RADII * radius[:, None, None] * DIRECTIONS
    return np.asarray(_at(foreground, ring).mean(axis=1), dtype=np.float64)


def _cover(foreground: BoolArray, home: FloatArray, view: View) -> FloatArray:
    radius = _at(view.radius, home)
    return np.asarray(_at(foreground, home[:, None] + 0.85 * radius[:, None, None] * PLACES).mean(axis=1))


def _of_circles(circles: Circles, cover: FloatArray) -> Found:
    score = np.clip(circles.support, 0, 1) * np.minimum(cover / 0.85, 1.0)
    none = np.zeros_like(circles.centre)
    return Found(circles.centre, circles.radius, none, score, circles.sigma, circles.sigma)


def _as_detections(rgb: ByteArray, found: Found, frame: int) -> Detections:
    coats = ball_coats(rgb, found.centre, found.radius)
    frames = np.full(len(found.score), frame, dtype=np.int64)
    score = np.clip(found.score, 0, 1)
    return Detections(
        frames, found.centre, found.radius, found.streak, coats.colour, coats.white, coats.white_rim, coats.value,
        score, found.sigma, found.sigma_along,
    )  # fmt: skip
