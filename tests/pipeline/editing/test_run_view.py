"""What the page lists as changed between two runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.naming import build_naming
from pipeline.editing.run_view import ClipRun, compare_runs


@pytest.fixture
def run(tmp_path: Path) -> ClipRun:
    clip = shot.write_clip(tmp_path / "shot.mp4")
    scene = shot.make_scene()
    tracks = shot.make_tracks(clip, scene)
    return rename(ClipRun(float(clip.fps), scene, tracks, shot.make_fit(tracks.t)))


def rename(run: ClipRun, **names: str) -> ClipRun:
    """Return a run with other names of its balls."""

    def change(ids: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(names.get(one, one) for one in ids)

    fit = run.fit
    events = replace(fit.events, a=change(fit.events.a), b=change(fit.events.b))
    trajectory = replace(fit.trajectory, ids=change(fit.trajectory.ids))
    tracks = replace(run.tracks, ids=change(run.tracks.ids), looks=())
    naming = build_naming(run.scene.table, run.scene.camera, tracks.ids, tracks.looks)
    return replace(run, tracks=tracks, fit=replace(fit, events=events, trajectory=trajectory, naming=naming))


def test_a_ball_that_is_only_called_otherwise_is_one_line(run: ClipRun) -> None:
    changes = compare_runs(run, rename(run, white="red", red="solid-2"))
    assert [one["text"] for one in changes] == ["white is now called red", "red is now called solid 2"]


def test_another_table_is_named(run: ClipRun) -> None:
    table = replace(run.scene.table, name="pool-9ft", length=2.54, width=1.27)
    changes = compare_runs(run, replace(run, scene=replace(run.scene, table=table)))
    assert changes[0]["text"] == "The table is pool-9ft, 2.54 x 1.27 m instead of carom-small, 2 x 1 m"


def test_an_event_that_is_gone_is_named_as_the_ball_is_called_now(run: ClipRun) -> None:
    after = rename(run, white="cue")
    after = replace(after, fit=replace(after.fit, events=after.fit.events.select_rows([0])))
    changes = compare_runs(run, after)
    assert [one["kind"] for one in changes[:2]] == ["changed", "removed"]
    assert changes[1]["text"].startswith("0.5000 s ± 1.0 ms: The cue ball hits the right short cushion")


def test_a_ball_that_is_no_longer_tracked_is_named(run: ClipRun) -> None:
    gone = replace(run, tracks=replace(run.tracks, px=run.tracks.px + np.array([[0.0, 0.0], [60.0, 0.0]])))
    assert [(one["kind"], one["text"]) for one in compare_runs(run, gone)][:2] == [
        ("added", "a ball: red"), ("removed", "a ball: red"),
    ]  # fmt: skip


def test_the_same_run_has_no_changes(run: ClipRun) -> None:
    assert compare_runs(run, run) == []
