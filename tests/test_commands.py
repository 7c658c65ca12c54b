"""Every command of README and every notebook works in an environment that `make run` alone has made."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.shot_folders import write_shots

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
CLIP = "sample_videos/overhead_pool.mp4"
COMMANDS = {
    "app": "app --no-browser",
    "check CLIP": f"check {CLIP}",
    "run CLIP": f"run {CLIP} -o out/overhead_pool",
    "batch FOLDER": "batch clips -o out/batch --no-video",
    "view CLIP|DIR": "view out/overhead_pool --web",
    "edit DIR": "edit out/overhead_pool --no-browser",
    "call DIR QUESTION": "call out/overhead_pool contact cue solid-1",
    "predict DIR|tracks.csv": "predict out/overhead_pool --at 1.0",
    "put-back DIR": "put-back out/overhead_pool",
    "compare DIR...": "compare out/overhead_pool -o out/session",
    "what-if DIR": "what-if out/overhead_pool --speed -5%",
    "interpolate CLIP --factor N": f"interpolate {CLIP} --factor 2 --frames out/frames -o out/between.mp4",
    "interpolate tracks.csv --factor N": "interpolate thrown.csv --factor 4 -o out/thrown.csv",
    "fit-table DIR...": "fit-table shots -o out/table.json",
    "certify DIR...": "certify shots -o out/certificate",
    "gapcheck": 'gapcheck --only "slide, friction" --shots 6 --keep out/cases',
    "convert INPUT -o OUTPUT": "convert out/overhead_pool/tracks.csv -o out/tracks.parquet",
    "diagnose INPUT...": "diagnose out/cases/0000",
    "simulate SHOT.json": "simulate docs/examples/shot.json -o out/simulated",
    "detect IMAGE|FOLDER": "detect out/frames/000000.png -o out/balls.csv",
    "train-detector": "train-detector -o out/balls.onnx",
    "reproduce [double-pendulum|boxes|real|pool]": "reproduce double-pendulum --quick -o out/reproduce",
    "graph": f"graph {CLIP} -o out/graph.svg",
    "cache": "cache",
}
"""By its entry in README's table: an invocation with little work, in an order in which each finds what it reads."""
SHOTS = 4
"""Number of shots that teach a table; they have the least number of cushion contacts, and some more."""
SERVING = {"app", "view CLIP|DIR", "edit DIR"}
"""Commands that serve a page until they are interrupted."""
NEED_EXTRAS = {"train-detector", "reproduce", "gapcheck"}
"""Commands that may name an extra before any work; the others work with what `make run` installs."""
EXTRA = re.compile(r"install trueroll with the extra (\w+): \S+")
"""The sentence that names an extra."""
MAX_REFUSAL_S = 8.0
"""Most CPU time of a command that names a missing extra, s: what it takes to import the program."""


MAX_WAIT_S = 3600.0
"""Time after which a command hangs, s; a busy machine is slow."""


def list_documented_commands() -> set[str]:
    """Return the commands in the first column of README's table."""
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("## Commands")[1].split("\n## ")[0]
    cells = [re.split(r"(?<!\\)\| (?=\w|\[)", line)[0] for line in section.splitlines() if line.startswith("| `")]
    return {name.replace(r"\|", "|") for cell in cells for name in re.findall(r"`trueroll ([^`]+)`", cell)}


def test_every_command_of_the_readme_is_tried() -> None:
    assert list_documented_commands() == COMMANDS.keys()


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a copy of the project from links, and its environment as `make run` does."""
    folder = tmp_path_factory.mktemp("checkout")
    for path in ROOT.iterdir():
        if path.name not in ("out", "build", ".git", ".venv") and path.suffix != ".egg-info":
            (folder / path.name).symlink_to(path)
    done = subprocess.run(["make", ".venv/.program"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "The largest (MB)" in done.stdout
    write_shots(folder / "shots", SHOTS)
    (folder / "clips").mkdir()
    shutil.copy(ROOT / CLIP, folder / "clips")
    fall = "".join(f"stone,{k / 30:.6f},{0.5 * k / 30:.6f},{4.905 * (k / 30) ** 2:.6f}\n" for k in range(16))
    (folder / "thrown.csv").write_text(f"id,t,x,y\n{fall}", encoding="utf-8")
    return folder


def environment(folder: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    return kept | {"TRUEROLL_CACHE": str(folder / "cache"), "OMP_NUM_THREADS": "1", "BROWSER": "true"}


def try_command(command: str, folder: Path, *, serves: bool) -> str:
    """Run a command; return why it failed, or an empty string."""
    program = [str(folder / ".venv" / "bin" / "trueroll"), *shlex.split(command)]
    if serves:
        return try_page(program, folder)
    began = os.times()
    done = subprocess.run(
        program, cwd=folder, env=environment(folder), capture_output=True, text=True, timeout=MAX_WAIT_S, check=False
    )
    ended = os.times()
    spent = ended.children_user + ended.children_system - began.children_user - began.children_system
    print(f"{spent:6.1f} s  trueroll {command}", flush=True)
    if done.returncode == 0 and "Traceback" not in done.stderr:
        return ""
    names_extra = EXTRA.search(done.stderr) is not None and done.stderr.count("\n") == 1 and not done.stdout
    if names_extra and spent < MAX_REFUSAL_S and command.split()[0] in NEED_EXTRAS:
        return ""
    return f"exit {done.returncode} after {spent:.0f} s: {done.stderr or done.stdout}"


def try_page(program: list[str], folder: Path) -> str:
    """Start a command that serves a page, load the page, and interrupt the command."""
    log = folder / "page.log"
    with log.open("w") as out:
        process = subprocess.Popen(program, cwd=folder, env=environment(folder), stdout=out, stderr=out)
    try:
        return load_page(process, log)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=MAX_WAIT_S)


def load_page(process: subprocess.Popen[bytes], log: Path) -> str:
    """Load the page whose address a process prints, and return why that failed, or an empty string."""
    end = time.monotonic() + MAX_WAIT_S
    while time.monotonic() < end and process.poll() is None:
        address = re.search(r"http://\S+", log.read_text(encoding="utf-8"))
        if address is not None:
            try:
                with urllib.request.urlopen(address[0], timeout=10) as page:
                    return "" if b"<html" in page.read().lower() else "the page is no page"
            except ConnectionError:
                pass  # it prints the address first
            except urllib.error.URLError as error:
                if not isinstance(error.reason, ConnectionError):
                    raise
        time.sleep(0.2)
    return f"no page was served: {log.read_text(encoding='utf-8')}"


def read_cells(path: Path) -> Iterator[str]:
    """Yield the code of a notebook."""
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            yield "".join(cell["source"])


@pytest.mark.slow
def test_commands_and_notebooks_work_after_make_run_alone(checkout: Path) -> None:
    failures = {
        name: why
        for name, command in COMMANDS.items()
        if (why := try_command(command, checkout, serves=name in SERVING))
    }
    for path in NOTEBOOKS:
        if "import mujoco" in "\n".join(read_cells(path)):
            continue  # it needs the extra `simulators`, as it says at its top
        script = checkout / f"{path.stem}_notebook.py"
        script.write_text("\n".join(read_cells(path)), encoding="utf-8")
        began = time.monotonic()
        done = subprocess.run(
            [checkout / ".venv" / "bin" / "python", script], cwd=checkout, env=environment(checkout),
            capture_output=True, text=True, timeout=MAX_WAIT_S, check=False,
        )  # fmt: skip
        print(f"{time.monotonic() - began:6.1f} s  {path.name}")
        if done.returncode:
            failures[path.name] = done.stderr
    assert not failures, "\n".join(f"{name}: {why}" for name, why in failures.items())
