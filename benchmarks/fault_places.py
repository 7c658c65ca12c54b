"""Disks that are full, closed or gone, two batches at once, clips that change, and a process that hangs."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
from fault_runs import Place, contents, leftovers, torn, tree

Line = tuple[str, str, str, bool]
SMALL = "3m"
"""Size of the disk that is full: the read stages fit, the pages do not."""


def places(folder: Path, whole: dict[str, str]) -> list[Line]:
    """All lines."""
    lines = [two_at_once(folder, whole), changing(folder), hanging(folder, whole)]
    if not _may_mount(folder):
        return [*lines, ("full disk, closed output, lost cache", "as said", "not run: no right to mount", True)]
    return [*lines, full(folder, whole), closed(folder), *lost(folder, whole)]


def two_at_once(folder: Path, whole: dict[str, str]) -> Line:
    """Two batches with one cache and one folder of results."""
    place = Place(folder, "two")
    both = [place.start(), place.start("--jobs", "2")]
    for process in both:
        process.communicate(timeout=1800)
    status = [process.returncode for process in both]
    differing = _differing(place, whole)
    good = status == [0, 0] and not differing and not leftovers(place)
    return ("two batches at once, one cache, one output", "exit 0, equal", f"exit {status}, {differing} differ", good)


def changing(folder: Path) -> Line:
    """A clip that is written anew, again and again, while its batch runs; then it rests."""
    place = Place(folder / "changing", "run")
    place.clips.mkdir(parents=True)
    sources = sorted((folder / "clips").iterdir())[:2]
    clip, stop = place.clips / "a.mp4", threading.Event()
    shutil.copy(sources[0], clip)

    def write() -> None:
        k = 0
        while not stop.wait(0.5):
            k += 1
            clip.write_bytes(sources[k % 2].read_bytes())

    writer = threading.Thread(target=write)
    writer.start()
    first, _, err = place.run()
    stop.set()
    writer.join()
    clip.write_bytes(sources[0].read_bytes())
    last, _, _ = place.run()
    alone = Place(folder / "changing", "alone")
    alone.run()
    wrong = torn(place, contents(alone) | {n: d for n, d in contents(place).items() if n.startswith("cache/")})
    poisoned = [n for n, d in contents(alone).items() if n.startswith("cache/") and contents(place).get(n, d) != d]
    good = first in (0, 1) and last == 0 and not wrong and not poisoned and not err
    return ("a clip that changes while it is read", "a sentence; right after rest",
            f"exit {first}, then {last}; {len(wrong)} files wrong, {len(poisoned)} entries poisoned", good)  # fmt: skip


def hanging(folder: Path, whole: dict[str, str]) -> Line:
    """A process that stands still in foreign code, as seen from outside: it is stopped by the system."""
    place = Place(folder, "hanging")
    process, stopped = place.start("--time-limit", "60"), False
    end = time.monotonic() + 120
    while not stopped and time.monotonic() < end and process.poll() is None:
        for child in tree(process)[1:]:
            if any((place.cache / "building").glob("detect-*")):
                child.send_signal(signal.SIGSTOP)
                stopped = True
                break
        time.sleep(0.05)
    out, _ = process.communicate(timeout=1800)
    again, _, _ = place.run()
    told = "--time-limit" in out
    good = stopped and process.returncode == 1 and told and again == 0 and not _differing(place, whole)
    return ("a decoder that hangs", "one clip fails, the rest is done; rerun right",
            f"exit {process.returncode}, {'told' if told else 'not told'}; rerun exit {again}", good)  # fmt: skip


def full(folder: Path, whole: dict[str, str]) -> Line:
    """Cache and results on a disk that is too small; then it is given room."""
    place = Place(folder, "full")
    home = folder / place.name
    with _mounted(home, "-t", "tmpfs", "-o", f"size={SMALL}", "tmpfs"):
        status, out, err = place.run()
        sentences = out.count("No space left")
        bad, left = torn(place, whole), leftovers(place)
        subprocess.run(["mount", "-o", "remount,size=500m", str(home)], check=True)
        again, _, _ = place.run()
        differing = _differing(place, whole)
    good = status == 1 and not (bad or left or differing or "Traceback" in err) and again == 0
    found = f"exit {status}, {sentences} told, {len(bad)} torn, {len(left)} left; exit {again}, {differing} differ"
    return ("a full disk", "exit 1, nothing torn; with room exit 0, equal", found, good)


def closed(folder: Path) -> Line:
    """Results on a disk that is read only."""
    place = Place(folder, "closed")
    place.out.mkdir(parents=True)
    with _mounted(place.out, "-t", "tmpfs", "-o", "ro", "tmpfs"):
        status, _, err = place.run()
    good = status == 2 and err.count("\n") == 1
    return (
        "an output that is read only",
        "one sentence before the work, exit 2",
        f"exit {status}: {err.strip()[:80]}",
        good,
    )


def lost(folder: Path, whole: dict[str, str]) -> list[Line]:
    """A cache whose mount goes away at work, and comes back."""
    place, real = Place(folder, "lost"), folder / "real cache"
    real.mkdir()
    place.cache.mkdir(parents=True)
    with _mounted(place.cache, "--bind", str(real)):
        process = place.start()
        end = time.monotonic() + 120
        while not any((real / "building").glob("detect-*")) and time.monotonic() < end:
            time.sleep(0.05)
        subprocess.run(["umount", "-l", str(place.cache)], check=True)
        out, err = process.communicate(timeout=1800)
        beneath = list(place.cache.iterdir())
        subprocess.run(["mount", "--bind", str(real), str(place.cache)], check=True)
        again, _, _ = place.run()
        differing = _differing(place, whole)
    told, status = out.count("is gone"), process.returncode
    return [
        ("a cache whose mount is lost", "exit 1, told, nothing made in its place",
         f"exit {status}, told {told} times, {len(beneath)} files in its place",
         status == 1 and told > 0 and not beneath and "Traceback" not in err),
        ("the same once the mount is back", "exit 0, equal", f"exit {again}, {differing} differ",
         again == 0 and not differing),
    ]  # fmt: skip


def _differing(place: Place, whole: dict[str, str]) -> int:
    now = contents(place)
    return sum(whole.get(name) != now.get(name) for name in whole.keys() | now.keys())


def _may_mount(folder: Path) -> bool:
    if os.name != "posix" or os.geteuid() != 0 or shutil.which("mount") is None:
        return False
    try:
        with _mounted(folder / "try", "-t", "tmpfs", "tmpfs"):
            return True
    except subprocess.CalledProcessError:
        return False


@contextmanager
def _mounted(target: Path, *words: str) -> Iterator[None]:
    target.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", *words, str(target)], check=True, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        with suppress(psutil.Error, subprocess.CalledProcessError):
            subprocess.run(["umount", "-l", str(target)], check=True)
