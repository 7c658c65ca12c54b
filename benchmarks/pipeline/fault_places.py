"""Batches under system faults: full, read-only or lost disks, parallel batches, changing clips, a hanging process."""

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

from benchmarks.pipeline.fault_runs import BatchFolder, find_leftovers, find_torn_files, hash_contents, process_tree

Line = tuple[str, str, str, bool]
# Size of the full disk: the read stages fit, the pages do not.
SMALL_DISK = "3m"


def run_all(folder: Path, whole: dict[str, str]) -> list[Line]:
    """Run all checks; returns the lines of the table."""
    lines = [run_two_batches(folder, whole), run_changing_clip(folder), run_hanging_decoder(folder, whole)]
    if not _may_mount(folder):
        return [*lines, ("full disk, read-only output, lost cache", "see README", "not run: no right to mount", True)]
    return [*lines, run_full_disk(folder, whole), run_read_only_output(folder), *run_lost_cache(folder, whole)]


def run_two_batches(folder: Path, whole: dict[str, str]) -> Line:
    """Run two batches with one cache and one folder of results."""
    place = BatchFolder(folder, "two")
    both = [place.start(), place.start("--jobs", "2")]
    for process in both:
        process.communicate(timeout=1800)
    status = [process.returncode for process in both]
    differing = _count_differing(place, whole)
    good = status == [0, 0] and not differing and not find_leftovers(place)
    return ("two batches at once, one cache, one output", "exit 0, equal", f"exit {status}, {differing} differ", good)


def run_changing_clip(folder: Path) -> Line:
    """Overwrite a clip repeatedly while its batch runs, then rerun with the clip unchanged."""
    place = BatchFolder(folder / "changing", "run")
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
    alone = BatchFolder(folder / "changing", "alone")
    alone.run()
    wrong = find_torn_files(
        place, hash_contents(alone) | {n: d for n, d in hash_contents(place).items() if n.startswith("cache/")}
    )
    poisoned = [
        n for n, d in hash_contents(alone).items() if n.startswith("cache/") and hash_contents(place).get(n, d) != d
    ]
    good = first in (0, 1) and last == 0 and not wrong and not poisoned and not err
    return ("a clip that changes while it is read", "an error message; correct on the rerun",
            f"exit {first}, then {last}; {len(wrong)} files wrong, {len(poisoned)} entries poisoned", good)  # fmt: skip


def run_hanging_decoder(folder: Path, whole: dict[str, str]) -> Line:
    """Stop a process of the batch, which looks like a hanging decoder from outside."""
    place = BatchFolder(folder, "hanging")
    process, stopped = place.start("--time-limit", "60"), False
    end = time.monotonic() + 120
    while not stopped and time.monotonic() < end and process.poll() is None:
        for child in process_tree(process)[1:]:
            if any((place.cache / "building").glob("detect-*")):
                child.send_signal(signal.SIGSTOP)
                stopped = True
                break
        time.sleep(0.05)
    out, _ = process.communicate(timeout=1800)
    again, _, _ = place.run()
    is_reported = "--time-limit" in out
    good = stopped and process.returncode == 1 and is_reported and again == 0 and not _count_differing(place, whole)
    return ("a decoder that hangs", "one clip fails, the others are done; rerun correct",
            f"exit {process.returncode}, {'reported' if is_reported else 'not reported'}; rerun exit {again}",
            good)  # fmt: skip


def run_full_disk(folder: Path, whole: dict[str, str]) -> Line:
    """Put cache and results on a disk that is too small, then enlarge it."""
    place = BatchFolder(folder, "full")
    home = folder / place.name
    with _mount_folder(home, "-t", "tmpfs", "-o", f"size={SMALL_DISK}", "tmpfs"):
        status, out, err = place.run()
        sentences = out.count("No space left")
        bad, left = find_torn_files(place, whole), find_leftovers(place)
        subprocess.run(["mount", "-o", "remount,size=500m", str(home)], check=True)
        again, _, _ = place.run()
        differing = _count_differing(place, whole)
    good = status == 1 and not (bad or left or differing or "Traceback" in err) and again == 0
    result = f"exit {status}, {sentences} errors reported, {len(bad)} torn, {len(left)} leftovers"
    result += f"; exit {again}, {differing} differ"
    return ("a full disk", "exit 1, nothing torn; with room exit 0, equal", result, good)


def run_read_only_output(folder: Path) -> Line:
    """Put the results on a read-only disk."""
    place = BatchFolder(folder, "closed")
    place.out.mkdir(parents=True)
    with _mount_folder(place.out, "-t", "tmpfs", "-o", "ro", "tmpfs"):
        status, _, err = place.run()
    good = status == 2 and err.count("\n") == 1
    return (
        "a read-only output",
        "one line of error before any work, exit 2",
        f"exit {status}: {err.strip()[:80]}",
        good,
    )


def run_lost_cache(folder: Path, whole: dict[str, str]) -> list[Line]:
    """Unmount the cache during a batch, then mount it again."""
    place, real = BatchFolder(folder, "lost"), folder / "real cache"
    real.mkdir()
    place.cache.mkdir(parents=True)
    with _mount_folder(place.cache, "--bind", str(real)):
        process = place.start()
        end = time.monotonic() + 120
        while not any((real / "building").glob("detect-*")) and time.monotonic() < end:
            time.sleep(0.05)
        subprocess.run(["umount", "-l", str(place.cache)], check=True)
        out, err = process.communicate(timeout=1800)
        beneath = list(place.cache.iterdir())
        subprocess.run(["mount", "--bind", str(real), str(place.cache)], check=True)
        again, _, _ = place.run()
        differing = _count_differing(place, whole)
    gone_count, status = out.count("is gone"), process.returncode
    return [
        ("a cache whose mount is lost", "exit 1, reported, nothing written in its place",
         f"exit {status}, reported {gone_count} times, {len(beneath)} files in its place",
         status == 1 and gone_count > 0 and not beneath and "Traceback" not in err),
        ("the same after mounting again", "exit 0, equal", f"exit {again}, {differing} differ",
         again == 0 and not differing),
    ]  # fmt: skip


def _count_differing(place: BatchFolder, whole: dict[str, str]) -> int:
    now = hash_contents(place)
    return sum(whole.get(name) != now.get(name) for name in whole.keys() | now.keys())


def _may_mount(folder: Path) -> bool:
    if os.name != "posix" or os.geteuid() != 0 or shutil.which("mount") is None:
        return False
    try:
        with _mount_folder(folder / "try", "-t", "tmpfs", "tmpfs"):
            return True
    except subprocess.CalledProcessError:
        return False


@contextmanager
def _mount_folder(target: Path, *words: str) -> Iterator[None]:
    target.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", *words, str(target)], check=True, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        with suppress(psutil.Error, subprocess.CalledProcessError):
            subprocess.run(["umount", "-l", str(target)], check=True)
