"""The cache of results: entries of plain files, published by one rename, locked per key, checked when they are read.

ROOT/entries/ab/abcd.../          the files of an entry and its manifest.json
ROOT/building/                    entries that are being built; a free lock shows that a process was killed
ROOT/locks/abcd....lock           one per key
ROOT/latest/STAGE-CLIP.json       the parts of the last key, from which `trueroll graph` derives why a stage is stale
ROOT/mark                         identifies this folder, should another one be mounted in its place
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

from models.core.errors import OptionError, TruerollError
from pipeline.engine.atomic_write import remove_leftovers, replace_file, replace_folder, write_text
from pipeline.engine.source_fingerprint import library_versions
from pipeline.engine.stage import Stage

# Environment variable that names the folder of the cache.
CACHE_VARIABLE = "TRUEROLL_CACHE"


@dataclass(frozen=True, slots=True)
class CacheKey:
    """What an entry depends on. Its digest is the address of the entry."""

    stage: str
    parts: Mapping[str, Any]
    """JSON-able: options, inputs (content hashes), source (hash per file), libraries."""

    @property
    def json_parts(self) -> dict[str, Any]:
        """The parts as read back from JSON: tuples have become lists."""
        parts: dict[str, Any] = json.loads(json.dumps(self.parts))
        return parts

    @property
    def digest(self) -> str:
        """SHA-256 of the stage name and all parts."""
        text = json.dumps({"stage": self.stage, **self.parts}, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def build_stage_key(stage: Stage, contents: Mapping[str, str], source: Mapping[str, str]) -> CacheKey:
    """Build the cache key of a stage.

    Args:
        contents: Content hashes of its inputs (`CacheEntry.content`) by stage name.
        source: Hashes of the files of code behind it, by path.

    Returns:
        The key.
    """
    from pipeline.engine.value_files import FORMAT  # imports numpy, for which `trueroll --help` need not wait

    parts = {
        "options": stage.json_options,
        "facts": dict(stage.facts),
        "inputs": {name: contents[name] for name in sorted(stage.needs)},
        "source": dict(source),
        "libraries": library_versions(),
        "format": FORMAT,
    }
    return CacheKey(stage.name, parts)


MANIFEST = "manifest.json"
MARK = "mark"
# Age after which a file in building/, written by a worker to test the folder, is removed, s.
PROBE_AGE_S = 60.0
SUBFOLDERS = ("entries", "building", "locks", "latest")


@dataclass(frozen=True, slots=True)
class CacheEntry:
    """A finished entry of the cache."""

    folder: Path
    key: str
    stage: str
    content: str
    """SHA-256 over the names and hashes of its files: equal results have equal content, whatever their key."""
    seconds: float
    """Time that the stage took, s."""
    size: int
    """Size of all files, bytes."""
    used: float
    """Last use, s since the epoch."""


class CacheMissing(TruerollError):
    """The folder of the cache is gone, or another folder is in its place."""

    def __init__(self, root: Path) -> None:
        super().__init__(
            f"The cache {root} is gone, or another folder is in its place; bring it back (a mount?) and run again"
        )


class ResultCache:
    """Entries below one root folder; safe for many processes on one file system.

    With a `mark`, the folder must exist and have this mark, and no folder is created in its place; otherwise
    CacheMissing is raised.
    """

    def __init__(self, root: Path, *, mark: str | None = None) -> None:
        self.root = root
        if mark is None:
            for name in SUBFOLDERS:
                (root / name).mkdir(parents=True, exist_ok=True)
            mark = _read_or_create_mark(root)
        self.mark = mark
        self._require_mark()

    def _require_mark(self) -> None:
        """Raise CacheMissing if another folder, such as a bare mount point, has taken the place of this one."""
        mark = None
        with suppress(OSError, ValueError):
            mark = (self.root / MARK).read_text(encoding="ascii")
        if mark != self.mark:
            raise CacheMissing(self.root)

    def entry_folder(self, key: str) -> Path:
        """Return the folder of the entry with this digest, whether it exists or not."""
        return self.root / "entries" / key[:2] / key

    def find(self, key: CacheKey) -> CacheEntry | None:
        """Find the entry of a key and note its use; None where it is missing, incomplete or altered."""
        entry = _read_entry(self.entry_folder(key.digest))
        if entry is not None:
            with suppress(OSError):  # the cache may be read-only; only pruning uses this time
                os.utime(entry.folder / MANIFEST)
        return entry

    def is_damaged(self, key: CacheKey) -> bool:
        """Whether an entry of this key exists but is incomplete or altered."""
        folder = self.entry_folder(key.digest)
        return folder.exists() and _read_entry(folder) is None

    def find_or_build(self, key: CacheKey, build: Callable[[Path], None]) -> CacheEntry:
        """Find the entry of a key, or build it unless another process does so first.

        Args:
            key: Key of the entry.
            build: Writes the files of the entry into the folder that it is given.

        Returns:
            The finished entry.

        Raises:
            CacheMissing: The folder of the cache is gone.
            OSError: The entry cannot be written, or cannot be read back.
        """
        self._require_mark()
        with FileLock(self._lock_file(key.digest)):
            entry = self.find(key)
            return entry if entry is not None else self._build_entry(key, build)

    def _build_entry(self, key: CacheKey, build: Callable[[Path], None]) -> CacheEntry:
        """Build an entry while holding the lock of its key.

        What building/ holds for this key was left by a process that was killed.
        """
        prefix, final = f"{key.stage}-{key.digest}-", self.entry_folder(key.digest)
        for left in (self.root / "building").glob(f"{prefix}*"):
            shutil.rmtree(left, ignore_errors=True)
        with replace_folder(final, self.root / "building", prefix) as fresh:
            start = time.monotonic()
            build(fresh)
            _write_manifest(fresh, key, time.monotonic() - start)
        entry = _read_entry(final)
        if entry is None:
            raise OSError(f"the entry that was just written to {final} cannot be read back; is the disk full?")
        return entry

    def remember(self, key: CacheKey, clip: str) -> None:
        """Store the parts of the latest key of a stage for a clip."""
        self._require_mark()
        write_text(self._latest_file(key.stage, clip), json.dumps(key.parts, sort_keys=True))

    def recall(self, stage: str, clip: str) -> dict[str, Any] | None:
        """Return the parts that `remember` stored; None if there are none."""
        try:
            parts: dict[str, Any] = json.loads(self._latest_file(stage, clip).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return parts

    def _latest_file(self, stage: str, clip: str) -> Path:
        return self.root / "latest" / f"{stage}-{clip[:32]}.json"

    def entries(self) -> Iterator[CacheEntry]:
        """Yield all complete entries, the least recently used first, without checking their hashes."""
        folders = (path.parent for path in (self.root / "entries").glob(f"*/*/{MANIFEST}"))
        complete = [entry for folder in folders if (entry := _read_entry(folder, check=False)) is not None]
        yield from sorted(complete, key=lambda entry: (entry.used, entry.key))

    def prune(self, *, older_than_s: float | None = None, largest_bytes: int | None = None) -> list[CacheEntry]:
        """Remove old entries, then the least recently used ones until the rest fits, and leftovers of killed processes.

        Args:
            older_than_s: Remove entries whose last use is longer ago, s; None keeps all ages.
            largest_bytes: Largest total size to keep, bytes; None keeps all sizes.

        Returns:
            The removed entries.
        """
        now = time.time()
        self.remove_leftovers()
        entries = list(self.entries())
        total = sum(entry.size for entry in entries)
        removed = []
        for entry in entries:
            old = older_than_s is not None and now - entry.used > older_than_s
            if old or (largest_bytes is not None and total > largest_bytes):
                with FileLock(self._lock_file(entry.key)):
                    shutil.rmtree(entry.folder, ignore_errors=True)
                removed.append(entry)
                total -= entry.size
        for path in (self.root / "locks").glob("*.lock"):  # filelock notices if another process waits for one of them
            if not self.entry_folder(path.stem).exists():
                with suppress(Timeout), FileLock(path, timeout=0):
                    path.unlink(missing_ok=True)
        return removed

    def remove_leftovers(self) -> None:
        """Remove what killed processes left: a lock ends with its process, so nobody builds where the lock is free."""
        remove_leftovers(self.root / "building")
        for path in (self.root / "building").iterdir():
            key = path.name.rpartition("-")[0].rpartition("-")[2] or path.name  # of STAGE-KEY-RANDOM
            with suppress(Timeout, FileNotFoundError), FileLock(self._lock_file(key), timeout=0):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                elif time.time() - path.stat().st_mtime > PROBE_AGE_S:
                    path.unlink()

    def _lock_file(self, key: str) -> Path:
        return self.root / "locks" / f"{key}.lock"


def _read_or_create_mark(root: Path) -> str:
    """Read the mark of a cache; create it first if there is none, once for all processes that start together."""
    mark = root / MARK
    if not mark.exists():
        with FileLock(root / "locks" / f"{MARK}.lock"):
            if not mark.exists():
                with replace_file(mark) as fresh:
                    fresh.write_text(uuid.uuid4().hex, encoding="ascii")
    return mark.read_text(encoding="ascii")


def _write_manifest(folder: Path, key: CacheKey, seconds: float) -> None:
    """Write the manifest: key, time and the hash and size of every file."""
    files = {
        str(path.relative_to(folder)): {"sha256": _hash_file_content(path), "size": path.stat().st_size}
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    document = {"stage": key.stage, "key": key.digest, "parts": dict(key.parts), "seconds": seconds, "files": files}
    (folder / MANIFEST).write_text(json.dumps(document, indent=1), encoding="utf-8")


def _read_entry(folder: Path, *, check: bool = True) -> CacheEntry | None:
    """Read the entry in `folder`; None where a file is missing, incomplete or altered."""
    try:
        document = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        used = (folder / MANIFEST).stat().st_mtime
        files: dict[str, dict[str, Any]] = document["files"]
        is_whole = document["key"] == folder.name and all(
            _size_within(folder, name) == facts["size"]
            and not (check and _hash_file_content(folder / name) != facts["sha256"])
            for name, facts in files.items()
        )
        if not is_whole:
            return None
        content = hashlib.sha256(json.dumps({n: f["sha256"] for n, f in files.items()}, sort_keys=True).encode())
        size = sum(int(facts["size"]) for facts in files.values())
        key, stage, seconds = (document[name] for name in ("key", "stage", "seconds"))
        return CacheEntry(folder, key, stage, content.hexdigest(), seconds, size, used)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _size_within(folder: Path, name: str) -> int | None:
    """Return the size of a regular file within an entry, bytes; None of anything else.

    A manifest that others wrote may name a device, or a file outside the entry by a link, by dots or by the root.
    """
    place, size = str(folder), None
    for part in Path(name).parts:
        place = f"{place}/{part}"
        facts = os.lstat(place)
        if part == ".." or part.startswith("/") or stat.S_ISLNK(facts.st_mode):
            return None
        size = facts.st_size if stat.S_ISREG(facts.st_mode) else None
    return size


def _hash_file_content(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def default_cache_root() -> Path:
    """Return the default folder of the cache.

    Returns:
        $TRUEROLL_CACHE, else `trueroll` in $XDG_CACHE_HOME or ~/.cache.
    """
    if folder := os.environ.get(CACHE_VARIABLE):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trueroll"


def open_cache(folder: str | os.PathLike[str] | None) -> ResultCache:
    """Open the cache of a command.

    Args:
        folder: Folder of the cache; None for the default.

    Returns:
        The cache.

    Raises:
        OptionError: The folder cannot be written.
    """
    root = Path(folder) if folder is not None else default_cache_root()
    try:
        return ResultCache(root)
    except OSError as error:
        raise OptionError(f"The cache needs a folder that can be written; {root}: {error.strerror}") from error
