"""The documentation names only what exists, and its tables match the program."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main

from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.pendulum_scene import build_pendulum_scene
from models.estimation.gap_scenes.sliding_scene import SPRING, build_sliding_scene
from models.physics.billiards.contact_models import (
    BALL_MODEL_CHOICE,
    BALL_MODELS,
    CUSHION_MODEL_CHOICE,
    CUSHION_MODELS,
    REGISTERED_CUSHION_MODELS,
)
from models.physics.billiards.tables import TABLE_PRESETS
from models.physics.effect import Effect
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS
from models.physics.mechanisms.mechanism_catalogue import MECHANISM_EFFECTS
from models.physics.mechanisms.mechanism_effect import MechanismEffect
from pipeline.cli.commands import COMMAND_NAMES, load_command
from pipeline.terminal.command_line import app

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md"), ROOT / "sample_videos" / "README.md"])
DECISIONS = sorted((DOCS / "decisions").glob("[0-9]*.md"))
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
COMMAND = re.compile(r"(?:`|\$ )(?:\.venv/bin/)?trueroll ([a-z][a-z-]+)([^`\n]*)")
PROJECT = "benchmarks|tests|trueroll|models|video|detectors|diagnosis|pipeline|worlds|docs|sample_videos"

every_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as the site and GitHub form them."""
    headings = re.findall(r"^#+ (.+)$", read(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def option_names(command: str) -> set[str]:
    load_command(command)
    group = typer.main.get_command(app)
    parameters = getattr(group, "commands", {}).get(command, group).params
    return {name for parameter in parameters for name in parameter.opts if name.startswith("-")} | {"--help"}


@every_page
def test_every_link_leads_somewhere(page: Path) -> None:
    broken = []
    for link in LINK.findall(read(page)):
        if "://" in link:
            continue
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


@every_page
def test_every_command_and_option_that_is_shown_exists(page: Path) -> None:
    for command, words in COMMAND.findall(read(page)):
        assert command in COMMAND_NAMES
        shown = set(re.findall(r"(?<=[\s\[])(--?[a-z][a-z-]*)", words.partition("#")[0]))
        assert shown - option_names(command) == set(), command


@every_page
def test_every_file_of_the_project_that_is_named_is_there(page: Path) -> None:
    named = set(
        re.findall(rf"\b((?:{PROJECT})/[A-Za-z0-9_/.-]*[A-Za-z0-9_/])", re.sub(r"\]\([^)]*\)", "]", read(page)))
    )
    assert sorted(name for name in named if not (ROOT / name).exists()) == []


@every_page
def test_every_benchmark_and_its_options_exist(page: Path) -> None:
    for module, words in re.findall(r"-m (benchmarks[\w.]+)([^`\n]*)", read(page)):
        source = ROOT / (module.replace(".", "/") + ".py")
        assert source.exists(), module
        options = set(re.findall(r"(?<=\s)--[a-z][a-z-]*", words))
        declared = set(re.findall(r'"(--[a-z][a-z-]*)"', read(source)))
        declared |= {"--quick"} if "add_quick_option(parser)" in read(source) else set()
        assert sorted(options - declared) == [], module


def all_effects() -> list[tuple[str, Effect]]:
    """Return the effects of all scenes, each with the name of its scene."""
    scenes = {
        "billiards": BILLIARDS_EFFECTS,
        "slide": build_sliding_scene((), ((0.0, 1.0), (0.0, 1.0))).effects,
        "flight": build_flight_scene(3, 9.81, ()).effects,
        "pendulum": build_pendulum_scene(2, ()).effects,
    }
    listed = [(scene, effect) for scene, effects in scenes.items() for effect in effects if effect.kind != "probe"]
    return [*listed, ("slide", SPRING)]


def effect_rows() -> dict[tuple[str, str], str]:
    """Return the rows of the tables of effects by scene and effect: the columns after the name."""
    rows = {}
    for line in read(DOCS / "reference" / "effects.md").splitlines():
        if match := re.match(r"\|(?: (slide|flight|pendulum) \|)? `(\w+)` \|(.*)", line):
            rows[match[1] or "billiards", match[2]] = match[3]
    return rows


every_effect = pytest.mark.parametrize(
    ("scene", "effect"), [pytest.param(scene, effect, id=f"{scene}-{effect.name}") for scene, effect in all_effects()]
)


def test_the_track_folder_lists_every_effect_that_a_simulator_may_have() -> None:
    section = read(DOCS / "reference" / "file-formats.md").partition("## Track folder")[2].partition("\n## ")[0]
    rows: dict[str, str] = {}
    for line in section.splitlines():
        if match := re.match(r"\| (billiards|slide|flight|pendulum)\b[^|]*\|([^|]*)\|", line):
            rows[match[1]] = rows.get(match[1], "") + match[2]
    wanted = [(scene, effect.name) for scene, effect in all_effects() if effect.kind in ("physics", "observation")]
    assert [(scene, name) for scene, name in wanted if f"`{name}`" not in rows[scene]] == []


@every_effect
def test_the_table_of_effects_states_parameters_and_units(scene: str, effect: Effect) -> None:
    row = effect_rows()[scene, effect.name]
    for prior in effect.parameters:
        assert f"`{prior.name}`" in row
        assert f"({prior.unit})" in row


@pytest.mark.parametrize(
    "effect", [one for one in BILLIARDS_EFFECTS if one.kind != "probe"], ids=lambda effect: effect.name
)
def test_the_table_of_effects_states_prior_and_neutral_value(effect: Effect) -> None:
    usual, absent = (cell.strip() for cell in effect_rows()["billiards", effect.name].split("|")[1:3])
    for prior, neutral in zip(effect.parameters, effect.neutral, strict=True):
        sigma = f"{100 * prior.sigma:g}\u00a0%" if prior.relative else f"{prior.sigma:g}"
        assert usual == f"{prior.value:g}\u00a0±\u00a0{sigma}"
        own = {dict(law.standard_values).get(f"{effect.name}.{prior.name}") for law in REGISTERED_CUSHION_MODELS}
        if own == {None}:
            assert float(absent) == neutral
        else:
            assert {float(value) for value in re.findall(r"[\d.]+", absent)} == own


def test_no_row_of_the_table_of_effects_is_without_an_effect() -> None:
    assert effect_rows().keys() - {(scene, effect.name) for scene, effect in all_effects()} == set()


@pytest.mark.parametrize(
    "effect", [one for one in MECHANISM_EFFECTS.values() if one.kind != "probe"], ids=lambda e: e.name
)
def test_the_table_of_mechanisms_states_site_and_parameters(effect: MechanismEffect) -> None:
    section = read(DOCS / "reference" / "effects.md").partition("## Any mechanism")[2].partition("\n## ")[0]
    row = next(line for line in section.splitlines() if f"| `{effect.name}` |" in line)
    assert row.startswith(f"| {effect.site} |")
    assert [one.name for one in effect.strengths if f"`{one.name}`" not in row] == []


def test_every_contact_model_is_documented() -> None:
    page = read(DOCS / "reference" / "contact-models.md")
    assert [name for name in (*CUSHION_MODELS, *BALL_MODELS) if f"| `{name}` |" not in page] == []
    assert [
        choice.name
        for choice in (BALL_MODEL_CHOICE, CUSHION_MODEL_CHOICE)
        if f"`{choice.name}`" not in read(DOCS / "reference" / "effects.md")
    ] == []


def test_every_command_has_a_section_and_its_options() -> None:
    page = read(DOCS / "reference" / "commands.md")
    assert re.findall(r"^## (\S+)$", page, re.MULTILINE) == list(COMMAND_NAMES)
    assert re.findall(r"^<!-- options: (\S+) -->$", page, re.MULTILINE) == list(COMMAND_NAMES)


def test_every_table_preset_is_listed() -> None:
    page = read(DOCS / "reference" / "commands.md")
    assert [name for name in TABLE_PRESETS if f"`{name}`" not in page] == []


def test_every_page_is_in_the_navigation_and_linked_from_an_index() -> None:
    navigation = set(re.findall(r"[\w./-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))) - {"README.md"}
    assert navigation == {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    indexes = (DOCS / "index.md", DOCS / "decisions" / "index.md", DOCS / "reference" / "api" / "index.md")
    linked = {
        (page.parent / link.partition("#")[0]).resolve()
        for page in indexes for link in LINK.findall(read(page)) if "://" not in link
    }  # fmt: skip
    assert {page for page in DOCS.rglob("*.md") if page != DOCS / "index.md"} - linked == set()


@pytest.mark.parametrize("page", DECISIONS, ids=lambda page: page.name)
def test_a_decision_has_context_decision_and_consequences(page: Path) -> None:
    assert re.findall(r"^## (.+)$", read(page), re.MULTILINE) == ["Context", "Decision", "Consequences"]
    assert read(page).startswith(f"# {int(page.name[:3])}. ")


def test_decisions_are_numbered_without_gaps() -> None:
    assert [int(page.name[:3]) for page in DECISIONS] == list(range(1, len(DECISIONS) + 1))


@pytest.mark.slow
def test_the_site_builds_strictly_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    if importlib.util.find_spec("mkdocs") is None or importlib.util.find_spec("mkdocstrings") is None:
        pytest.skip("the docs extra is not installed; run make docs")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    loaded = re.compile(r"<(?:script|img|iframe)[^>]* src=\"(?:https?:)?//|<link[^>]* href=\"(?:https?:)?//")
    pages = sorted((tmp_path / "site").rglob("*.html"))
    assert pages
    assert [page.name for page in pages if loaded.search(read(page))] == []
