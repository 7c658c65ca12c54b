"""Candidates of the ball or shuttle of a rally, in every frame of a clip."""

from __future__ import annotations

import numpy as np

from detectors.flying.frame_windows import list_windows
from detectors.flying.motion_spots import find_spots, map_lone_change
from detectors.flying.moving_people import PeopleFinder
from detectors.flying.object_size import choose_scale, is_inside, outline_of_play
from detectors.flying.spot_moments import measure_moments
from models.core.court_camera import CourtScene
from models.core.progress import Progress, ignore_progress
from models.core.rally import BallCandidates
from models.core.typing import FloatArray
from video.io.clip import Clip

# Spots of a frame that are looked at: the object is among them where it can be told from noise.
SPOTS_PER_FRAME = 40


def find_candidates(clip: Clip, scene: CourtScene, progress: Progress = ignore_progress) -> BallCandidates:
    """Find where the ball or shuttle may be seen.

    An object that stands still, or is hidden, gives none.

    Args:
        clip: One view, without a cut.
        scene: Court and camera.
        progress: Called with the share that is done.

    Returns:
        Candidates sorted by frame and, within a frame, by falling score; px of the frames.
    """
    scale = choose_scale(scene)
    people = PeopleFinder(scene, scale)
    rows: list[FloatArray] = []
    count = len(clip.distinct_frames)
    for k, window in enumerate(list_windows(clip, scene.camera, scale)):
        people.add_window(window)
        change = map_lone_change(window)
        measures = measure_moments(change, find_spots(change, SPOTS_PER_FRAME))
        centre = (measures.centre + 0.5) / scale - 0.5
        table = np.column_stack([centre, measures.streak / scale, measures.score, measures.sigma / scale])
        table = table[is_inside(outline_of_play(scene.sport, scene.camera, window.frame), centre)]
        table = table[np.argsort(-table[:, 4], kind="stable")]
        rows.append(np.column_stack([np.full(len(table), float(window.frame)), table]))
        progress((k + 1) / count)
    table = np.concatenate([np.empty((0, 8)), *rows])
    interval = float(np.median(np.diff(clip.times_of(clip.distinct_frames))))
    return BallCandidates(
        table[:, 0].astype(np.int64), table[:, 1:3], table[:, 3:5], table[:, 5], table[:, 6], table[:, 7],
        people.find_people(interval),
    )  # fmt: skip
