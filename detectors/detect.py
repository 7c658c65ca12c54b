"""Detection of the balls of a clip or an image by the selected detector."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detectors.detect_options import DetectOptions
from detectors.hough.hough_detector import HoughDetector, build_hough_detector
from detectors.measurement.cloth_background import ClothBackground
from detectors.measurement.working_view import WorkingView
from detectors.network.ball_model import SHIPPED_BALL_MODEL, open_ball_model
from detectors.network.network_detector import NetworkDetector, build_network_detector
from detectors.select_detector import select_detector
from models.core.array_columns import concatenate_rows
from models.core.detections import Detections
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene
from models.core.typing import ByteArray
from models.numerics.executor import SERIAL, Executor
from video.io.clip import Clip, read_frames

# Frames, spread over the clip, from which the empty table is learnt.
BACKGROUND_FRAMES = 15

# Parts of a clip that are searched independently of each other, and the fewest frames of a part. Their number does not
# depend on the machine, because a search remembers the frame before: another division gives slightly other results.
PARTS, LEAST_PART_FRAMES = 2, 24

# Detects the balls of one scene; `detect_next` takes and returns what its search of a clip remembers.
BallDetector = HoughDetector | NetworkDetector


def detect_balls(
    clip: Clip, scene: Scene, options: DetectOptions, progress: Progress = ignore_progress, executor: Executor = SERIAL
) -> Detections:
    """Detect the balls in every distinct frame of a clip.

    The clip is decoded twice, and only a few small images are kept. Every frame is measured again, also where nothing
    moves, so that the errors of different frames are as independent as video coding allows.

    Args:
        scene: Table and camera.
        options: Which detector and network.
        progress: Called with the share that is done.
        executor: Where the parts of the clip are searched; it changes no result.

    Returns:
        Detections sorted by frame, px of the original frames.

    Raises:
        ModelError: The file of the network cannot be used.
    """
    detector = prepare_detector(clip, scene, options)
    count = len(clip.distinct_frames)
    borders = np.linspace(0, count, PARTS + 1 if count >= PARTS * LEAST_PART_FRAMES else 2).round().astype(int).tolist()
    detection = ClipDetection(clip, detector, options, progress)
    return concatenate_detections(executor.map_tasks(detection, detect_part, list(pairwise(borders))))


def detect_part(detection: ClipDetection, first: int, stop: int) -> Detections:
    """Detect the balls in distinct frames `first` to `stop` - 1 of a clip, a task of an executor."""
    return detection.detect_frames(first, stop)


class ClipDetection:
    """Detection of the balls of one clip, which can be sent to another process: there the network is opened again."""

    def __init__(
        self, clip: Clip, detector: BallDetector, options: DetectOptions, progress: Progress = ignore_progress
    ) -> None:
        self._clip, self._detector, self._options, self._progress = clip, detector, options, progress

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore_detection, (self._clip, self._detector.view, self._detector.cloth, self._options)

    def detect_frames(self, first: int, stop: int) -> Detections:
        """Detect the balls in distinct frames `first` to `stop` - 1."""
        memory: Any = None
        frames = self._clip.distinct_frames[first:stop]
        detections: list[Detections] = []
        for done, (frame, rgb) in enumerate(read_frames(self._clip, indices=frames), start=1):
            frame_detections, memory = self._detector.detect_next(rgb, frame, memory)
            detections.append(frame_detections)
            self._progress((first + done) / max(len(self._clip.distinct_frames), 1))
        return concatenate_detections(detections)


def _restore_detection(clip: Clip, view: WorkingView, cloth: ClothBackground, options: DetectOptions) -> ClipDetection:
    """Restore the detection of a clip in another process."""
    if select_detector(options, view.scene) == "hough":
        return ClipDetection(clip, HoughDetector(view, cloth), options)
    return ClipDetection(clip, NetworkDetector(view, cloth, open_ball_model(select_model_file(options))), options)


def detect_in_image(rgb: ByteArray, scene: Scene, options: DetectOptions | None = None) -> Detections:
    """Detect the balls in a single image.

    Args:
        rgb: Image (H, W, 3).
        scene: Table and camera.
        options: Which detector and network.

    Returns:
        Detections, all of frame 0.

    Raises:
        ModelError: The file of the network cannot be used.
    """
    options = options or DetectOptions()
    return build_detector(scene, [(0, rgb)], options, is_still=True).detect(rgb)


def prepare_detector(clip: Clip, scene: Scene, options: DetectOptions) -> BallDetector:
    """Prepare the detector of a clip.

    Args:
        scene: Table and camera.
        options: Which detector and network.

    Returns:
        The detector.

    Raises:
        ModelError: The file of the network cannot be used.
    """
    return build_detector(scene, read_frames(clip, indices=_select_background_frames(clip)), options)


def build_detector(
    scene: Scene, images: Iterable[tuple[int, ByteArray]], options: DetectOptions, is_still: bool = False
) -> BallDetector:
    """Build a detector that learns the empty table from images.

    Args:
        scene: Table and camera.
        images: Frame numbers and images (H, W, 3).
        options: Which detector and network.
        is_still: Whether the detector is for a single image.

    Returns:
        The detector.

    Raises:
        ModelError: The file of the network cannot be used.
    """
    if select_detector(options, scene, is_still=is_still) == "hough":
        return build_hough_detector(scene, images)
    return build_network_detector(scene, images, open_ball_model(select_model_file(options)))


def select_model_file(options: DetectOptions) -> Path:
    """Select the file of the ball network: the requested one, or the one that ships with the package.

    Args:
        options: Options of the detection.

    Returns:
        The ONNX file.
    """
    return SHIPPED_BALL_MODEL if options.model is None else Path(options.model)


def _select_background_frames(clip: Clip) -> NDArray[np.int64]:
    """Select frames, evenly spread over a clip with both ends, from which the empty table is learnt."""
    frames = clip.distinct_frames
    places = np.linspace(0, len(frames) - 1, min(BACKGROUND_FRAMES, len(frames)))
    return frames[np.unique(places.round().astype(np.int64))]


def concatenate_detections(parts: list[Detections]) -> Detections:
    """Concatenate detections.

    Args:
        parts: Any number of detections, in the order of their frames.

    Returns:
        All rows.
    """
    if not parts:
        none, pairs, triples = np.empty(0), np.empty((0, 2)), np.empty((0, 3))
        return Detections(np.empty(0, dtype=np.int64), pairs, none, pairs, triples, *[none] * 6)
    return concatenate_rows(parts)
