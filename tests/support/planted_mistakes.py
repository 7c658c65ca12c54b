"""Mistakes planted into the stages of a run, each of which a person can see and correct."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from support.sample_clips import SAMPLES

import detectors.detect
import models.estimation.reconstruction.explain_shot as explain_shot
import models.tracking.build_tracks as build_tracks
from models.core.array_columns import concatenate_rows
from models.core.contact_graph import Contact
from models.core.corrections import Corrections
from models.core.detections import Detections
from models.core.progress import Progress, ignore_progress
from models.core.typing import FloatArray
from models.estimation.hand_marks.graph_marks import HELD_GAIN
from models.estimation.joint_fit.contact_cascades import evaluate_state, find_segment_at
from models.tracking.tracklet_linking import Tracklet, make_tracklet
from pipeline.chain import build_shot_graph, run_tables
from pipeline.editing.run_view import ClipRun
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.stage_graph import StageGraph, load_stage_output
from pipeline.io.corrections_file import CorrectionsFile, write_corrections
from pipeline.run_options import RunOptions, build_options

OPTIONS: RunOptions = build_options({"laws": False})
SPLIT_FRAME = 60
"""Frame at which tracks are cut and exchanged: `solid-1` and `solid-2` roll apart."""
FALSE_PLACE = np.array([520.0, 560.0])
"""px of a spot that is taken for a ball."""
PLACE_NOISE = 0.004
"""m between the places of an event in two runs that are the same: corners set by hand are right within a pixel, 2.5 mm.
"""
FALSE_STRIKE_FRAME = 75
"""Frame at which the cue ball rolls freely."""
LOST_FRAME = 53
"""Frame before `solid-1` hits the bottom cushion."""


class SilentWatcher:
    """A watcher that shows nothing."""

    def start_stage(self, stage: str) -> Progress:
        return ignore_progress

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        pass


@dataclass(frozen=True, slots=True)
class Mistake:
    """One planted mistake."""

    name: str
    corrections: Callable[[ClipRun], Corrections]
    """Corrections that are there from the start, and may be the mistake."""
    patches: Callable[[ClipRun, Detections], Sequence[tuple[Any, str, Any]]]
    """Module, name and replacement of each function that errs."""
    detects: bool = False
    """Whether the detection errs, so that it must not come from the cache."""


@dataclass(frozen=True, slots=True)
class CleanRun:
    """A run without mistakes."""

    clip: Path
    run: ClipRun
    detections: Detections
    located: Path
    """Cache with the stages up to the calibration."""
    detected: Path
    """Cache with the stages up to the detection."""


def run_clip_tables(clip: Path, folder: Path, cache: Path) -> ClipRun:
    """Run a clip up to its tables."""
    read, *values = run_tables(clip, folder, OPTIONS, ResultCache(cache), SilentWatcher())
    return ClipRun(float(read.fps), *values)


def make_clean_run(folder: Path) -> CleanRun:
    """Run the sample clip without mistakes."""
    clip = Path(shutil.copy(SAMPLES / "overhead_pool.mp4", folder))
    stages = {stage.name: stage for stage in build_shot_graph(clip, OPTIONS).stages}
    graphs = [("read", "calibrate"), ("read", "calibrate", "detect")]
    for names, cache in zip(graphs, ("located", "detected"), strict=True):
        if cache == "detected":
            shutil.copytree(folder / "located", folder / "detected")
        graph = StageGraph.from_stages([stages[name] for name in names], build_shot_graph(clip, OPTIONS).clip)
        entries = graph.run(ResultCache(folder / cache), SilentWatcher())
    detections = load_stage_output(stages["detect"], entries["detect"])
    shutil.copytree(folder / "detected", folder / "cache")
    run = run_clip_tables(clip, folder / "out", folder / "cache")
    return CleanRun(clip, run, detections, folder / "located", folder / "detected")


def prepare_mistake(mistake: Mistake, clean: CleanRun, folder: Path) -> Path:
    """Copy the clip, its corrections and the cached stages before a mistake to a folder; return the clip."""
    shutil.copytree(clean.located if mistake.detects else clean.detected, folder / "cache")
    clip = Path(shutil.copy(clean.clip, folder))
    write_corrections(clip, CorrectionsFile(1, "", mistake.corrections(clean.run)))
    return clip


@contextmanager
def plant(mistake: Mistake, truth: ClipRun, detections: Detections) -> Iterator[None]:
    """Let the stages of this process make a mistake."""
    with ExitStack() as stack:
        for module, name, replacement in mistake.patches(truth, detections):
            stack.enter_context(patch.object(module, name, replacement))
        yield


def point_of(run: ClipRun, ball: str, frame: int) -> FloatArray:
    """Return the place (2,) px of a ball in a frame."""
    tracks = run.tracks
    return np.asarray(tracks.px[int(np.searchsorted(tracks.frame, frame)), tracks.ids.index(ball)])


def _is_near(detections: Detections, run: ClipRun, ball: str) -> np.ndarray:
    """Mark the detections of a ball that rests."""
    return np.asarray(np.hypot(*(detections.centre - point_of(run, ball, 0)).T) < 10)


def _drop_ball(run: ClipRun, detections: Detections) -> list[tuple[Any, str, Any]]:
    rest = detections.select_rows(~_is_near(detections, run, "stripe-1"))
    return [(detectors.detect, "detect_balls", lambda *_: rest)]


def _add_false_ball(run: ClipRun, detections: Detections) -> list[tuple[Any, str, Any]]:
    spot = detections.select_rows(_is_near(detections, run, "stripe-2"))
    spot = replace(spot, centre=spot.centre - spot.centre.mean(axis=0) + FALSE_PLACE)
    order = np.argsort(np.concatenate([detections.frame, spot.frame]), kind="stable")
    merged = concatenate_rows([detections, spot], order)
    return [(detectors.detect, "detect_balls", lambda *_: merged)]


def _find_tracklet(balls: Sequence[Tracklet], run: ClipRun, ball: str, xy_of: FloatArray) -> int:
    """Find the track of a ball by its first place on the table."""
    tracks = run.tracks
    place = tracks.xy[0, tracks.ids.index(ball)]
    return int(np.argmin([np.hypot(*(xy_of[one.row[0]] - place)) for one in balls]))


def _edit_tracklets(edit: Callable[..., list[Tracklet]]) -> Callable[..., list[tuple[Any, str, Any]]]:
    """Make patches that change tracks after the tracker has corrected them."""

    def make(run: ClipRun, detections: Detections) -> list[tuple[Any, str, Any]]:
        original = build_tracks.correct_identity_switches

        def correct(balls: list[Tracklet], found: Any, t: FloatArray, radius: float) -> list[Tracklet]:
            return edit(original(balls, found, t, radius), found, t, run)

        return [(build_tracks, "correct_identity_switches", correct)]

    return make


def _join(parts: Sequence[tuple[Tracklet, np.ndarray]], found: Any, t: FloatArray) -> Tracklet:
    frames = np.concatenate([ball.frame_index[rows] for ball, rows in parts])
    rows = np.concatenate([ball.row[rows] for ball, rows in parts])
    order = np.argsort(frames, kind="stable")
    return make_tracklet(frames[order], rows[order], found, t)


def _halves(ball: Tracklet) -> tuple[np.ndarray, np.ndarray]:
    early = ball.frame_index < SPLIT_FRAME
    return early, ~early


def _exchange(balls: list[Tracklet], found: Any, t: FloatArray, run: ClipRun) -> list[Tracklet]:
    one, two = (_find_tracklet(balls, run, name, found.xy) for name in ("solid-1", "solid-2"))
    a, b = balls[one], balls[two]
    changed = list(balls)
    changed[one] = _join([(a, _halves(a)[0]), (b, _halves(b)[1])], found, t)
    changed[two] = _join([(b, _halves(b)[0]), (a, _halves(a)[1])], found, t)
    return changed


def _cut(balls: list[Tracklet], found: Any, t: FloatArray, run: ClipRun) -> list[Tracklet]:
    one = _find_tracklet(balls, run, "cue", found.xy)
    ball = balls[one]
    return [*balls[:one], *(_join([(ball, half)], found, t) for half in _halves(ball)), *balls[one + 1 :]]


def _glue(balls: list[Tracklet], found: Any, t: FloatArray, run: ClipRun) -> list[Tracklet]:
    one, two = (_find_tracklet(balls, run, name, found.xy) for name in ("stripe-1", "stripe-2"))
    glued = _join([(balls[one], _halves(balls[one])[0]), (balls[two], _halves(balls[two])[1])], found, t)
    return [glued if k == one else ball for k, ball in enumerate(balls) if k != two]


def _confuse_classes(run: ClipRun, detections: Detections) -> list[tuple[Any, str, Any]]:
    original = build_tracks.classify_balls
    swapped = {"cue": "eight", "eight": "cue"}

    def classify(*arguments: Any) -> tuple[str, ...]:
        return tuple(swapped.get(kind, kind) for kind in original(*arguments))

    return [(build_tracks, "classify_balls", classify)]


def _err_in_search(err: Callable[..., Any]) -> Callable[..., list[tuple[Any, str, Any]]]:
    """Make patches that change the contact graph after every search of its structure."""

    def make(run: ClipRun, detections: Detections) -> list[tuple[Any, str, Any]]:
        original = explain_shot.revise_graph

        def revise(solution: Any, search: Any, *rest: Any) -> Any:
            revised = original(solution, search, *rest)
            graph = err(revised, run)
            return revised if graph is None else search.refine(graph, revised)

        return [(explain_shot, "revise_graph", revise)]

    return make


def _lose_contact(solution: Any, run: ClipRun) -> Any:
    """Let the search take the first cushion contact of `solid-1` for a change without a cause, unless it is marked."""
    graph, ball = solution.graph, run.tracks.ids.index("solid-1")
    for number, contact in enumerate(graph.contacts):
        if contact.cushion == "bottom" and graph.balls_at(contact) == {ball} and contact.gain < HELD_GAIN:
            return graph.replace_contact(number, replace(contact, kind="free", cushion=""))
    return None


def _invent_strike(solution: Any, run: ClipRun) -> Any:
    """Let the search find a second strike of the cue ball."""
    ball, t = run.tracks.ids.index("cue"), float(np.interp(FALSE_STRIKE_FRAME, run.tracks.frame, run.tracks.t))
    graph = solution.graph
    k = find_segment_at(graph, ball, t)
    if abs(graph.start_time(k) - t) < 0.1:
        return None
    state = np.concatenate([evaluate_state(graph, solution.friction, k, t), np.zeros(2)])
    return graph.insert_contact(Contact("strike", t, (k,), (), gain=500.0), (state,))


def _no_patches(run: ClipRun, detections: Detections) -> list[tuple[Any, str, Any]]:
    return []


def _no_corrections(run: ClipRun) -> Corrections:
    return Corrections()


def _shift_corners(shift: FloatArray) -> Callable[[ClipRun], Corrections]:
    def make(run: ClipRun) -> Corrections:
        moved = run.scene.camera.corners_px + shift
        return Corrections(corners=tuple((float(x), float(y)) for x, y in moved))

    return make


ONE_CORNER = np.array([[26.0, 18.0], [0, 0], [0, 0], [0, 0]])
MISTAKES = (
    Mistake("one corner off", _shift_corners(ONE_CORNER), _no_patches),
    Mistake("all corners off", _shift_corners(np.full((4, 2), 22.0)), _no_patches),
    Mistake("wrong table", lambda run: Corrections(table="pool-7ft"), _no_patches),
    Mistake("wrong frame rate", lambda run: Corrections(fps="60"), _no_patches),
    Mistake("identity switch", _no_corrections, _edit_tracklets(_exchange)),
    Mistake("missed ball", _no_corrections, _drop_ball, detects=True),
    Mistake("false ball", _no_corrections, _add_false_ball, detects=True),
    Mistake("missed contact", _no_corrections, _err_in_search(_lose_contact)),
    Mistake("false contact", _no_corrections, _err_in_search(_invent_strike)),
    Mistake("split track", _no_corrections, _edit_tracklets(_cut)),
    Mistake("merged tracks", _no_corrections, _edit_tracklets(_glue)),
    Mistake("wrong ball class", _no_corrections, _confuse_classes),
)


def _match_balls(run: ClipRun, truth: ClipRun) -> dict[str, str]:
    """Map the ids of a run to those of the balls in the same places, for a correction renames no other ball."""
    gaps = np.linalg.norm(run.tracks.xy[:, :, None] - truth.tracks.xy[:, None], axis=3)  # (F, N, M)
    nearest = np.nanmedian(gaps, axis=0).argmin(axis=1)
    return {name: truth.tracks.ids[k] for name, k in zip(run.tracks.ids, nearest, strict=True)}


def list_differences(run: ClipRun, truth: ClipRun) -> list[str]:
    """List how a run differs from another one by more than the noise of both; ids may differ."""
    one, two, true_ids = run.fit.events, truth.fit.events, _match_balls(run, truth)
    differences = []
    kinds = {true_ids[name]: kind for name, kind in zip(run.tracks.ids, run.tracks.kinds, strict=True)}
    if kinds != dict(zip(truth.tracks.ids, truth.tracks.kinds, strict=True)):
        differences.append(f"balls {run.tracks.ids} instead of {truth.tracks.ids}")
    lengths = [one_run.scene.table.length for one_run in (run, truth)]
    if abs(lengths[0] - lengths[1]) > 0.01:
        differences.append(f"a table of {lengths[0]} instead of {lengths[1]} m")
    names = [
        [(e.kind[k], *sorted(ids.get(name, name) for name in (e.a[k], e.b[k]))) for k in range(len(e))]
        for e, ids in ((one, true_ids), (two, {}))
    ]
    if names[0] != names[1]:
        return [*differences, f"events {names[0]} instead of {names[1]}"]
    for k in range(len(one)):
        allowed = 3 * float(np.hypot(one.t_sigma[k], two.t_sigma[k]))
        if abs(one.t[k] - two.t[k]) > allowed:
            differences.append(f"{names[0][k]} at {one.t[k]:.4f} instead of {two.t[k]:.4f} s")
        if np.hypot(*(one.xy[k] - two.xy[k])) > PLACE_NOISE:
            differences.append(f"{names[0][k]} at {one.xy[k]} instead of {two.xy[k]} m")
    return differences
