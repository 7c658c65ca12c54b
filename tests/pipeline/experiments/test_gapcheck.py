"""The blind check: withheld effects stay sealed, and reports are graded correctly."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.cli.execute import execute_command_line
from pipeline.experiments.gapcheck.billiards_cases import BILLIARDS_KINDS, DEFAULT_KINDS, KINDS, BilliardsKind, CaseKind
from pipeline.experiments.gapcheck.blind_case import (
    OpenedCase,
    Proportion,
    compute_calibration,
    count_confusions,
    grade_report,
    score_cases,
    simulate_case,
)
from pipeline.experiments.gapcheck.body_cases import BODY_KINDS
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

FRICTION = next(kind for kind in BODY_KINDS if kind.name == "slide, friction")
CLEAN = next(kind for kind in BODY_KINDS if kind.name == "slide, nothing missing")
STRANGE = next(kind for kind in BODY_KINDS if kind.name == "slide, curl")
BOTH = next(kind for kind in BODY_KINDS if kind.name == "slide, friction and slope")


def billiards(case: str) -> BilliardsKind:
    return next(kind for kind in BILLIARDS_KINDS if kind.case == case)


def make_case(kind: CaseKind, answer: str, named: str, closed: float = 0.9, oracle: float = 1.0) -> OpenedCase:
    return OpenedCase(kind, 0, answer, (named,), 0.97, closed, (0.8, 1.0), oracle)  # type: ignore[arg-type]


def test_the_track_folder_does_not_tell_what_acts(tmp_path: Path) -> None:
    simulate_case(FRICTION, 3, 5, 60.0, tmp_path / "sealed.json", tmp_path / "case")
    assert "sliding_friction" in (tmp_path / "sealed.json").read_text()
    for path in (tmp_path / "case").iterdir():
        assert "friction" not in path.read_text()
    with (tmp_path / "case" / "tracks.csv").open(newline="") as file:
        assert len({row["shot"] for row in csv.DictReader(file)}) == 5


def test_cases_of_a_kind_differ_by_seed_and_repeat_with_it() -> None:
    first, again, other = (FRICTION.draw_experiment(seed, 12, 60.0) for seed in (1, 1, 2))
    assert first == again
    assert first["effects"] != other["effects"]
    assert len({kind.name for kind in KINDS}) == len(KINDS)


@pytest.fixture(scope="module")
def shutter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One shot under a rolling shutter: the sealed experiment and its track folder."""
    folder = tmp_path_factory.mktemp("shutter")
    simulate_case(billiards("rolling_shutter"), 130, 1, 62.5, folder / "sealed.json", folder / "case")
    return folder


def test_a_billiards_track_folder_does_not_tell_what_acts(shutter: Path) -> None:
    kind = billiards("rolling_shutter")
    assert "readout" in (shutter / "sealed.json").read_text()
    for path in (shutter / "case").iterdir():
        assert "shutter" not in path.read_text()
    read = read_track_folders([shutter / "case"])
    assert [len(one.t) for one in read.recordings] == [125]
    assert kind.simulator(build_gap_scene(read)).simulator_effects == kind.model


def summarize_positions(folder: Path) -> list[float]:
    """Return the sum of all coordinates, and one in which each counts with a weight of its own, m."""
    shots = read_track_folders([folder]).recordings
    values = np.concatenate([one.positions.ravel() for one in shots])
    return [float(values.sum()), float(values @ np.sin(np.arange(len(values))))]


def test_recordings_of_a_kind_and_a_seed_stay_as_they_were_counted(shutter: Path, tmp_path: Path) -> None:
    simulate_case(billiards("slope"), 130, 1, 62.5, tmp_path / "sealed.json", tmp_path / "case")
    assert summarize_positions(shutter / "case") == pytest.approx([386.725685, 1.053917], abs=3e-6)
    assert summarize_positions(tmp_path / "case") == pytest.approx([954.271668, 0.382353], abs=3e-6)


@pytest.mark.parametrize(
    ("case", "verdict", "names", "wanted"),
    [
        ("none", "none", (), "right"), ("none", "effects", ("slope",), "wrong"),
        ("slope", "effects", ("slope",), "right"), ("slope", "effects", ("slope", "nap"), "wrong"),
        ("slope", "unknown", (), "unknown"), ("slope", "none", (), "none"),
        ("ball_law", "effects", ("ball_law",), "right"), ("ball_law", "effects", ("ball_friction",), "right"),
        ("ball_law", "effects", ("ball_friction", "nap"), "wrong"),
        ("slope, not in the library", "unknown", (), "right"), ("curl", "effects", ("nap",), "wrong"),
        ("lens of the fourth order", "effects", ("lens_distortion",), "right"),
        ("slope, shots in one direction", "undecidable", (), "right"), ("wrong frame rate", "none", (), "right"),
        ("wrong frame rate", "unknown", (), "unknown"),
    ],
)  # fmt: skip
def test_answers_are_judged_by_what_was_withheld(case: str, verdict: str, names: tuple[str, ...], wanted: str) -> None:
    report = SimpleNamespace(verdict=verdict, effects=names, candidates=())
    assert grade_report(billiards(case), report) == wanted  # type: ignore[arg-type]


def test_the_simulator_of_a_kind_has_its_law_and_its_library(shutter: Path) -> None:
    scene = build_gap_scene(read_track_folders([shutter / "case"]))
    assert "slope" not in [one.name for one in billiards("slope, not in the library").simulator(scene).effects]
    law = next(one for one in billiards("cushion law, from another").simulator(scene).alternatives)
    assert (law.name, law.simulator_form) == ("cushion_law", "han_2005")


def test_rates_are_counted_over_the_cases_that_are_asked() -> None:
    cases = [
        make_case(FRICTION, "right", "sliding_friction"), make_case(FRICTION, "group", "sliding_friction"),
        make_case(FRICTION, "unknown", "unknown", np.nan), make_case(CLEAN, "right", "none", np.nan, np.nan),
        make_case(CLEAN, "wrong", "slope", np.nan, np.nan), make_case(STRANGE, "right", "unknown", np.nan, np.nan),
        make_case(BOTH, "wrong", "slope", 0.5),
        make_case(billiards("wrong frame rate"), "right", "none", np.nan, np.nan),
    ]  # fmt: skip
    marks = score_cases(cases)
    assert (marks.named, marks.grouped) == (Proportion(1, 3), Proportion(2, 3))
    assert (marks.pairs, marks.alarms, marks.unknowns) == (Proportion(0, 1), Proportion(1, 2), Proportion(1, 1))
    assert marks.traps == Proportion(1, 1)
    assert marks.closed == pytest.approx((np.median([0.9, 0.9, 0.0, 0.5]), np.quantile([0.9, 0.9, 0.0, 0.5], 0.1)))
    assert marks.covered == Proportion(3, 3)
    assert ("slide, friction", "unknown", 1) in count_confusions(cases)
    assert sum(rate.of for _, _, rate in compute_calibration(cases)) == len(cases)


def test_the_interval_of_a_rate_is_wilsons() -> None:
    low, high = Proportion(9, 10).interval
    assert (low, high) == pytest.approx((0.5958, 0.9821), abs=1e-4)
    assert Proportion(0, 0).interval == (0.0, 1.0)


def test_nothing_to_check_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute_command_line(["gapcheck", "--only", "nonsense"]) == 2
    assert "slide, friction" in capsys.readouterr().err


def test_kinds_whose_engine_is_not_there_are_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("pipeline.cli.commands.gapcheck_command.find_spec", lambda name: None)
    assert execute_command_line(["gapcheck", "--only", "by MuJoCo", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["cases"] == []
    assert "3 kinds are left out" in captured.err
    assert "extra check" in " ".join(captured.err.split())


@pytest.mark.slow
def test_friction_is_found_blind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["gapcheck", "--only", "slide, friction", "--shots", "8", "--keep", str(tmp_path), "--json"]
    assert execute_command_line(words) == 0
    cases = {one["kind"]: one for one in json.loads(capsys.readouterr().out)["cases"]}
    assert cases["slide, friction"]["answer"] == "right"
    assert cases["slide, friction"]["closed"] > 0.95 * cases["slide, friction"]["oracle"]
    assert (tmp_path / "0000" / "gap" / "gap.json").is_file()
    assert replace(FRICTION, foreign=True).withheld == {"sliding_friction"}


def test_without_a_word_every_question_is_asked_of_tables_once() -> None:
    tables = [kind for kind in DEFAULT_KINDS if kind in BILLIARDS_KINDS]
    assert len(tables) == 5
    assert sum(not kind.withheld for kind in tables) == 1
    assert sum(kind.foreign for kind in tables) == 1
    assert sum(len(kind.withheld) == 2 for kind in tables) == 1
    assert {one.name for one in BODY_KINDS} < {one.name for one in DEFAULT_KINDS} < {one.name for one in KINDS}
