"""The commands of the README work, and every command that it lists exists."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
MINUTES = 10


def blocks() -> list[list[str]]:
    """Return the commands of each console block, without prompt and comment."""
    texts = re.findall(r"```console\n(.*?)```", README, re.DOTALL)
    lines = [[line for line in text.splitlines() if line.startswith("$ ")] for text in texts]
    return [[re.sub(r"\s+# .*$", "", line).removeprefix("$ ").strip() for line in block] for block in lines]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a copy of the project from links, so that the commands write elsewhere."""
    folder = tmp_path_factory.mktemp("checkout")
    for path in ROOT.iterdir():
        if path.name not in ("out", ".git"):
            (folder / path.name).symlink_to(path)
    return folder


def is_set_up_by_make() -> bool:
    return subprocess.run(["make", "-q", ".venv/.program"], cwd=ROOT, capture_output=True, check=False).returncode == 0


def run_command(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"TRUEROLL_CACHE": str(folder / "cache"), "COLUMNS": "120"}
    return subprocess.run(
        command,
        shell=True,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60 * MINUTES,
        check=False,
    )


def runnable_blocks() -> list[object]:
    """Return every block without `make test`, which runs this test."""
    runnable = [[command for command in block if command != "make test"] for block in blocks()]
    return [pytest.param(block, id=block[0]) for block in runnable if block]


@pytest.mark.slow
@pytest.mark.parametrize("block", runnable_blocks())
def test_a_block_of_the_readme_works_from_top_to_bottom(block: list[str], checkout: Path) -> None:
    if not is_set_up_by_make():
        pytest.skip("the environment was not set up by make, and the README's commands need that; run make test")
    for command in block:
        completed = run_command(command, checkout)
        assert completed.returncode == 0, completed.stdout + completed.stderr
        assert "Traceback" not in completed.stderr
        option = re.search(r"-o (\S+)", command)
        results = checkout / (option.group(1) if option else "out")
        if command == "make run":
            clips = sorted(path.name for path in (ROOT / "sample_videos").glob("*.mp4"))
            assert len(list(results.glob("*/slow.mp4"))) == len(clips)
            assert "slow.mp4" in completed.stdout, "the output names the results"
        elif " run " in command:
            assert (results / "slow.mp4").stat().st_size > 0
            assert (results / "report.html").stat().st_size > 0
        elif " simulate " in command:
            assert (results / "trajectory.csv").stat().st_size > 0


def test_the_readme_names_the_two_commands_first() -> None:
    assert blocks()[0] == ["make run", "make test"]


@pytest.mark.parametrize("status", [0, 2])
def test_a_double_click_makes_the_page_and_shows_why_it_cannot(status: int, tmp_path: Path) -> None:
    starter = ROOT / "trueroll.command"
    assert f"`{starter.name}`" in README
    make = tmp_path / "make"
    make.write_text(f'#!/bin/sh\necho "make $@ in $PWD"\nexit {status}\n', encoding="utf-8")
    make.chmod(0o755)
    done = subprocess.run(
        [starter], cwd=tmp_path, env={"PATH": f"{tmp_path}:/usr/bin:/bin"}, input="\n", capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.stdout.splitlines()[0] == f"make app in {ROOT}"
    assert ("could not be started" in done.stdout) == bool(status)


def test_its_image_is_there() -> None:
    images = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    assert images
    assert not [image for image in images if not (ROOT / image).is_file()]


def test_every_command_that_it_lists_has_help() -> None:
    program = ROOT / ".venv" / "bin" / "trueroll"
    if not program.exists():
        pytest.skip("the program is not installed in .venv; run make test")
    printed = run_command(f"{program} --help", ROOT).stdout
    names = set(re.findall(r"^\| `trueroll ([a-z-]+)", README, re.MULTILINE))
    assert names
    assert not [name for name in names if not re.search(rf"^\W*{name}\b", printed, re.MULTILINE)]
