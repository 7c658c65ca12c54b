"""The page says what happened, stands alone, and trusts no name."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import made_up_shot as shot
import pytest

from pipeline.report import ReportFiles, write_report
from pipeline.verdict import run_trust


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    clip = shot.made_up_clip(folder / "clip.mp4")
    scene = shot.made_up_scene()
    tracks = shot.made_up_tracks(clip, scene)
    (folder / "poster.png").write_bytes(b"\x89PNG")
    files = ReportFiles(folder / "clip.mp4", folder / "poster.png", 8.0)
    hostile = "<script>alert(1)</script>.mp4"
    fit = shot.made_up_fit(tracks.t)
    write_report(clip, scene, tracks, fit, files, hostile, ["--slow 8"], folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


def test_the_page_loads_nothing_from_outside(page: str) -> None:
    outside = re.findall(r"<(?:script|link|img|video|source|iframe)[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*>", page)
    assert outside == []


def test_a_file_name_cannot_run_a_script(page: str) -> None:
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page


def test_each_event_seeks_the_slow_motion_to_a_little_before_it(page: str) -> None:
    seeks = [float(s) for s in re.findall(r'data-seek="([\d.]+)"', page)]
    assert seeks == pytest.approx([0.0, (0.5 - 0.15) * 8.0])


def test_the_page_says_who_did_what_when_and_how_surely(page: str) -> None:
    assert "white hits the right cushion at 0.50 m/s" in page
    assert "0.5000 s ± 1.0 ms" in page
    assert "everything is made up" in page
    assert "rolling_resistance.mu" in page


def test_a_clip_that_breaks_off_is_amber_and_says_why(tmp_path: Path) -> None:
    clip = replace(shot.made_up_clip(tmp_path / "clip.mp4"), notes=("it breaks off at 0.50 s of 0.80 s",))
    trust = run_trust(clip, shot.made_up_fit(clip.t))
    assert trust.light == "amber"
    assert "breaks off at 0.50 s" in trust.reasons[0]
