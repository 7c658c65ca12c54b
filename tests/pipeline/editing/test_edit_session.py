"""A session of the editor: which of options and corrections count, and what stays in the folder of the run."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.edit_servers import ask, serve_synthetic_run, wait_for_result

from models.core.by_hand.corrections import Corrections
from pipeline.io.by_hand.corrections_file import CorrectionsFile, read_corrections, write_corrections
from pipeline.run_options import RunOptions, build_options

WRONG = {"corners": "10,10,200,30,220,120,20,118", "table": "pool-8ft", "ball_radius": 0.02, "fps": "25"}
RIGHT = {"corners": [[20, 20], [220, 20], [220, 120], [20, 120]], "table": "pool-9ft", "ball_radius": 0.03, "fps": "30"}


def read_settings(options: RunOptions) -> dict[str, object]:
    calibrate = options.calibrate
    return {"corners": calibrate.corners, "table": calibrate.table, "ball_radius": calibrate.ball_radius,
            "fps": options.read.fps}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_correction_beats_the_option_that_the_editor_started_with(name: str, tmp_path: Path) -> None:
    honoured: list[RunOptions] = []
    with serve_synthetic_run(tmp_path, build_options({name: WRONG[name]}), honoured) as server:
        start = ask(server, "GET", "state")[1]
        ask(server, "PUT", "corrections", {**start["corrections"], name: RIGHT[name]}, If_Match='"0"')
        wait_for_result(server)
    expected = "20,20,220,20,220,120,20,120" if name == "corners" else RIGHT[name]
    assert [read_settings(one)[name] for one in honoured] == [WRONG[name], expected]


def test_options_are_what_the_corrections_start_from(tmp_path: Path) -> None:
    honoured: list[RunOptions] = []
    with serve_synthetic_run(tmp_path, build_options(WRONG), honoured) as server:
        start = ask(server, "GET", "state")[1]["corrections"]
        assert start["corners"] == [[10, 10], [200, 30], [220, 120], [20, 118]]
        assert not (tmp_path / "shot.mp4.corrections.json").exists()
        ask(server, "PUT", "corrections", {"fps": "25"}, If_Match='"0"')  # the others were removed
        wait_for_result(server)
        ask(server, "POST", "undo", If_Match='"1"')
        wait_for_result(server)
    without = dict.fromkeys(WRONG) | {"fps": "25"}
    assert [read_settings(one) for one in honoured] == [WRONG, without, WRONG]
    assert read_corrections(tmp_path / "shot.mp4").corrections.table == "pool-8ft"


def test_corrections_that_are_there_beat_the_options_of_the_editor(tmp_path: Path) -> None:
    honoured: list[RunOptions] = []
    write_corrections(tmp_path / "shot.mp4", CorrectionsFile(1, "", Corrections(table="pool-9ft")))
    with serve_synthetic_run(tmp_path, build_options({"table": "pool-8ft", "fps": "25"}), honoured) as server:
        assert ask(server, "GET", "state")[1]["corrections"] == {"table": "pool-9ft", "fps": "25"}
    assert read_settings(honoured[0]) == dict.fromkeys(WRONG) | {"table": "pool-9ft", "fps": "25"}
