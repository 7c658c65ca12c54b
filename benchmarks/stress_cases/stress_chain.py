"""The stages of the program that the stress test runs: from a clip or from detections to a fit and to calls."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from models.core.detections import Detections
from models.core.fit_result import Fit
from models.core.options import FitOptions, TrackOptions
from models.core.scene import POCKETS, Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.tracking.build_tracks import build_tracks
from pipeline.chain import build_shot_graph
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage_graph import load_stage_output
from pipeline.run_options import RunOptions
from video.io.clip import Clip

# Probabilities between which a statement counts as undecided.
UNDECIDED = (0.1, 0.9)
# The code of this process. An edit during a long run must not put results of the old code under keys of the new.
SNAPSHOT = SourceSnapshot()


@dataclass(frozen=True, slots=True)
class Recording:
    """What the tracker gets: detections in the frames `frame` (T,) at `t` (T,) s, and the calibrated scene."""

    detections: Detections
    frame: IntArray
    t: FloatArray
    scene: Scene


@dataclass(frozen=True, slots=True)
class FittedShot:
    """A recording with its tracks and fit."""

    recording: Recording
    tracks: Tracks
    fit: Fit


@dataclass(frozen=True, slots=True)
class Call:
    """One answer to an umpire's question: `answer` to `question` about `balls`, with its probability."""

    question: str
    balls: tuple[str, ...]
    answer: str
    probability: float
    undecided: bool


class SilentWatcher:
    """Follows a run without showing anything."""

    def start_stage(self, stage: str) -> Callable[[float], None]:
        """Ignore the start of a stage."""
        return lambda share: None

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Ignore the end of a stage."""


def run_clip_stages(path: Path, cache: ResultCache) -> tuple[Clip, FittedShot]:
    """Run the chain of the program up to the fit.

    Args:
        path: The clip.
        cache: Cache of the stages.

    Returns:
        The clip, and its detections, tracks and fit.
    """
    graph = build_shot_graph(path, RunOptions())
    entries = graph.run(cache, SilentWatcher(), snapshot=SNAPSHOT)
    values = {stage.name: load_stage_output(stage, entries[stage.name]) for stage in graph.stages}
    clip, shot = values["read"], values["explain"]
    recording = Recording(values["detect"], clip.distinct_frames, clip.times_of(clip.distinct_frames), shot.scene)
    return clip, FittedShot(recording, shot.tracks, view_shot(shot))


def fit_recording(recording: Recording) -> FittedShot:
    """Track and fit a recording as the stages `track` and `fit` do with default options.

    Args:
        recording: Detections, frames and scene.

    Returns:
        The recording with its tracks and fit.
    """
    scene = recording.scene
    tracks = build_tracks(recording.detections, recording.frame, recording.t, scene, TrackOptions())
    return FittedShot(recording, tracks, view_shot(explain(tracks, scene, FitOptions())))


def answer_calls(tracks: Tracks, scene: Scene, fit: Fit, cues: Collection[str], movers: Collection[str]) -> list[Call]:
    """Ask the questions of the stress test.

    Args:
        tracks: Tracks of the shot.
        scene: Table and camera.
        fit: Fit of the shot.
        cues: Ids of the cue ball; usually one.
        movers: Ids of the balls that move.

    Returns:
        First contact and cushion-first of the cue ball, the contact of every pair with a mover, and, on a table with
        pockets, the most probable pocket of every mover.
    """
    record = make_shot_record(tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)
    calls: list[Call] = []
    for cue in cues:
        first = call_answers.answer_first_contact(record, cue)
        name, probability = first.alternatives[0]
        calls.append(Call("first", (cue,), name, probability, probability < UNDECIDED[1]))
        cushion = call_answers.answer_cushion_first(record, cue).probability
        calls.append(Call("cushion-first", (cue,), "yes", cushion, _is_undecided(cushion)))
    for k, a in enumerate(tracks.ids):
        for b in tracks.ids[k + 1 :]:
            if a in movers or b in movers:
                calls += _answer_contact(record, a, b)
        if a in movers and scene.table.pockets:
            calls += _answer_pocket(record, a)
    return calls


def find_marks(fit: Fit) -> list[tuple[str, float]]:
    """List the ball and time (s) of every velocity change that the result marks as unexplained.

    Args:
        fit: Fit of the shot.

    Returns:
        The changes that the explanation holds to be unexplained with a probability that is listed.
    """
    return [
        (moment.ball, moment.t)
        for moment in fit.explanation.moments
        for one in moment.hypotheses
        if one.cause == "unexplained" and one.probability >= UNDECIDED[0]
    ]


def _is_undecided(probability: float) -> bool:
    return UNDECIDED[0] < probability < UNDECIDED[1]


def _answer_contact(record: ShotRecord, a: str, b: str) -> list[Call]:
    try:
        probability = call_answers.answer_contact(record, a, b).probability
    except ValueError:  # the two were never detected at the same time
        return []
    return [Call("contact", (a, b), "yes", probability, _is_undecided(probability))]


def _answer_pocket(record: ShotRecord, a: str) -> list[Call]:
    try:
        answers = [(call_answers.answer_pocket(record, a, name).probability, name) for name in POCKETS]
    except ValueError:  # too few detections
        return []
    probability, name = max(answers)
    return [Call("pocket", (a,), name, probability, _is_undecided(probability))]
