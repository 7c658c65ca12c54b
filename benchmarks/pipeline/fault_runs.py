"""Shared parts of the fault checks: batches as processes, and the files they leave on disk."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = "from pipeline.cli.main import main; main()"
# File types that equal runs write byte for byte; recordings, pages and logs contain times and random names.
COMPARED = (".csv", ".json", ".npz", ".png", ".mp4")
QUICK = ("--quick", "--slow", "1")


@dataclass(frozen=True)
class BatchFolder:
    """A folder with clips, and a named folder with cache and results."""

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
        """Temporary folder of these batches, never on the disk of cache and results."""
        return self.folder / f"tmp {self.name}"

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Start `trueroll batch` on the clips, with paths relative to its own folder."""
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


def hash_contents(place: BatchFolder) -> dict[str, str]:
    """Hash every compared file of the results and of finished cache entries."""
    hashes = {}
    for room, folder in (("out", place.out), ("cache", place.cache / "entries")):
        for path in folder.rglob("*"):
            if path.suffix in COMPARED and path.name != "manifest.json" and path.is_file():
                hashes[f"{room}/{path.relative_to(folder)}"] = hashlib.sha256(path.read_bytes()).hexdigest()
    return hashes


def read_manifests(cache: Path) -> dict[str, int]:
    """Return the inode of the manifest of every finished stage, by key: a new inode means a recomputed stage."""
    inodes = {}
    for path in (cache / "entries").glob("*/*/manifest.json"):
        try:
            inodes[path.parent.name] = path.stat().st_ino
        except FileNotFoundError:
            continue
    return inodes


def find_leftovers(place: BatchFolder) -> list[str]:
    """List unfinished and temporary files."""
    parts = [path for path in place.out.rglob(".*") if path.is_file()]
    return [str(path) for path in [*parts, *(place.cache / "building").glob("*"), *place.temporary.glob("*")]]


def find_torn_files(place: BatchFolder, whole: dict[str, str]) -> list[str]:
    """List files under final names that differ from an undisturbed run, except summaries of unfinished batches."""
    hashes = hash_contents(place).items()
    return [name for name, digest in hashes if not name.startswith("out/summary") and digest != whole.get(name)]


def process_tree(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """List the process and all its living descendants."""
    try:
        top = psutil.Process(process.pid)
        return [top, *top.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def wait_for_end(processes: list[psutil.Process], seconds: float = 20.0) -> bool:
    """Wait for the processes to end by themselves; returns whether they all did."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not any(one.is_running() and one.status() != psutil.STATUS_ZOMBIE for one in processes):
            return True
        time.sleep(0.1)
    return False
