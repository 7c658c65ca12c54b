"""Corrections by hand in a run: each repairs the mistake that was planted into a stage."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.planted_mistakes import (
    FALSE_PLACE,
    FALSE_STRIKE_FRAME,
    LOST_FRAME,
    MISTAKES,
    OPTIONS,
    SPLIT_FRAME,
    CleanRun,
    Mistake,
    SilentWatcher,
    list_differences,
    plant,
    point_of,
    prepare_mistake,
    run_clip_tables,
)
from support.sample_clips import SAMPLES

from models.core.by_hand.corrections import BallMark, BallPlace, ContactCorrection, Corrections, TrackEdit
from pipeline.batch.clip_job import ClipJob
from pipeline.batch.clip_run import run_job
from pipeline.chain import build_fit_graph, honour_corrections
from pipeline.editing.run_view import ClipRun
from pipeline.engine.result_cache import ResultCache
from pipeline.io.by_hand.corrections_file import CorrectionsFile, corrections_path, write_corrections
from pipeline.run_options import apply_corrections, build_options, list_overridden_flags, list_setting_values


def place(run: ClipRun, ball: str, frame: int) -> BallPlace:
    x, y = point_of(run, ball, frame)
    return BallPlace(frame, float(x), float(y), ball)


REPAIRS: dict[str, Callable[[ClipRun], Corrections]] = {
    "one corner off": lambda run: Corrections(
        corners=tuple((round(float(x)), round(float(y))) for x, y in run.scene.camera.corners_px)
    ),
    "all corners off": lambda run: Corrections(),
    "wrong table": lambda run: Corrections(table="pool-9ft"),
    "wrong frame rate": lambda run: Corrections(fps="30"),
    "identity switch": lambda run: Corrections(
        tracks=(
            TrackEdit(
                "swap", place(run, "solid-1", SPLIT_FRAME), place(run, "solid-2", SPLIT_FRAME), first=SPLIT_FRAME
            ),
        )
    ),
    "missed ball": lambda run: Corrections(balls=(BallMark("placed", place(run, "stripe-1", 30)),)),
    "false ball": lambda run: Corrections(balls=(BallMark("false", BallPlace(20, *map(float, FALSE_PLACE))),)),
    "missed contact": lambda run: Corrections(
        contacts=(
            ContactCorrection("mark", "cushion", LOST_FRAME, place(run, "solid-1", LOST_FRAME), cushion="bottom"),
        )
    ),
    "false contact": lambda run: Corrections(
        contacts=(ContactCorrection("delete", "strike", FALSE_STRIKE_FRAME, place(run, "cue", FALSE_STRIKE_FRAME)),)
    ),
    "split track": lambda run: Corrections(
        tracks=(TrackEdit("merge", place(run, "cue", SPLIT_FRAME - 1), place(run, "cue", SPLIT_FRAME)),)
    ),
    "merged tracks": lambda run: Corrections(
        tracks=(TrackEdit("split", place(run, "stripe-2", SPLIT_FRAME), first=SPLIT_FRAME),)
    ),
    "wrong ball class": lambda run: Corrections(tracks=(TrackEdit("class", place(run, "cue", 0), name="cue"),)),
}
"""The correction of each mistake, as a person would make it."""


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda one: one.name)
def test_a_corrected_run_equals_the_run_without_the_mistake(mistake: Mistake, clean: CleanRun, tmp_path: Path) -> None:
    clip = prepare_mistake(mistake, clean, tmp_path)
    with plant(mistake, clean.run, clean.detections):
        wrong = run_clip_tables(clip, tmp_path / "out", tmp_path / "cache")
        assert list_differences(wrong, clean.run) or np.ptp(
            wrong.scene.camera.corners_px - clean.run.scene.camera.corners_px
        )
        write_corrections(clip, CorrectionsFile(2, "", REPAIRS[mistake.name](clean.run)))
        corrected = run_clip_tables(clip, tmp_path / "out", tmp_path / "cache")
    assert list_differences(corrected, clean.run) == []


def test_the_command_line_beats_the_file_and_the_file_beats_the_defaults(tmp_path: Path) -> None:
    clip = tmp_path / "shot.mp4"
    write_corrections(clip, CorrectionsFile(1, "", Corrections(fps="25", table="pool-8ft", ball_radius=0.0286)))
    typed = build_options({"fps": "50", "ball_radius": None})
    honoured = honour_corrections(clip, "ab", typed)
    assert (honoured.read.fps, honoured.calibrate.table, honoured.calibrate.ball_radius) == ("50", "pool-8ft", 0.0286)
    assert honour_corrections(tmp_path / "other.mp4", "ab", typed) == typed


def test_what_the_command_line_beats_is_named_and_is_no_correction_of_the_run(tmp_path: Path) -> None:
    corners = ((10.0, 10.0), (200.0, 10.0), (200.0, 100.0), (10.0, 100.0))
    by_hand = Corrections(fps="25", table="pool-8ft", corners=corners)
    typed = build_options({"table": "pool-9ft", "corners": "10,10, 200,10.0, 200,100, 10,100", "ball_radius": 0.03})
    assert list_overridden_flags(typed, by_hand) == ("--table",)
    assert apply_corrections(typed, by_hand).corrections == Corrections(fps="25")


PLACE = BallPlace(3, 100.0, 50.0)
FIRST_STAGES: dict[str, tuple[Corrections, str]] = {
    "fps": (Corrections(fps="25"), "read"),
    "corners": (Corrections(corners=((10, 10), (200, 10), (200, 100), (10, 100))), "calibrate"),
    "table": (Corrections(table="pool-8ft"), "calibrate"),
    "ball radius": (Corrections(ball_radius=0.02), "calibrate"),
    "placed ball": (Corrections(balls=(BallMark("placed", PLACE),)), "place"),
    "false ball": (Corrections(balls=(BallMark("false", PLACE),)), "track"),
    "track": (Corrections(tracks=(TrackEdit("rename", PLACE, name="nine"),)), "track"),
    "contact": (Corrections(contacts=(ContactCorrection("delete", "strike", 3.0, PLACE),)), "motion"),
}


@pytest.mark.parametrize(("corrections", "first"), FIRST_STAGES.values(), ids=FIRST_STAGES)
def test_a_correction_changes_the_key_of_its_stage_and_of_none_before(
    corrections: Corrections, first: str, tmp_path: Path
) -> None:
    clip = Path(shutil.copy(SAMPLES / "overhead_pool.mp4", tmp_path))

    def keys() -> dict[str, tuple[object, ...]]:
        stages = build_fit_graph(clip, OPTIONS).stages
        return {one.name: (json.dumps([one.json_options, one.facts], sort_keys=True), one.needs) for one in stages}

    before = keys()
    write_corrections(clip, CorrectionsFile(1, "", corrections))
    after = keys()
    changed = [name for name in after if after[name] != before.get(name)]
    assert changed[0] == first


def test_a_hostile_corrections_file_fails_one_clip_of_a_batch_with_a_sentence(tmp_path: Path) -> None:
    clip = Path(shutil.copy(SAMPLES / "overhead_pool.mp4", tmp_path))
    corrections_path(clip).write_text('{"schema": "trueroll.corrections/1", "balls": 3}')
    cache = ResultCache(tmp_path / "cache")
    job = ClipJob(str(clip), "shot", str(tmp_path / "out"), str(cache.root), cache.mark, list_setting_values(OPTIONS))
    result = run_job(job, SilentWatcher())
    assert result.status == "failed"
    assert "is no corrections file: balls is a list; got 3; mend it, or move it away" in result.sentence
    assert not (tmp_path / "out").exists()
