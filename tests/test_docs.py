"""What the documentation points at is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from models.estimation.gap_scenes.flight_scene import flight_scene
from models.estimation.gap_scenes.pendulum_scene import pendulum_scene
from models.estimation.gap_scenes.sliding_scene import slide_scene
from models.physics.effects.catalogue import BILLIARDS
from pipeline.cli.commands import ORDER

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
LINK = re.compile(r"!?\[[^\]]*\]\(([^)#\s]+)[^)]*\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    links = [link for link in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link]
    assert [link for link in links if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_that_is_shown_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    shown = set(re.findall(r"(?:`|\$ )(?:\.venv/bin/)?trueroll ([a-z][a-z-]+)", text))
    assert shown - set(ORDER) == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_of_the_project_that_is_named_is_there(page: Path) -> None:
    rooms = "benchmarks|tests|models|video|detectors|diagnosis|pipeline|worlds|docs|sample_videos"
    named = set(re.findall(rf"`((?:{rooms})/[A-Za-z0-9_/.-]+)`", page.read_text(encoding="utf-8")))
    assert sorted(name for name in named if not (ROOT / name).exists()) == []


def test_every_effect_that_a_simulator_may_have_is_listed() -> None:
    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    part = page.partition("## A track folder")[2].partition("\n## ")[0]
    scenes = (slide_scene(()), flight_scene(3, 9.81, ()), pendulum_scene(2, ()))
    effects = (*BILLIARDS, *(effect for scene in scenes for effect in scene.effects))
    wanted = {effect.name for effect in effects if effect.kind in ("physics", "observation")}
    assert sorted(name for name in wanted if f"`{name}`" not in part) == []


def test_every_page_is_found_from_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    linked = set(LINK.findall(index)) | {"index.md"}
    assert {page.name for page in (ROOT / "docs").glob("*.md")} - linked == set()
