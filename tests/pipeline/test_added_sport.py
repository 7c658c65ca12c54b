"""A sport is one module: added to `models/sports`, it is an option of the commands and has its areas."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.staged_rally import stage_rally

import models.sports
from models.estimation.rally.landing_judgement import judge_landing
from models.sports.sport_catalogue import find_sports
from pipeline.run_options import build_options

MODULE = """
from models.core.court import CourtLine, FlyingObject, Net, Range, Sport

SPORT = Sport(
    "dummy", 10.0, 4.0,
    (CourtLine("far line", (9.95, 0.0), (9.95, 4.0), 0.1), CourtLine("left line", (0.0, 0.05), (10.0, 0.05), 0.1)),
    Net(0.5, 1.0, 1.1),
    FlyingObject("ball", 0.05, 0.2, Range(0.03, 0.01), Range(0.0, 0.05), 0.0, Range(0.0, 0.0), 0.03, None, None, 50.0),
    areas={"ring": ((5.0, 0.0, 10.0, 4.0), (0.0, 0.0, 5.0, 4.0))}, default_area="ring",
)
"""
PROGRAM = """import sys
import models.sports
models.sports.__path__.append(sys.argv.pop(1))
from pipeline.cli.main import main
main()"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the module of a sport."""
    (tmp_path / "dummy_sport.py").write_text(MODULE)
    return tmp_path


def test_the_help_lists_the_added_sport(folder: Path) -> None:
    words = [sys.executable, "-c", PROGRAM, str(folder), "run", "--help"]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env={"COLUMNS": "200", "PYTHONPATH": "."},
                          cwd=Path(__file__).parents[2])  # fmt: skip
    assert "billiards, badminton, dummy, table-tennis, tennis" in done.stdout


def test_its_landings_are_judged_by_its_areas(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models.sports, "__path__", [*models.sports.__path__, str(folder)])
    find_sports.cache_clear()
    try:
        sport = find_sports()["dummy"]
        assert build_options({"sport": "dummy"}).court.has_court
        call = judge_landing(stage_rally(sport, (9.8, 2.0)))
        assert (call.verdict, call.area, call.line) == ("in", "ring", "far line")
    finally:
        find_sports.cache_clear()
        sys.modules.pop("models.sports.dummy_sport", None)
