"""What the checks against faults share: batches as processes, and what lies on the disk afterwards."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parent.parent
PROGRAM = "from pipeline.cli.main import main; main()"
COMPARED = (".csv", ".json", ".npz", ".png", ".mp4")
"""What is equal byte for byte after equal runs; recordings, pages and logs hold times and random names."""
QUICK = ("--quick", "--slow", "1")


@dataclass(frozen=True)
class Place:
    """A folder with clips, and a cache and results of their own name."""

    folder: Path
    name: str

    @property
    def clips(self) -> Path:
        return self.folder / "clips"

    @property
    def out(self) -> Path:
        return self.folder / self.name / "out"

    @property
    def cache(self) -> Path:
        return self.folder / self.name / "cache"

    @property
    def temporary(self) -> Path:
        """What the system calls temporary, of these batches alone; never on the disk that holds cache and results."""
        return self.folder / f"tmp {self.name}"

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """`trueroll batch` on the clips; its folders are named as seen from a folder of its own."""
        home = self.folder / self.name
        for room in (home, self.temporary):
            room.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-c", PROGRAM, "batch", str(self.clips), "-o", "out", "--cache", "cache"]
        return subprocess.Popen(
            [*command, *QUICK, *arguments], cwd=home, env=environment() | {"TMPDIR": str(self.temporary)}, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    def run(self, *arguments: str, timeout: float = 1800) -> tuple[int, str, str]:
        process = self.start(*arguments)
        out, err = process.communicate(timeout=timeout)
        return process.returncode, out, err


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "200"}


def contents(place: Place) -> dict[str, str]:
    """Hash of every file that is compared, in the results and in finished entries of the cache."""
    found = {}
    for room, folder in (("out", place.out), ("cache", place.cache / "entries")):
        for path in folder.rglob("*"):
            if path.suffix in COMPARED and path.name != "manifest.json" and path.is_file():
                found[f"{room}/{path.relative_to(folder)}"] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def entries(cache: Path) -> dict[str, int]:
    """By key, the number of the file that says what a finished stage holds: another one was made again."""
    found = {}
    for path in (cache / "entries").glob("*/*/manifest.json"):
        try:
            found[path.parent.name] = path.stat().st_ino
        except FileNotFoundError:
            continue
    return found


def leftovers(place: Place) -> list[str]:
    """What was begun and lies about."""
    parts = [path for path in place.out.rglob(".*") if path.is_file()]
    return [str(path) for path in [*parts, *(place.cache / "building").glob("*"), *place.temporary.glob("*")]]


def torn(place: Place, whole: dict[str, str]) -> list[str]:
    """What lies under a final name and differs from an undisturbed run; summaries of the unfinished do."""
    found = contents(place).items()
    return [name for name, digest in found if not name.startswith("out/summary") and digest != whole.get(name)]


def tree(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """The process and all below it, as far as they live."""
    try:
        top = psutil.Process(process.pid)
        return [top, *top.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def gone(processes: list[psutil.Process], seconds: float = 20.0) -> bool:
    """Whether they all end by themselves."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not any(one.is_running() and one.status() != psutil.STATUS_ZOMBIE for one in processes):
            return True
        time.sleep(0.1)
    return False
