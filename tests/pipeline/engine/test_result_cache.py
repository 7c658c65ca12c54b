"""Entries are whole or absent, made once, and thrown away when asked."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from pipeline.engine.result_cache import CacheEntry, CacheKey, ResultCache

ROOT = Path(__file__).resolve().parents[3]
HANG_S = 300.0
"""Time after which a process hangs, s."""

WORKER = """
import sys, time
from pathlib import Path
from pipeline.engine.result_cache import CacheKey
from pipeline.engine.result_cache import ResultCache

root, log, seconds = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])

def build(folder):
    (folder / "result.txt").write_text("half")
    with log.open("a") as lines:
        lines.write("built\\n")
    time.sleep(seconds)
    (folder / "result.txt").write_text("whole")

ResultCache(root).find_or_build(CacheKey("fit", {"options": {"speed": 1}}), build)
"""
KEY = CacheKey("fit", {"options": {"speed": 1}})


def store_text(cache: ResultCache, text: str, key: CacheKey = KEY) -> CacheEntry:
    return cache.find_or_build(key, lambda folder: (folder / "result.txt").write_text(text) and None)


def start_worker(cache: ResultCache, log: Path, seconds: float) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", WORKER, str(cache.root), str(log), str(seconds)]
    return subprocess.Popen(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)})


@pytest.fixture
def cache(tmp_path: Path) -> ResultCache:
    return ResultCache(tmp_path / "cache")


def test_an_entry_is_built_once_and_found_again(cache: ResultCache) -> None:
    assert cache.find(KEY) is None
    made = store_text(cache, "first")
    again, entry = store_text(cache, "second"), cache.find(KEY)
    assert entry is not None
    assert made.content == again.content == entry.content
    assert (made.folder / "result.txt").read_text() == "first"


def test_another_option_is_another_entry(cache: ResultCache) -> None:
    store_text(cache, "slow")
    other = CacheKey("fit", {"options": {"speed": 2}})
    assert cache.find(other) is None
    assert store_text(cache, "fast", other).folder != store_text(cache, "slow").folder


def test_equal_results_have_equal_content_whatever_made_them(cache: ResultCache) -> None:
    other = CacheKey("fit", {"options": {"speed": 2}})
    assert store_text(cache, "same").content == store_text(cache, "same", other).content
    assert store_text(cache, "same").content != store_text(cache, "different", CacheKey("fit", {})).content


@pytest.mark.parametrize("name", ["result.txt", "manifest.json"])
@pytest.mark.parametrize("damage", ["torn", "altered", "gone"])
def test_a_damaged_entry_is_noticed_and_rebuilt(cache: ResultCache, name: str, damage: str) -> None:
    file = store_text(cache, "whole").folder / name
    before = file.stat()
    text = file.read_text()
    if damage == "gone":
        file.unlink()
    else:
        file.write_text(text[: len(text) // 2] if damage == "torn" else text.replace("e", "E"))
        os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert cache.find(KEY) is None
    assert cache.is_damaged(KEY)
    assert (store_text(cache, "again").folder / "result.txt").read_text() == "again"
    assert not cache.is_damaged(KEY)


def test_a_build_that_fails_leaves_nothing(cache: ResultCache) -> None:
    def build(folder: Path) -> None:
        (folder / "result.txt").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.find_or_build(KEY, build)
    assert cache.find(KEY) is None
    assert not list((cache.root / "building").iterdir())
    assert not list((cache.root / "entries").rglob("*.txt"))


def test_two_processes_make_an_entry_once(cache: ResultCache, tmp_path: Path) -> None:
    log = tmp_path / "log"
    workers = [start_worker(cache, log, 0.5) for _ in range(2)]
    assert [w.wait(HANG_S) for w in workers] == [0, 0]
    assert log.read_text() == "built\n"
    entry = cache.find(KEY)
    assert entry is not None
    assert (entry.folder / "result.txt").read_text() == "whole"


def test_a_killed_process_leaves_no_entry_and_its_rubbish_is_pruned(cache: ResultCache, tmp_path: Path) -> None:
    log = tmp_path / "log"
    killed = start_worker(cache, log, 2 * HANG_S)
    wait_until(log.exists)
    killed.send_signal(signal.SIGKILL)
    killed.wait(HANG_S)
    assert not list((cache.root / "entries").rglob("*.txt"))
    (rubbish,) = (cache.root / "building").iterdir()
    cache.prune()
    assert not rubbish.exists()
    assert not list((cache.root / "locks").iterdir())
    assert (store_text(cache, "again").folder / "result.txt").read_text() == "again", "its lock died with it"


def test_building_an_entry_removes_what_a_killed_process_left(cache: ResultCache, tmp_path: Path) -> None:
    log = tmp_path / "log"
    killed = start_worker(cache, log, 2 * HANG_S)
    wait_until(log.exists)
    killed.kill()
    killed.wait(HANG_S)
    assert len(list((cache.root / "building").iterdir())) == 1
    store_text(cache, "again")
    assert not list((cache.root / "building").iterdir())


def test_what_a_process_at_work_builds_is_not_pruned(cache: ResultCache, tmp_path: Path) -> None:
    log = tmp_path / "log"
    busy = start_worker(cache, log, 2 * HANG_S)
    try:
        wait_until(log.exists)
        cache.prune(largest_bytes=0)
        assert len(list((cache.root / "building").iterdir())) == 1
        assert len(list((cache.root / "locks").iterdir())) == 1
    finally:
        busy.kill()
        busy.wait(HANG_S)


def wait_until(ready: object, seconds: float = HANG_S) -> None:
    end = time.monotonic() + seconds
    while not ready():  # type: ignore[operator]
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)


def test_pruning_by_age_removes_what_was_not_used(cache: ResultCache) -> None:
    old, fresh = (
        store_text(cache, "old", CacheKey("fit", {"k": 1})),
        store_text(cache, "fresh", CacheKey("fit", {"k": 2})),
    )
    last_week = time.time() - 7 * 86400
    os.utime(old.folder / "manifest.json", (last_week, last_week))
    assert [entry.key for entry in cache.prune(older_than_s=3 * 86400)] == [old.key]
    assert [entry.key for entry in cache.entries()] == [fresh.key]


def test_pruning_by_size_removes_the_least_recently_used_first(cache: ResultCache) -> None:
    keys = [CacheKey("render", {"k": k}) for k in range(3)]
    made = [store_text(cache, "x" * 1000, key) for key in keys]
    now = time.time()
    for age, entry in zip((10, 20, 30), made, strict=True):
        os.utime(entry.folder / "manifest.json", (now - age, now - age))
    cache.find(keys[2])
    assert [entry.key for entry in cache.prune(largest_bytes=2000)] == [made[1].key]


def test_entries_list_stage_size_and_key(cache: ResultCache) -> None:
    store_text(cache, "x" * 1000)
    (entry,) = cache.entries()
    assert (entry.stage, entry.size, entry.key) == ("fit", 1000, KEY.digest)


def test_processes_that_create_a_cache_together_share_one_mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    together = threading.Barrier(6)
    drawn = uuid.uuid4

    def slowly() -> uuid.UUID:
        time.sleep(0.05)
        return drawn()

    monkeypatch.setattr("pipeline.engine.result_cache.uuid.uuid4", slowly)

    def begin(_: int) -> str:
        together.wait()
        return ResultCache(tmp_path / "cache").mark

    with ThreadPoolExecutor(6) as pool:
        assert len(set(pool.map(begin, range(6)))) == 1


@pytest.mark.parametrize(("age", "stays"), [(50.0, True), (70.0, False)])
def test_a_file_of_a_worker_that_tests_the_folder_stays_for_a_minute(
    cache: ResultCache, age: float, stays: bool
) -> None:
    store_text(cache, "first")
    probe = cache.root / "building" / "test-of-the-folder"
    probe.touch()
    os.utime(probe, (time.time() - age,) * 2)
    cache.remove_leftovers()
    assert probe.exists() == stays
