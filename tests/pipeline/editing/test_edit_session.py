"""A session of the editor: which of options and corrections count, and what stays in the folder of the run."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from support.edit_sessions import SHOWN_TABLES, open_synthetic_session, wait_for_result

from models.core.corrections import Corrections
from pipeline.chain import write_source
from pipeline.editing import edit_session
from pipeline.engine.stage_graph import RunWatcher
from pipeline.io.corrections_file import (
    SCHEMA,
    CorrectionsFile,
    parse_corrections,
    read_corrections,
    write_corrections,
)
from pipeline.io.run_folder import STAGE_FILES
from pipeline.run_options import RunOptions, build_options

WRONG = {"corners": "10,10,200,30,220,120,20,118", "table": "pool-8ft", "ball_radius": 0.02, "fps": "25"}
RIGHT = {"corners": [[20, 20], [220, 20], [220, 120], [20, 120]], "table": "pool-9ft", "ball_radius": 0.03, "fps": "30"}


def read_settings(options: RunOptions) -> dict[str, object]:
    calibrate = options.calibrate
    return {"corners": calibrate.corners, "table": calibrate.table, "ball_radius": calibrate.ball_radius,
            "fps": options.read.fps}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_correction_beats_the_option_that_the_editor_started_with(name: str, tmp_path: Path) -> None:
    runs: list[tuple[RunOptions, bool]] = []
    with open_synthetic_session(tmp_path, build_options({name: WRONG[name]}), runs) as session:
        start = session.describe()["corrections"]
        session.change(parse_corrections({"schema": SCHEMA, **start, name: RIGHT[name]}).corrections, 0)
        wait_for_result(session)
    expected = "20,20,220,20,220,120,20,120" if name == "corners" else RIGHT[name]
    assert [read_settings(one)[name] for one, _ in runs] == [WRONG[name], expected]


def test_all_files_of_a_new_correction_are_written_after_its_result_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[str | None] = []
    superseded = threading.Event()

    def run_clip(
        path: Path, folder: Path, options: RunOptions, cache: object, watcher: RunWatcher, **_: object
    ) -> None:
        written.append(read_corrections(path).corrections.fps)
        if len(written) == 1:
            with session._lock:
                session.change(Corrections(fps="30"), 1)
                session.finish()
            try:
                watcher.start_stage("report")
            except edit_session.SupersededError:
                superseded.set()
                raise

    monkeypatch.setattr(edit_session, "run_clip", run_clip)
    with open_synthetic_session(tmp_path) as session:
        with session._lock:  # before the worker begins
            session.change(Corrections(fps="25"), 0)
            session.finish()
        assert superseded.wait(30.0)
        assert wait_for_result(session, 30.0)["result"] == 2
    assert written[0] == "25"


def test_options_are_what_the_corrections_start_from(tmp_path: Path) -> None:
    runs: list[tuple[RunOptions, bool]] = []
    with open_synthetic_session(tmp_path, build_options(WRONG), runs) as session:
        start = session.describe()["corrections"]
        assert start["corners"] == [[10, 10], [200, 30], [220, 120], [20, 118]]
        assert not (tmp_path / "shot.mp4.corrections.json").exists()
        session.change(Corrections(fps="25"), 0)  # the others were removed
        wait_for_result(session)
        session.step(1, forward=False)
        wait_for_result(session)
    without = dict.fromkeys(WRONG) | {"fps": "25"}
    assert [read_settings(one) for one, _ in runs] == [WRONG, without, WRONG]
    assert read_corrections(tmp_path / "shot.mp4").corrections.table == "pool-8ft"


@pytest.mark.parametrize(
    "damage",
    [None, b"", b"[4]", b"[4, 3, [], []]", b'[9, [{"fps": "30"}], [{"fps": "25"}], []]',
     b'[4, [{"fps": "24"}], [{"fps": "25"}], []]'],
)  # fmt: skip
def test_what_can_be_undone_outlives_the_session(damage: bytes | None, tmp_path: Path) -> None:
    history = tmp_path / "own" / "history.json"
    with open_synthetic_session(tmp_path, history=history) as session:
        for revision, rate in enumerate(("25", "30", "50")):
            session.change(Corrections(fps=rate), revision)
        session.step(3, forward=False)
    if damage is not None:
        history.write_bytes(damage)
    with open_synthetic_session(tmp_path, history=history) as session:
        assert (session.status.can_undo, session.status.can_redo) == (damage is None, damage is None)
        if damage is None:
            session.step(4, forward=False)
            session.step(5, forward=True)
            session.step(6, forward=True)
            assert read_corrections(tmp_path / "shot.mp4").corrections.fps == "50"


def test_corrections_that_are_there_beat_the_options_of_the_editor(tmp_path: Path) -> None:
    runs: list[tuple[RunOptions, bool]] = []
    write_corrections(tmp_path / "shot.mp4", CorrectionsFile(1, "", Corrections(table="pool-9ft")))
    with open_synthetic_session(tmp_path, build_options({"table": "pool-8ft", "fps": "25"}), runs) as session:
        assert session.describe()["corrections"] == {"table": "pool-9ft", "fps": "25"}
    assert read_settings(runs[0][0]) == dict.fromkeys(WRONG) | {"table": "pool-9ft", "fps": "25"}


def make_run_folder(folder: Path, report_tables: str) -> Path:
    folder.mkdir()
    for names in STAGE_FILES.values():
        for name in names:
            (folder / name).write_text("of the run")
    write_source(folder.parent / "shot.mp4", folder, RunOptions(), None, report_tables)
    return folder


def test_a_start_with_other_events_says_so_and_writes_nothing(tmp_path: Path) -> None:
    runs: list[tuple[RunOptions, bool]] = []
    folder = make_run_folder(tmp_path / "out", "")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with open_synthetic_session(tmp_path, runs=runs) as session:
        state = session.describe()
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
        assert state["notice"].startswith(
            f"These events differ from those in {folder}: its options, its corrections or"
        )
        assert session.status.outputs == "older"
        session.change(Corrections(fps="25"), 0)
        assert wait_for_result(session)["notice"] == ""
    assert [publishes for _, publishes in runs] == [False, True]


@pytest.mark.parametrize(("report_tables", "outputs"), [(SHOWN_TABLES, "current"), ("cd" * 32, "older")])
def test_whether_the_report_is_older_follows_from_the_folder(report_tables: str, outputs: str, tmp_path: Path) -> None:
    folder = make_run_folder(tmp_path / "out", report_tables)
    with open_synthetic_session(tmp_path) as session:
        assert session.status.outputs == outputs
    (folder / "report.html").unlink()
    with open_synthetic_session(tmp_path) as session:
        assert session.status.outputs == "missing"
