"""The page of a run lists its events, needs no network, and escapes file names."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_run as shot

from pipeline.reporting.figures.run_figures import build_plan_figure, build_speed_figure
from pipeline.reporting.pages.run_report import ReportFiles, build_event_rows, write_report
from pipeline.reporting.text.run_trust import assess_run_trust
from pipeline.reporting.text.text_formatting import format_event


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    clip = shot.write_clip(folder / "clip.mp4")
    scene = shot.make_scene()
    tracks = shot.make_tracks(clip, scene)
    (folder / "poster.png").write_bytes(b"\x89PNG")
    files = ReportFiles(folder / "clip.mp4", folder / "poster.png", 8.0)
    hostile = "<script>alert(1)</script>.mp4"
    fit = shot.make_fit(tracks.t)
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


def test_events_seek_where_a_slow_motion_without_its_still_beginning_shows_them() -> None:
    fit = shot.make_fit(np.linspace(0, 0.8, 25))
    rows = build_event_rows(fit, ReportFiles(Path("slow.mp4"), Path("poster.png"), 8.0, start=0.2))
    assert [row["seek"] for row in rows] == pytest.approx([0.0, (0.5 - 0.15 - 0.2) * 8.0])


def test_the_page_lists_events_with_time_and_trust_level(page: str) -> None:
    assert "white hits the right cushion at 0.50 m/s" in page
    assert "0.5000 s ± 1.0 ms" in page
    assert "everything is made up" in page
    assert "rolling resistance, mu" in page


def test_a_touch_of_negligible_speed_is_described_without_it() -> None:
    events = shot.make_fit(np.linspace(0, 0.8, 25)).events
    slow = replace(events, speed=np.array([np.nan, 0.004]))
    assert format_event(events, 1) == "white hits the right cushion at 0.50 m/s"
    assert format_event(slow, 1) == "white hits the right cushion"
    assert format_event(slow, 0) == "white is struck"


@pytest.mark.parametrize(("creep", "lines"), [(0.0, ["white"]), (0.01, ["white"]), (0.1, ["red", "white"])])
def test_the_plan_shows_every_ball_and_the_ways_of_those_that_get_somewhere(creep: float, lines: list[str]) -> None:
    fit = shot.make_fit(np.linspace(0, 0.8, 25))
    position = fit.trajectory.position.copy()
    position[1, 1] = [0, creep]
    fit = replace(fit, trajectory=replace(fit.trajectory, position=position))
    drawn = build_plan_figure(shot.make_scene(), fit, ["white", "red"]).data[:-1]
    assert sorted(trace.name for trace in drawn if trace.mode == "markers") == ["red", "white"]
    assert sorted(trace.name for trace in drawn if trace.mode == "lines" and len(trace.x)) == lines
    assert sorted(trace.name for trace in build_speed_figure(shot.make_scene(), fit, ["white", "red"]).data) == lines


def test_a_clip_that_breaks_off_is_amber_with_the_reason(tmp_path: Path) -> None:
    clip = replace(shot.write_clip(tmp_path / "clip.mp4"), notes=("it breaks off at 0.50 s of 0.80 s",))
    trust = assess_run_trust(clip, shot.make_fit(clip.t))
    assert trust.level == "amber"
    assert "breaks off at 0.50 s" in trust.reasons[0]
