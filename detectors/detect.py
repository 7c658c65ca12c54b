"""The seam between the detectors: a clip and its scene go in, Detections come out."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from detectors.apparent_ball_size import with_seen_size
from detectors.hough.hough_detector import BallFinder, ball_finder
from detectors.measurement.cloth_background import learn_cloth
from detectors.measurement.working_view import view_of
from detectors.network.network_detector import NetworkFinder, network_finder
from detectors.network.network_file import SHIPPED, open_model
from detectors.options import DetectOptions
from detectors.select_detector import chosen
from models.core.detections import Detections
from models.core.progress import Progress, silent
from models.core.scene import Scene
from models.core.typing import ByteArray
from video.io.clip import Clip, read_frames

LEARNING_PICTURES = 15
"""Pictures, spread over the clip, from which the empty table is learnt."""
LEARNING_PICTURES_QUICK = 7
SIZE_PICTURES = 3
"""Pictures in which the size of the balls is checked."""

M = TypeVar("M")


class Detector(Protocol[M]):
    """Anything that finds balls in one picture of a clip; M is what it keeps from one picture for the next."""

    def look(self, rgb: ByteArray, frame: int = 0) -> Detections:
        """The balls in picture `frame` (H, W, 3)."""
        ...

    def follow(self, rgb: ByteArray, frame: int, memory: M | None) -> tuple[Detections, M]:
        """The same for one picture after another: `memory` is what the call for the picture before gave."""
        ...


def detect_balls(clip: Clip, scene: Scene, options: DetectOptions, progress: Progress = silent) -> Detections:
    """The balls in every distinct picture of a clip; streams it twice and holds a few small pictures.

    Every picture is measured afresh, also where nothing moves, so that errors of different pictures are as
    independent as the coding of the clip leaves them. Raises ModelError for a detector that is not there.
    """
    if chosen(options, scene) == "hough":
        return _followed(hough_detector(clip, scene, options), clip, progress)
    return _followed(network_detector(clip, scene, options), clip, progress)


def _followed(detector: Detector[M], clip: Clip, progress: Progress) -> Detections:
    frames = clip.distinct
    seen: list[Detections] = []
    memory: M | None = None
    for done, (frame, rgb) in enumerate(read_frames(clip, indices=frames)):
        found, memory = detector.follow(rgb, frame, memory)
        seen.append(found)
        progress((done + 1) / max(len(frames), 1))
    return joined(seen)


def detect_in_picture(rgb: ByteArray, scene: Scene, options: DetectOptions | None = None) -> Detections:
    """The balls in one still picture (H, W, 3); they all have frame 0."""
    options = options or DetectOptions()
    pictures = [(0, rgb)]
    if chosen(options, scene, still=True) == "hough":
        return ball_finder(with_seen_size(scene, pictures), pictures).look(rgb)
    return network_finder(scene, pictures, open_model(model_file(options))).look(rgb)


def hough_detector(clip: Clip, scene: Scene, options: DetectOptions) -> BallFinder:
    """The detector without a network, made ready for a clip: read once, where the size of the balls is right."""
    few, learnt = _spread(clip.distinct, SIZE_PICTURES), _learning(clip, options)
    view, whole, seen = view_of(scene), list[tuple[int, ByteArray]](), list[ByteArray]()
    for frame, rgb in read_frames(clip, indices=np.union1d(few, learnt)):
        if frame in few:
            whole.append((frame, rgb))
        if frame in learnt:
            seen.append(view.picture(rgb, frame))
    sized = with_seen_size(scene, whole)
    if sized is scene:
        return BallFinder(view, learn_cloth(seen, view))
    return ball_finder(sized, read_frames(clip, indices=learnt))


def network_detector(clip: Clip, scene: Scene, options: DetectOptions) -> NetworkFinder:
    """The detector with a network, made ready for a clip; ModelError where its file is none."""
    model = open_model(model_file(options))
    return network_finder(scene, read_frames(clip, indices=_learning(clip, options)), model)


def model_file(options: DetectOptions) -> Path:
    """The network that is used: the one that is named, or the project's own."""
    return SHIPPED if options.model is None else Path(options.model)


def _learning(clip: Clip, options: DetectOptions) -> NDArray[np.int64]:
    """Frames, spread over a clip, that show the empty table."""
    return _spread(clip.distinct, LEARNING_PICTURES_QUICK if options.quick else LEARNING_PICTURES)


def _spread(frames: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """At most `count` of the frames (n,), evenly spread, both ends among them."""
    places = np.linspace(0, len(frames) - 1, min(count, len(frames)))
    return frames[np.unique(places.round().astype(np.int64))]


def joined(parts: list[Detections]) -> Detections:
    """Detections one after another; they must come in the order of their frames."""
    if not parts:
        none, pairs, triples = np.empty(0), np.empty((0, 2)), np.empty((0, 3))
        return Detections(np.empty(0, dtype=np.int64), pairs, none, pairs, triples, *[none] * 6)
    names = (
        "frame",
        "centre",
        "radius",
        "streak",
        "colour",
        "white",
        "white_rim",
        "value",
        "score",
        "sigma",
        "sigma_along",
    )
    return Detections(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
