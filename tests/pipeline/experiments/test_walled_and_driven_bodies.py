"""Diagnoses of independently simulated bodies between walls and with known inputs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.page_words import read_page

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import DiagnosisReport
from pipeline.experiments.gapcheck.blind_case import simulate_case
from pipeline.experiments.gapcheck.body_cases import DRIVEN_KINDS, WALL_KINDS
from pipeline.io.gap_files import build_gap_document
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene
from pipeline.reporting.pages.gap_page import write_gap_page

KINDS = {kind.name: kind for kind in (*WALL_KINDS, *DRIVEN_KINDS)}


def diagnose_kind(name: str, folder: Path, shots: int = 6) -> DiagnosisReport:
    simulate_case(KINDS[name], 11, shots, 60.0, folder / "sealed.json", folder / "case")
    read = read_track_folders([folder / "case"])
    return diagnose(build_gap_scene(read), read.recordings)


def test_a_wall_that_takes_speed_is_named_and_located(tmp_path: Path) -> None:
    report = diagnose_kind("slide between walls, wall restitution", tmp_path, 4)
    assert report.effects == ("wall_restitution",)
    assert build_gap_document(report)["where"][0]["phase"] == "cushion_contact", "the only name of the schema"
    write_gap_page(report, "walls", tmp_path / "gap.html")
    words = read_page(tmp_path / "gap.html")
    assert "at walls" in words
    assert not re.search(r"\b(cushion|ball|table)s?\b", words)
    assert report.gap.closure.closed > 0.95
    strength = next(one for one in report.fitted if one.name == "wall_restitution.e")
    assert 0.5 < strength.value < 0.9
    assert strength.sigma < 0.02


def test_friction_is_named_beside_a_stated_motion_of_a_platform(tmp_path: Path) -> None:
    report = diagnose_kind("slide on a moving platform, friction", tmp_path, 4)
    assert report.effects == ("sliding_friction",)


@pytest.mark.slow
def test_a_moving_pivot_is_unknown_unless_it_is_stated(tmp_path: Path) -> None:
    for name in ("stated", "silent"):
        (tmp_path / name).mkdir()
    stated = diagnose_kind("pendulum with a moving pivot, joint friction", tmp_path / "stated")
    assert stated.effects == ("joint_friction",)
    assert diagnose_kind("pendulum with a moving pivot that is not stated", tmp_path / "silent").verdict == "unknown"
