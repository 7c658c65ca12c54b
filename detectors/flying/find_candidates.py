"""Candidates of the ball or shuttle of a rally, in every frame of a clip."""

from __future__ import annotations

import numpy as np

from detectors.flying.frame_windows import FrameWindow, list_windows
from detectors.flying.motion_spots import find_window_spots
from detectors.flying.moving_people import PeopleFinder
from detectors.flying.object_size import choose_scale, outline_of_play
from detectors.flying.spot_network import SpotJudgement, judge_spots
from models.core.court_camera import CourtScene
from models.core.progress import Progress, ignore_progress
from models.core.rally import BallCandidates
from models.core.typing import BoolArray, FloatArray
from video.io.clip import Clip

# Probability below which a spot is no candidate: of several hundred such spots one is the object.
LEAST_SCORE = 0.003
# Working px within which two candidates are one, besides half their streaks.
ONE_PLACE_PX = 3.0

# Frames from which motion is told from noise: one before and one after.
LEAST_FRAMES = 3


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
    count = len(clip.distinct_frames)
    if count < LEAST_FRAMES:
        nothing = np.empty(0)
        return BallCandidates(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)), nothing, nothing, nothing)
    scale = choose_scale(scene)
    people = PeopleFinder(scene, scale)
    rows = [np.empty((0, 8))]
    for k, window in enumerate(list_windows(clip, scene.camera, scale)):
        people.add_window(window)
        rows.append(_judge_frame(window, scene, scale))
        progress((k + 1) / count)
    table = np.concatenate(rows)
    interval = float(np.median(np.diff(clip.times_of(clip.distinct_frames))))
    return BallCandidates(
        table[:, 0].astype(np.int64), table[:, 1:3], table[:, 3:5], table[:, 5], table[:, 6], table[:, 7],
        people.find_people(interval),
    )  # fmt: skip


def _judge_frame(window: FrameWindow, scene: CourtScene, scale: float) -> FloatArray:
    """Find the candidates (K, 8) of a frame: frame, centre, streak, score, and sigma across and along."""
    judged = judge_spots(window, find_window_spots(window, outline_of_play(scene, scale, window.frame)))
    best = np.flatnonzero(_select_places(judged))
    best = best[np.argsort(-judged.score[best], kind="stable")]
    return np.column_stack(
        [
            np.full(len(best), float(window.frame)), (judged.centre[best] + 0.5) / scale - 0.5,
            judged.streak[best] / scale, judged.score[best], judged.sigma[best] / scale,
        ]
    )  # fmt: skip


def _select_places(judged: SpotJudgement) -> BoolArray:
    """Select the most probable of the candidates (K,) that are at one place."""
    is_selected = judged.score >= LEAST_SCORE
    reach = ONE_PLACE_PX + np.linalg.norm(judged.streak, axis=1) / 2
    for k in np.argsort(-judged.score, kind="stable"):
        if is_selected[k]:
            is_selected &= np.linalg.norm(judged.centre - judged.centre[k], axis=1) > reach[k]
            is_selected[k] = True
    return is_selected
