"""Content-addressed entries of plain files: built aside, published by one rename, locked per key, checked when read.

ROOT/entries/ab/abcd.../          the files of an entry and its manifest.json
ROOT/building/                    entries that are being built; what a killed process leaves is pruned, told by its lock
ROOT/locks/abcd....lock           one per key
ROOT/latest/STAGE-CLIP.json       the parts of the last key, to say why a stage is stale
ROOT/mark                         by which this folder is told from another one in its place
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from models.core.errors import TruerollError
from pipeline.engine.atomic_write import aside, clear_left, folder_aside

MANIFEST = "manifest.json"
MARK = "mark"
LEFT_S = 60.0
"""s after which a lone file among what is built, by which workers try a folder, is no longer looked for."""
ROOMS = ("entries", "building", "locks", "latest")


@dataclass(frozen=True, slots=True)
class Key:
    """What an entry depends on, and the address that follows from it."""

    stage: str
    parts: Mapping[str, Any]
    """JSON-able: options, inputs (content hashes), source (hash per file), libraries."""

    @property
    def plain(self) -> dict[str, Any]:
        """The parts as they are remembered: a list where there was a tuple."""
        parts: dict[str, Any] = json.loads(json.dumps(self.parts))
        return parts

    @property
    def digest(self) -> str:
        text = json.dumps({"stage": self.stage, **self.parts}, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Entry:
    """A finished entry."""

    folder: Path
    key: str
    stage: str
    content: str
    """SHA-256 over the names and hashes of its files: equal results have equal content, whatever made them."""
    seconds: float
    """Time that it took to make."""
    size: int
    """bytes"""
    used: float
    """Last use, s since the epoch."""


class CacheLost(TruerollError):
    """The folder of the cache is gone, or another one stands in its place."""

    def __init__(self, root: Path) -> None:
        super().__init__(
            f"The cache {root} is gone, or another folder stands in its place; bring it back (a mount?) and run again"
        )


class Cache:
    """Entries below one root folder; safe for many processes on one file system.

    With a `mark` the folder must be there and bear it, and nothing is made in its place: CacheLost otherwise.
    """

    def __init__(self, root: Path, *, mark: str | None = None) -> None:
        self.root = root
        if mark is None:
            for name in ROOMS:
                (root / name).mkdir(parents=True, exist_ok=True)
            mark = _marked(root)
        self.mark = mark
        self._stand()

    def _stand(self) -> None:
        """Nothing is ever written to a folder that has taken this one's place, such as the bare mount point."""
        try:
            if (self.root / MARK).read_text(encoding="ascii") == self.mark:
                return
        except (OSError, ValueError) as error:
            raise CacheLost(self.root) from error
        raise CacheLost(self.root)

    def folder(self, key: str) -> Path:
        return self.root / "entries" / key[:2] / key

    def find(self, key: Key) -> Entry | None:
        """The entry of this key, or None where it is missing, torn or altered."""
        entry = _read_entry(self.folder(key.digest))
        if entry is not None:
            with suppress(OSError):  # it can be read and not written: only pruning asks for the time
                os.utime(entry.folder / MANIFEST)
        return entry

    def is_damaged(self, key: Key) -> bool:
        """Whether an entry is there that cannot be trusted."""
        folder = self.folder(key.digest)
        return folder.exists() and _read_entry(folder) is None

    def make(self, key: Key, build: Callable[[Path], None]) -> Entry:
        """The entry of this key, built by `build(folder)` unless another process has done it meanwhile."""
        self._stand()
        with FileLock(self._lock(key.digest)):
            entry = self.find(key)
            return entry if entry is not None else self._publish(key, build)

    def _publish(self, key: Key, build: Callable[[Path], None]) -> Entry:
        """With the lock of the key held: what lies in building/ for it was left by a process that was killed."""
        prefix, final = f"{key.stage}-{key.digest}-", self.folder(key.digest)
        for left in (self.root / "building").glob(f"{prefix}*"):
            shutil.rmtree(left, ignore_errors=True)
        with folder_aside(final, self.root / "building", prefix) as fresh:
            start = time.monotonic()
            build(fresh)
            _write_manifest(fresh, key, time.monotonic() - start)
        entry = _read_entry(final)
        if entry is None:
            raise OSError(f"the entry that was just written to {final} cannot be read back; is the disk full?")
        return entry

    def remember(self, key: Key, clip: str) -> None:
        """Note the parts of the key that a stage last had for a clip."""
        self._stand()
        with aside(self._latest(key.stage, clip)) as fresh:
            fresh.write_text(json.dumps(key.parts, sort_keys=True), encoding="utf-8")

    def recall(self, stage: str, clip: str) -> dict[str, Any] | None:
        """The parts that `remember` noted, None if never."""
        try:
            parts: dict[str, Any] = json.loads(self._latest(stage, clip).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return parts

    def _latest(self, stage: str, clip: str) -> Path:
        return self.root / "latest" / f"{stage}-{clip[:32]}.json"

    def entries(self) -> Iterator[Entry]:
        """All whole entries, the least recently used first."""
        found = [_read_entry(path.parent, check=False) for path in (self.root / "entries").glob(f"*/*/{MANIFEST}")]
        yield from sorted((entry for entry in found if entry is not None), key=lambda entry: (entry.used, entry.key))

    def prune(self, *, older_than_s: float | None = None, largest_bytes: int | None = None) -> list[Entry]:
        """Remove old entries, then the least recently used until the rest fits; also what dead processes left."""
        now = time.time()
        self.clear_rubbish()
        kept = list(self.entries())
        total = sum(entry.size for entry in kept)
        removed = []
        for entry in kept:
            old = older_than_s is not None and now - entry.used > older_than_s
            if old or (largest_bytes is not None and total > largest_bytes):
                self._remove(entry)
                removed.append(entry)
                total -= entry.size
        self._drop_unused_locks()
        return removed

    def clear_rubbish(self) -> None:
        """What dead processes left: a lock dies with its process, so that what nobody locks nobody builds."""
        clear_left(self.root / "building")
        for path in (self.root / "building").iterdir():
            with suppress(Timeout, FileNotFoundError), FileLock(self._lock(_key_of(path)), timeout=0):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                elif time.time() - path.stat().st_mtime > LEFT_S:
                    path.unlink()

    def _drop_unused_locks(self) -> None:
        """Lock files without an entry that nobody holds; whoever waits for one notices that it is gone."""
        for path in (self.root / "locks").glob("*.lock"):
            if not self.folder(path.stem).exists():
                with suppress(Timeout), FileLock(path, timeout=0):
                    path.unlink(missing_ok=True)

    def _lock(self, key: str) -> Path:
        return self.root / "locks" / f"{key}.lock"

    def _remove(self, entry: Entry) -> None:
        with FileLock(self._lock(entry.key)):
            shutil.rmtree(entry.folder, ignore_errors=True)


def _marked(root: Path) -> str:
    """The mark of a cache, made where there is none; of processes that come at once, the first one makes it for all."""
    mark = root / MARK
    if not mark.exists():
        with FileLock(root / "locks" / f"{MARK}.lock"):
            if not mark.exists():
                with aside(mark) as fresh:
                    fresh.write_text(uuid.uuid4().hex, encoding="ascii")
    return mark.read_text(encoding="ascii")


def _key_of(building: Path) -> str:
    """The key that a folder under building/ is for: STAGE-KEY-CHANCE."""
    return building.name.rpartition("-")[0].rpartition("-")[2] or building.name


def _write_manifest(folder: Path, key: Key, seconds: float) -> None:
    files = {
        str(path.relative_to(folder)): {"sha256": _file_hash(path), "size": path.stat().st_size}
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    document = {"stage": key.stage, "key": key.digest, "parts": dict(key.parts), "seconds": seconds, "files": files}
    (folder / MANIFEST).write_text(json.dumps(document, indent=1), encoding="utf-8")


def _read_entry(folder: Path, *, check: bool = True) -> Entry | None:
    """The entry in `folder`; None where a file is missing, torn or altered."""
    try:
        document = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        used = (folder / MANIFEST).stat().st_mtime
        files: dict[str, dict[str, Any]] = document["files"]
        if document["key"] != folder.name:
            return None
        for name, facts in files.items():
            if _size_within(folder, name) != facts["size"] or (check and _file_hash(folder / name) != facts["sha256"]):
                return None
        content = hashlib.sha256(json.dumps({n: f["sha256"] for n, f in files.items()}, sort_keys=True).encode())
        size = sum(int(facts["size"]) for facts in files.values())
        return Entry(folder, document["key"], document["stage"], content.hexdigest(), document["seconds"], size, used)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _size_within(folder: Path, name: str) -> int | None:
    """bytes of an ordinary file of the entry, None of anything else: a manifest that others wrote may name a device, or
    a file of the user's by way of a link, of dots or of the root."""
    place, size = str(folder), None
    for part in Path(name).parts:
        place = f"{place}/{part}"
        facts = os.lstat(place)
        if part == ".." or part.startswith("/") or stat.S_ISLNK(facts.st_mode):
            return None
        size = facts.st_size if stat.S_ISREG(facts.st_mode) else None
    return size


def _file_hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def default_root() -> Path:
    """$TRUEROLL_CACHE, else trueroll below the user's cache folder."""
    named = os.environ.get("TRUEROLL_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trueroll"
