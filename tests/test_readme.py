"""What the README tells a reader to type works, and it promises what the program has."""

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
    """The commands of the console blocks, without prompt and comment."""
    found = re.findall(r"```console\n(.*?)```", README, re.DOTALL)
    lines = [[line for line in block.splitlines() if line.startswith("$ ")] for block in found]
    return [[re.sub(r"\s+# .*$", "", line).removeprefix("$ ").strip() for line in block] for block in lines]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project by links, so that what the commands write lands elsewhere."""
    folder = tmp_path_factory.mktemp("checkout")
    for path in ROOT.iterdir():
        if path.name not in ("out", ".git"):
            (folder / path.name).symlink_to(path)
    return folder


def set_up_by_make() -> bool:
    return subprocess.run(["make", "-q", ".venv/.program"], cwd=ROOT, capture_output=True, check=False).returncode == 0


def type_in(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
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


def to_type() -> list[object]:
    """Every block without `make test`, which is what runs this; `make run` takes minutes, so `.ci/run` asks for it."""
    typed = [[command for command in block if command != "make test"] for block in blocks()]
    return [
        pytest.param(block, marks=[pytest.mark.slow] if "make run" in block else [], id=block[0])
        for block in typed if block
    ]  # fmt: skip


@pytest.mark.parametrize("block", to_type())
def test_a_block_of_the_readme_works_from_top_to_bottom(block: list[str], checkout: Path) -> None:
    if not set_up_by_make():
        pytest.skip("the environment was not set up by make, and the README's commands need that; run make test")
    for command in block:
        done = type_in(command, checkout)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        named = re.search(r"-o (\S+)", command)
        made = checkout / (named.group(1) if named else "out")
        if command == "make run":
            clips = sorted(path.name for path in (ROOT / "sample_videos").glob("*.mp4"))
            assert len(list(made.glob("*/slow.mp4"))) == len(clips)
            assert "slow.mp4" in done.stdout, "it says where to look"
        elif " run " in command:
            assert (made / "slow.mp4").stat().st_size > 0
            assert (made / "report.html").stat().st_size > 0
        elif " simulate " in command:
            assert (made / "trajectory.csv").stat().st_size > 0


def test_the_readme_names_the_two_commands_first() -> None:
    assert blocks()[0] == ["make run", "make test"]


def test_its_picture_is_there() -> None:
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    assert pictures
    assert not [picture for picture in pictures if not (ROOT / picture).is_file()]


def test_every_command_that_it_lists_has_help() -> None:
    program = ROOT / ".venv" / "bin" / "trueroll"
    if not program.exists():
        pytest.skip("the program is not installed in .venv; run make test")
    told = type_in(f"{program} --help", ROOT).stdout
    listed = set(re.findall(r"^\| `trueroll ([a-z-]+)", README, re.MULTILINE))
    assert listed
    assert not [name for name in listed if not re.search(rf"^\W*{name}\b", told, re.MULTILINE)]
