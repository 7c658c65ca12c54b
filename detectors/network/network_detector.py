"""Detection by a network on a calibrated table.

The network searches where something changed, and once more on enlarged crops where balls crowd; post-processing then
checks its candidates on the full image.

The network gives a rough position and a confidence score. Edges in the full image localise a ball more precisely where
they are clear; offset regressors do so where they are not, or where the ball moves. All errors are known, so a centre
is their weighted mean. A candidate that is not certain is a ball only if the image confirms it: by its outline
(`resting_balls`), or by the motion-blur model (`moving_balls`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from detectors.measurement.circle_fit import smooth_image
from detectors.measurement.cloth_background import ClothBackground, learn_cloth_background
from detectors.measurement.frame_change import (
    FULL_SEARCH_INTERVAL,
    REACH_RADII,
    dilate_places,
    find_changed_pixels,
    find_windows,
)
from detectors.measurement.frame_detections import (
    FrameDetections,
    add_colours,
    is_inside_streaks,
    select_shaded,
)
from detectors.measurement.overlap_resolution import resolve_overlaps
from detectors.measurement.working_view import WorkingView, build_view, values_at
from detectors.network.ball_model import BallModel, CentreModel
from detectors.network.candidate_rules import CLEAR_SCORE, FrameContext, is_certain, is_possible
from detectors.network.moving_balls import confirm_streaks, find_missed_streaks, measure_streaks
from detectors.network.offset_regressor import DISC, STREAK, OffsetRegressor, open_offset_regressor
from detectors.network.outline_fusion import MIN_SUPPORT
from detectors.network.peak_decoding import (
    COARSE_STRIDE,
    CandidateDetections,
    concatenate_candidates,
    select_non_echoes,
)
from detectors.network.resting_balls import RestingBalls, is_resting_ball, locate_resting_balls, refine_resting_balls
from detectors.network.second_pass import SearchedFrame, run_second_pass
from models.core.array_columns import concatenate_rows
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import BoolArray, ByteArray, FloatArray

# Working px around a window that the network receives with it.
CONTEXT_PX = 16


@dataclass(frozen=True, slots=True)
class NetworkMemory:
    """State of a search through a clip."""

    searched_image: ByteArray
    """(h, w, 3) working image as it was when the network searched each place last."""
    candidates: CandidateDetections
    """The candidates there, working px, without those that the image rejected."""
    unclear: FloatArray
    """(n, 2) working px of the balls that have no clear outline."""
    age: int
    """Frames since the network searched all of it."""


@dataclass(frozen=True, slots=True)
class NetworkDetector:
    """Detects the balls of one scene by a network, frame by frame."""

    view: WorkingView
    cloth: ClothBackground
    model: BallModel

    @property
    def post_processor(self) -> PostProcessor:
        """The post-processing of the network's candidates."""
        regressors = open_offset_regressor(STREAK), open_offset_regressor(DISC)
        return PostProcessor(self.view, self.cloth, *regressors)

    def detect(self, rgb: ByteArray, frame: int = 0) -> Detections:
        """Detect the balls in an image (H, W, 3)."""
        return self.detect_next(rgb, frame, None)[0]

    def detect_next(self, rgb: ByteArray, frame: int, memory: NetworkMemory | None) -> tuple[Detections, NetworkMemory]:
        """Detect the balls in the next frame of a clip; the network searches only where something changed.

        Every centre is measured again all the same; a ball without a clear outline is also searched for again.

        Args:
            rgb: Image (H, W, 3).
            frame: Number of the frame.
            memory: State after the previous frame, None for the first.

        Returns:
            The balls, and the state for the next frame.
        """
        working = self.view.working_image(rgb, frame)
        touched = self._find_touched_places(working, memory)
        candidates = self._find_candidates(rgb, working, touched, memory, frame)
        result = self.post_processor.process_candidates(rgb, candidates, frame)
        searched = working
        if memory is not None:
            searched = cv2.copyTo(working, touched.view(np.uint8), memory.searched_image.copy())
        age = 0 if touched.all() or memory is None else memory.age + 1
        remaining = candidates.take(~result.is_rejected)
        balls = result.detections
        centre = self.view.frame_to_working(balls.centre, frame)
        is_lining = self.cloth.is_lining(working, centre, values_at(self.view.radius, centre))
        return balls.select_rows(~is_lining), NetworkMemory(searched, remaining, result.unclear, age)

    def _find_touched_places(self, working: ByteArray, memory: NetworkMemory | None) -> BoolArray:
        """Find where (h, w) the network has to search a working image."""
        if memory is None or memory.age >= FULL_SEARCH_INTERVAL:
            return np.ones(working.shape[:2], dtype=bool)
        changed = find_changed_pixels(working, memory.searched_image, self.view, self.cloth.threshold)
        for x, y in np.rint(memory.unclear).astype(int):
            cv2.circle(changed.view(np.uint8), (int(x), int(y)), 1, 1, -1)
        return dilate_places(changed, REACH_RADII * self.view.median_radius)

    def _find_candidates(
        self, rgb: ByteArray, working: ByteArray, touched: BoolArray, memory: NetworkMemory | None, frame: int
    ) -> CandidateDetections:
        """Find candidates on the table, working px: new ones at touched places, elsewhere those of the memory."""
        if not isinstance(self.model, CentreModel):
            if memory is not None and not touched.any():
                return memory.candidates
            return self._select_on_table(self._search_whole_table(rgb, frame))
        windows = [self._search_window(working, part) for part in find_windows(touched, self.view)]
        candidates = concatenate_candidates([part.take(values_at(touched, part.centre)) for part in windows])
        searched = SearchedFrame(rgb, working, touched, frame)
        candidates = run_second_pass(searched, self.view, self.cloth, self.model, candidates)
        if memory is not None:
            is_untouched = ~values_at(touched, memory.candidates.centre)
            candidates = concatenate_candidates([candidates, memory.candidates.take(is_untouched)])
        return self._select_on_table(candidates)

    def _search_window(self, working: ByteArray, part: tuple[slice, slice]) -> CandidateDetections:
        """Search a part of the working image, with some context."""
        h, w = working.shape[:2]
        # On the grid of the whole image's cells, so that a part gives the same results as the whole.
        top, left = (max(s.start - CONTEXT_PX, 0) // COARSE_STRIDE * COARSE_STRIDE for s in part)
        bottom, right = min(part[0].stop + CONTEXT_PX, h), min(part[1].stop + CONTEXT_PX, w)
        window, times = working[top:bottom, left:right], self.view.enlargement
        if times > 1:
            size = (times * window.shape[1], times * window.shape[0])
            window = np.asarray(cv2.resize(window, size, interpolation=cv2.INTER_LINEAR), np.uint8)
        candidates = self.model.find_candidates(window, times * self.view.median_radius)
        return candidates.transform(lambda px: (px + 0.5) / times - 0.5 + (left, top), 1 / times)

    def _search_whole_table(self, rgb: ByteArray, frame: int) -> CandidateDetections:
        """Search the table's part of an image by a network for whole images, working px."""
        x0, y0, x1, y1 = self.view.box if self.view.scene.camera.motion is None else (0, 0, rgb.shape[1], rgb.shape[0])
        candidates = self.model.find_candidates(rgb[y0:y1, x0:x1], self.view.median_radius / self.view.scale)
        candidates = candidates.scale(1.0, (float(x0), float(y0)))
        return candidates.transform(lambda px: self.view.frame_to_working(px, frame), self.view.scale)

    def _select_on_table(self, candidates: CandidateDetections) -> CandidateDetections:
        """Select possible balls on the table without echoes; certain ones first, then by confidence score."""
        is_on_table = values_at(self.view.centre_area, candidates.centre)
        candidates = candidates.take(is_possible(candidates, self.view) & is_on_table)
        candidates = candidates.take(np.lexsort((-candidates.score, ~is_certain(candidates, self.view))))
        return candidates.take(select_non_echoes(candidates))


def build_network_detector(scene: Scene, images: Iterable[tuple[int, ByteArray]], model: BallModel) -> NetworkDetector:
    """Build a detector for a scene.

    Args:
        scene: Table and camera.
        images: Frame number and image (H, W, 3) of some frames, from which the empty cloth is learnt.
        model: Network that detects balls.

    Returns:
        The detector.
    """
    view = build_view(scene)
    cloth = learn_cloth_background([view.working_image(rgb, frame) for frame, rgb in images], view)
    return NetworkDetector(view, cloth, model)


@dataclass(frozen=True, slots=True)
class PostProcessingResult:
    """Balls among the K candidates of a frame."""

    detections: Detections
    unclear: FloatArray
    """(n, 2) working px of the balls that only the network places."""
    is_rejected: BoolArray
    """(K,) candidates that the image shows to be no balls; only after a change there may they be checked again."""


@dataclass(frozen=True, slots=True)
class PostProcessor:
    """Makes detections of the candidates of a ball network."""

    view: WorkingView
    cloth: ClothBackground
    streak_regressor: OffsetRegressor
    disc_regressor: OffsetRegressor

    def process_candidates(self, rgb: ByteArray, candidates: CandidateDetections, frame: int) -> PostProcessingResult:
        """Select and measure the balls among candidates.

        Args:
            rgb: Image (H, W, 3) of the frame.
            candidates: K candidates, working px.
            frame: Number of the frame.

        Returns:
            The balls at rest and the streaks.
        """
        context = FrameContext(rgb, smooth_image(rgb), frame, self.view, self.cloth)
        certain = is_certain(candidates, self.view)
        measured, is_moving = measure_streaks(context, candidates, self.streak_regressor)
        rows = np.flatnonzero(~is_moving | ~certain)
        resting, may_move = locate_resting_balls(context, candidates.take(rows)), is_moving[rows]
        is_accepted = is_resting_ball(context, resting, may_move)
        is_rejected = np.zeros(len(candidates), dtype=bool)
        is_rejected[rows[~is_accepted & ~may_move]] = True
        resting = refine_resting_balls(context, resting.take(is_accepted), self.disc_regressor)
        missed, is_missed = find_missed_streaks(
            context, resting, measured.take(is_moving & certain), self.streak_regressor
        )
        at_rest = resting.detections.take(resting.has_clear_outline & ~is_missed)
        confirmed = confirm_streaks(context, measured.take(is_moving), certain[is_moving], at_rest)
        streaks = concatenate_rows([confirmed, missed])
        discs = resting.detections.take(~is_missed & ~_is_part_of_streak(resting, streaks))
        centre, size = self.view.frame_to_working(discs.centre, frame), self.view.scale * discs.radius
        is_open = self.cloth.find_open_discs(self.view.working_image(rgb, frame), centre, size)
        balls = resolve_overlaps(concatenate_rows([streaks, discs.take(~is_open)]), self.view.scene, frame)
        is_unclear = resting.outlines.support <= MIN_SUPPORT
        unclear = np.concatenate([candidates.centre[is_moving & certain], resting.candidates.centre[is_unclear]])
        return PostProcessingResult(add_colours(rgb, select_shaded(rgb, balls), frame), unclear, is_rejected)


def _is_part_of_streak(balls: RestingBalls, streaks: FrameDetections) -> BoolArray:
    """Which balls (N,) without a clear outline are within a streak with a higher score, and are not certain."""
    score = balls.detections.score
    is_covered = is_inside_streaks(balls.detections.centre, streaks) & (streaks.score[:, None] >= score)
    is_covered &= score < CLEAR_SCORE
    return np.asarray(is_covered.any(axis=0) & ~balls.has_clear_outline)
