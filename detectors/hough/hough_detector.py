"""Detection without a network: discs of the predicted size, and streaks of that width, that differ from the cloth.

Candidate discs of the expected size: every edge pixel votes for the centre one radius away from it.

Hough transform with a known radius (Duda and Hart 1972, doi:10.1145/361237.361242; the gradient gives the direction,
Kimme et al. 1975, doi:10.1145/360666.360677).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.hough.streak_candidates import find_streak_candidates, refine_streaks
from detectors.measurement.ball_colour import DISC_SAMPLES
from detectors.measurement.circle_fit import (
    DIRECTIONS,
    Circles,
    fit_circles,
    refit_circles,
    retry_doubtful_circles,
    smooth_image,
)
from detectors.measurement.cloth_background import (
    ClothBackground,
    build_disc_kernel,
    contrast_strength,
    learn_cloth_background,
)
from detectors.measurement.frame_change import ForegroundScan, SearchMemory, find_touched_places, find_windows
from detectors.measurement.frame_detections import (
    NO_BALLS,
    FrameDetections,
    add_colours,
    is_inside_streaks,
    merge_discs_and_streaks,
    select_shaded,
    suppress_overlaps,
)
from detectors.measurement.working_view import WorkingView, build_view, values_at
from models.core.array_columns import concatenate_rows
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

# Least share of a circle's rays that end at an edge.
MIN_SUPPORT = 0.6
# Least share of the disc that differs from the cloth, before and after the fit.
MIN_CANDIDATE_COVERAGE, MIN_COVERAGE = 0.3, 0.55
# Radius, ball radii, within which coverage is sampled, and coverage from which the score depends on the outline alone.
SAMPLED_RADII, FULL_COVERAGE = 0.85, 0.85
# Half width, ball radii, below which links between a streak and other objects are cut.
LINK_RADII = 0.35
# Half width, ball radii, below which objects that touch a ball are excluded from its shape: cues, lines.
CUE_RADII = 0.5
# A shape with more than this left beside its discs is more than balls and their shadows: area in discs, where it moves
# and where it does not (shaded cushions do not), and share of the shape.
MAX_MOVING_REST, MAX_STILL_REST, MAX_REST_SHARE = 1.8, 5.0, 0.28
# Share of the cloth's threshold from which a moving pixel counts: the ends of a streak are faint.
FAINT_SHARE = 0.6
# Confidence scores from which a ball on such a shape is accepted: with cloth around it, and without.
CLEAR_SCORE, SURE_SCORE = 0.88, 0.955
# Radius of the ring around a ball in which cloth is looked for, and largest share of it that is not cloth.
RING_RADII, MAX_RING_COVERAGE = 1.3, 0.6
# Radius of the discs that stand for balls in masks, ball radii.
DRAWN_RADII = 1.15
# Length of a streak, ball radii, up to which a clear disc is the better measurement; a sure disc up to twice that, if
# it is this far from the middle of the streak.
CLEAR_LENGTH_RADII, OFF_CENTRE_RADII = 0.8, 0.22


@dataclass(frozen=True, slots=True)
class HoughDetector:
    """Detects the balls of one scene without a network, frame by frame."""

    view: WorkingView
    cloth: ClothBackground

    def detect(self, rgb: ByteArray, frame: int = 0) -> Detections:
        """Detect the balls in an image (H, W, 3)."""
        return self.detect_next(rgb, frame, None)[0]

    def detect_next(self, rgb: ByteArray, frame: int, memory: SearchMemory | None) -> tuple[Detections, SearchMemory]:
        """Detect the balls in the next frame of a clip; searching only changed places is faster.

        Args:
            rgb: Image (H, W, 3).
            frame: Number of the frame.
            memory: State after the previous frame, None for the first; its arrays are overwritten.

        Returns:
            The balls, and the state for the next frame.
        """
        working = self.view.working_image(rgb, frame)
        smooth = smooth_image(rgb)
        touched = find_touched_places(memory, working, self.view, self.cloth.threshold)
        remembered = self._measure_remembered(rgb, smooth, working, frame, memory, touched)
        parts = find_windows(touched, self.view)
        scan = self._update_scan(working, parts, memory)
        candidates = np.concatenate([np.empty((0, 2)), *(self._find_candidates(scan, part) for part in parts)])
        candidates = candidates[values_at(touched, candidates)]
        discs = self._detect_discs(rgb, smooth, working, frame, candidates, remembered, scan)
        centre = self.view.frame_to_working(discs.centre, frame)
        discs = discs.take(~self.cloth.is_lining(working, centre, values_at(self.view.radius, centre)))
        streaks = self._detect_streaks(rgb, find_streak_candidates(scan.moving, scan.strength, self.view), discs, frame)
        balls = suppress_overlaps(merge_discs_and_streaks(discs, streaks), self.view.scene, frame)
        shaded = select_shaded(rgb, balls)
        return add_colours(rgb, shaded, frame), self._update_memory(working, touched, scan, discs, frame, memory)

    def _measure_remembered(
        self,
        rgb: ByteArray,
        smooth: ByteArray,
        working: ByteArray,
        frame: int,
        memory: SearchMemory | None,
        touched: BoolArray,
    ) -> FrameDetections:
        """Measure the sharp balls of the previous frame again; add the places of missed ones to `touched`."""
        if memory is None:
            return NO_BALLS
        is_untouched = ~values_at(touched, memory.working_centre)
        working_centre, relative_radius = memory.working_centre[is_untouched], memory.relative_radius[is_untouched]
        reference = self.view.to_reference(working_centre)
        circles = refit_circles(
            rgb,
            smooth,
            self.view.reference_to_frame(reference, frame),
            self.view.predict_radius(reference),
            relative_radius,
            self._cloth_colour_at(working_centre),
            self.cloth.basis,
        )
        balls = self._accept_circles(circles, memory.scan, working, frame)
        if len(balls) < len(working_centre):
            measured_centre = self.view.frame_to_working(balls.centre, frame)
            distance = np.linalg.norm(working_centre[:, None] - measured_centre[None], axis=-1)
            is_missed = ~(distance < values_at(self.view.radius, working_centre)[:, None]).any(axis=1)
            touched |= self._draw_discs(working_centre[is_missed])
        return balls

    def _update_memory(
        self,
        working: ByteArray,
        touched: BoolArray,
        scan: ForegroundScan,
        discs: FrameDetections,
        frame: int,
        memory: SearchMemory | None,
    ) -> SearchMemory:
        working_centre = self.view.frame_to_working(discs.centre, frame)
        relative_radius = discs.radius / self.view.predict_radius(self.view.to_reference(working_centre))
        if memory is None or touched.all():
            return SearchMemory(scan, working, working_centre, relative_radius, 0)
        cv2.copyTo(working, touched.astype(np.uint8), memory.searched_image)
        return SearchMemory(scan, memory.searched_image, working_centre, relative_radius, memory.age + 1)

    def _update_scan(
        self, working: ByteArray, parts: list[tuple[slice, slice]], memory: SearchMemory | None
    ) -> ForegroundScan:
        """Repeat the scan of the previous frame in parts of the working image."""
        h, w = self.view.radius.shape
        if memory is None:
            no = np.zeros((h, w), dtype=bool)
            scan = ForegroundScan(np.zeros((h, w, 3), np.float32), np.zeros((h, w), np.float32), no, no.copy())
        else:
            scan = memory.scan
        faint = FAINT_SHARE * self.cloth.threshold
        kernel = build_disc_kernel(LINK_RADII * self.view.median_radius)
        for part in parts:
            contrast = self.cloth.measure_contrast(working, part)
            strength = contrast_strength(contrast)
            area = self.view.ball_area[part]
            moving = (strength > faint) & (self.cloth.measure_movement(working, part) > faint) & area
            opened = cv2.morphologyEx(moving.astype(np.uint8), cv2.MORPH_OPEN, kernel)
            scan.contrast[part], scan.strength[part] = contrast, strength
            scan.foreground[part] = (strength > self.cloth.threshold) & area
            scan.moving[part] = opened > 0
        return scan

    def _find_candidates(self, scan: ForegroundScan, part: tuple[slice, slice]) -> FloatArray:
        """Find working px (n, 2) where balls may be in a part of the working image."""
        view = replace(self.view, radius=self.view.radius[part], centre_area=self.view.centre_area[part])
        centres, _ = find_circle_candidates(scan.contrast[part], scan.foreground[part], view)
        return np.add(centres, (part[1].start, part[0].start), dtype=np.float64)

    def _detect_discs(
        self,
        rgb: ByteArray,
        smooth: ByteArray,
        working: ByteArray,
        frame: int,
        candidates: FloatArray,
        remembered: FrameDetections,
        scan: ForegroundScan,
    ) -> FrameDetections:
        """Detect sharp balls near candidates (n, 2), working px, beside the remembered ones."""
        candidates = candidates[_disc_coverage(scan.foreground, candidates, self.view) > MIN_CANDIDATE_COVERAGE]
        reference = self.view.to_reference(candidates)
        expected = self.view.predict_radius(reference)
        cloth, basis = self._cloth_colour_at(candidates), self.cloth.basis
        circles = fit_circles(rgb, smooth, self.view.reference_to_frame(reference, frame), expected, cloth, basis)
        first = concatenate_rows([self._accept_circles(circles, scan, working, frame), remembered])
        intruders = self._find_intruders(first, scan, frame)
        is_free = ~values_at(intruders, candidates)
        retried = retry_doubtful_circles(rgb, smooth, circles.take(is_free), expected[is_free], cloth[is_free], basis)
        others = (retried, circles.take(~is_free))
        accepted = [self._accept_circles(part, scan, working, frame) for part in others]
        balls = suppress_overlaps(concatenate_rows([*accepted, remembered]), self.view.scene, frame)
        working_centre = self.view.frame_to_working(balls.centre, frame)
        is_clear = balls.score > CLEAR_SCORE
        is_alone = _ring_coverage(scan.foreground, working_centre, self.view) < MAX_RING_COVERAGE
        is_sure = (balls.score > SURE_SCORE) | (is_clear & is_alone)
        at_pocket = values_at(self.view.pocket_area, working_centre)
        is_doubtful = values_at(intruders, working_centre) | (at_pocket & (balls.score < CLEAR_SCORE))
        return balls.take(is_sure | ~is_doubtful)

    def _accept_circles(
        self, circles: Circles, scan: ForegroundScan, working: ByteArray, frame: int
    ) -> FrameDetections:
        """Accept circles that are round, differ from the cloth throughout and are on the table."""
        working_centre = self.view.frame_to_working(circles.centre, frame)
        coverage = _disc_coverage(scan.foreground, working_centre, self.view)
        is_on_table = values_at(self.view.centre_area, working_centre)
        is_open = self.cloth.find_open_discs(working, working_centre, self.view.scale * circles.radius)
        is_good = is_on_table & (circles.support > MIN_SUPPORT) & (coverage > MIN_COVERAGE) & ~is_open
        return suppress_overlaps(_circles_to_detections(circles, coverage).take(is_good), self.view.scene, frame)

    def _find_intruders(self, detections: FrameDetections, scan: ForegroundScan, frame: int) -> BoolArray:
        """Find shapes (h, w) that balls do not account for: hands and sleeves are larger than the discs on them."""
        inside = (scan.foreground & self.view.centre_area & ~self.view.pocket_area).astype(np.uint8)
        wide = cv2.morphologyEx(inside, cv2.MORPH_OPEN, build_disc_kernel(CUE_RADII * self.view.median_radius))
        spare = wide & ~self._draw_discs(self.view.frame_to_working(detections.centre, frame))
        disc = np.pi * self.view.median_radius**2
        moving_rest = np.count_nonzero((spare > 0) & scan.moving)
        if moving_rest <= MAX_MOVING_REST * disc and cv2.countNonZero(spare) <= MAX_STILL_REST * disc:
            return np.zeros(wide.shape, dtype=bool)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(wide)
        rest = np.bincount(labels[spare > 0], minlength=count)
        moved = np.bincount(labels[(spare > 0) & scan.moving], minlength=count)
        large = (moved > MAX_MOVING_REST * disc) | (rest > MAX_STILL_REST * disc)
        intruder = large & (rest > MAX_REST_SHARE * stats[:, cv2.CC_STAT_AREA])
        intruder[0] = False
        return np.asarray(intruder[labels] if intruder.any() else np.zeros(labels.shape, dtype=bool))

    def _cloth_colour_at(self, working: FloatArray) -> FloatArray:
        """RGB (n, 3) of the empty table at working px (n, 2)."""
        return np.asarray(values_at(self.cloth.colour, working), dtype=np.float64)

    def _draw_discs(self, working_centre: FloatArray) -> BoolArray:
        """Draw a mask (h, w) of balls at working px (n, 2)."""
        drawn = np.zeros(self.view.radius.shape, np.uint8)
        for (x, y), r in zip(working_centre, values_at(self.view.radius, working_centre), strict=True):
            cv2.circle(drawn, (round(x * 16), round(y * 16)), round(DRAWN_RADII * float(r) * 16), 1, -1, shift=4)
        return np.asarray(drawn > 0)

    def _detect_streaks(
        self, rgb: ByteArray, candidates: FrameDetections, discs: FrameDetections, frame: int
    ) -> FrameDetections:
        """Measure streaks in px of the frame, without short ones that a disc explains."""
        ends = [self.view.to_reference(candidates.centre + side * candidates.streak / 2) for side in (-1, 1)]
        first, last = (self.view.reference_to_frame(end, frame) for end in ends)
        radius = candidates.radius / self.view.scale
        rough = replace(candidates, centre=(first + last) / 2, streak=last - first, radius=radius)
        streaks = refine_streaks(rgb, rough, self.cloth.basis)
        within = is_inside_streaks(discs.centre, streaks)
        distance = np.linalg.norm(discs.centre[None] - streaks.centre[:, None], axis=-1)
        is_off_centre = distance > OFF_CENTRE_RADII * streaks.radius[:, None]
        relative_length = (np.linalg.norm(streaks.streak, axis=1) / streaks.radius)[:, None]
        # A complete outline off the middle is that of a ball, and the rest of the streak is its shadow.
        is_short = (discs.score > CLEAR_SCORE) & (relative_length < CLEAR_LENGTH_RADII)
        is_shadow = (discs.score > SURE_SCORE) & is_off_centre & (relative_length < 2 * CLEAR_LENGTH_RADII)
        return streaks.take(~(within & (is_short | is_shadow)).any(axis=1))


def build_hough_detector(scene: Scene, images: Iterable[tuple[int, ByteArray]]) -> HoughDetector:
    """Build a detector for a scene.

    Args:
        scene: Table and camera.
        images: Frame number and image (H, W, 3) of some frames of the clip, from which the empty cloth is learnt.

    Returns:
        The detector.
    """
    view = build_view(scene)
    return HoughDetector(view, learn_cloth_background([view.working_image(rgb, frame) for frame, rgb in images], view))


def _ring_coverage(foreground: BoolArray, working_centre: FloatArray, view: WorkingView) -> FloatArray:
    """Share (n,) of the ring around discs at working px (n, 2) that is not cloth."""
    radius = values_at(view.radius, working_centre)
    ring = working_centre[:, None] + RING_RADII * radius[:, None, None] * DIRECTIONS
    return np.asarray(values_at(foreground, ring).mean(axis=1), dtype=np.float64)


def _disc_coverage(foreground: BoolArray, working_centre: FloatArray, view: WorkingView) -> FloatArray:
    """Share (n,) of discs at working px (n, 2) that is not cloth."""
    radius = values_at(view.radius, working_centre)
    samples = working_centre[:, None] + SAMPLED_RADII * radius[:, None, None] * DISC_SAMPLES
    return np.asarray(values_at(foreground, samples).mean(axis=1))


def _circles_to_detections(circles: Circles, coverage: FloatArray) -> FrameDetections:
    score = np.clip(circles.support, 0, 1) * np.minimum(coverage / FULL_COVERAGE, 1.0)
    none = np.zeros_like(circles.centre)
    return FrameDetections(circles.centre, circles.radius, none, score, circles.sigma, circles.sigma)


# Least share of a full circle's votes of a candidate.
MIN_VOTE_SHARE = 0.22
# Most candidates of one image.
MAX_CANDIDATES = 50
# Gradient, grey levels per working px, above half of which a pixel is an edge; three times it has full weight.
MIN_EDGE_GRADIENT = 10.0
# Number of pixels across a sharp edge that vote for one centre.
EDGE_THICKNESS_PX = 2.5


def find_circle_candidates(
    contrast: Float32Array, foreground: BoolArray, view: WorkingView
) -> tuple[FloatArray, FloatArray]:
    """Find peaks of the votes: working px (n, 2) and share of a full circle's votes (n,), strongest first."""
    votes = _accumulate_votes(contrast, foreground, view)
    window = 2 * int(max(1, round(0.45 * float(view.radius.min())))) + 1
    highest = cv2.dilate(votes, np.ones((window, window), np.uint8))
    peaks = (votes >= highest) & (votes > MIN_VOTE_SHARE) & view.centre_area
    y, x = np.nonzero(peaks)
    order = np.argsort(-votes[y, x], kind="stable")[:MAX_CANDIDATES]
    y, x = y[order], x[order]
    return np.column_stack([x, y]).astype(np.float64), votes[y, x].astype(np.float64)


def _accumulate_votes(contrast: Float32Array, foreground: BoolArray, view: WorkingView) -> Float32Array:
    h, w = foreground.shape
    rows, gradient = _find_edges(contrast, foreground)
    strength = np.linalg.norm(gradient, axis=1)
    direction = gradient / strength[:, None]
    weight = np.minimum(strength / (3 * MIN_EDGE_GRADIENT), 1.0)
    y, x = np.divmod(rows, w)
    radius = view.radius.ravel()[rows]
    votes = np.zeros(h * w)
    for side in (-1.0, 1.0):
        u = np.rint(x + side * radius * direction[:, 0]).astype(np.int64)
        v = np.rint(y + side * radius * direction[:, 1]).astype(np.int64)
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        votes += np.bincount(v[inside] * w + u[inside], weight[inside], minlength=h * w)
    return _normalize_votes(votes.reshape(h, w).astype(np.float32), view)


def _normalize_votes(votes: Float32Array, view: WorkingView) -> Float32Array:
    """Sum votes (h, w) over their scatter, as a share of those of a full circle."""
    sigma = 0.9 + 0.06 * view.median_radius
    blurred = cv2.GaussianBlur(votes, (0, 0), sigma)
    full = 2 * np.pi * view.radius * EDGE_THICKNESS_PX / (2 * np.pi * (sigma**2 + 0.6))
    return np.asarray(blurred / full, dtype=np.float32)


def _find_edges(contrast: Float32Array, foreground: BoolArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Find edge pixels near the foreground: flat indices (n,), and gradients (n, 2) of the strongest channel."""
    h, w = foreground.shape
    near = cv2.dilate(foreground.astype(np.uint8), np.ones((5, 5), np.uint8))
    near[[0, -1], :] = 0
    near[:, [0, -1]] = 0
    smooth = cv2.GaussianBlur(contrast, (0, 0), 0.8).reshape(h * w, 3)
    rows = np.flatnonzero(near.ravel())
    gx = 0.5 * (smooth[rows + 1] - smooth[rows - 1])
    gy = 0.5 * (smooth[rows + w] - smooth[rows - w])
    strength = gx**2 + gy**2
    best = np.argmax(strength, axis=1)[:, None]
    gradient = np.column_stack([np.take_along_axis(gx, best, 1), np.take_along_axis(gy, best, 1)]).astype(np.float64)
    strong = np.take_along_axis(strength, best, 1)[:, 0] > MIN_EDGE_GRADIENT**2 / 4
    return rows[strong], gradient[strong]
