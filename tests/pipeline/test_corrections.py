"""Corrections by hand in a run: each repairs the mistake that was planted into a stage."""

from __future__ import annotations

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
    SPLIT_FRAME,
    CleanRun,
    Mistake,
    list_differences,
    make_clean_run,
    plant,
    point_of,
    run_clip_tables,
)

from models.core.by_hand.corrections import BallMark, BallPlace, ContactCorrection, Corrections, TrackEdit
from pipeline.editing.run_view import ClipRun
from pipeline.io.by_hand.corrections_file import CorrectionsFile, write_corrections


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> CleanRun:
    return make_clean_run(tmp_path_factory.mktemp("clean"))


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
    shutil.copytree(clean.located if mistake.detects else clean.detected, tmp_path / "cache")
    clip = Path(shutil.copy(clean.clip, tmp_path))
    with plant(mistake, clean.run, clean.detections):
        write_corrections(clip, CorrectionsFile(1, "", mistake.corrections(clean.run)))
        wrong = run_clip_tables(clip, tmp_path / "out", tmp_path / "cache")
        assert list_differences(wrong, clean.run) or np.ptp(
            wrong.scene.camera.corners_px - clean.run.scene.camera.corners_px
        )
        write_corrections(clip, CorrectionsFile(2, "", REPAIRS[mistake.name](clean.run)))
        corrected = run_clip_tables(clip, tmp_path / "out", tmp_path / "cache")
    assert list_differences(corrected, clean.run) == []
