"""What answers compute later from a saved shot: kept beside it by key, in a `ResultCache` of its own."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pipeline.engine.cache_key import CacheKey
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions
from pipeline.engine.value_files import load_value, save_value
from pipeline.io.shot_folder import SHOT_FILE, SHOT_FOLDER, has_shot

KEPT_FOLDER = "kept"
V = TypeVar("V")


def keep_value(
    source: Path | None, cache: ResultCache, name: str, facts: Mapping[str, Any], kind: type[V], code: str,
    build: Callable[[], V],
) -> V:  # fmt: skip
    """Return what an answer needs: kept beside the saved shot or in the cache, else computed and kept now.

    Two processes that keep values in one folder do not disturb each other.

    Args:
        source: Run folder or track folder that the value belongs to; None for neither.
        cache: Holds the value where the source has no saved shot, or cannot be written.
        name: Name of the value.
        facts: What the value depends on beside the saved shot, as JSON values.
        kind: Type of the value.
        code: Module that computes it.
        build: Computes it.

    Returns:
        The value.
    """
    store, key = _address_value(source, cache, name, facts, code)
    entry = store.find_or_build(key, lambda folder: save_value(build(), folder))
    return load_value(kind, entry.folder)


def find_kept_value(
    source: Path, cache: ResultCache, name: str, facts: Mapping[str, Any], kind: type[V], code: str
) -> V | None:
    """Find what `keep_value` with the same arguments would return without computing it.

    Args:
        source: Run folder, track folder or tracks.csv that the value belongs to.
        cache: Holds the value where the source has no saved shot, or cannot be written.
        name: Name of the value.
        facts: What the value depends on beside the saved shot, as JSON values.
        kind: Type of the value.
        code: Module that computes it.

    Returns:
        The value; None where it was not kept.
    """
    store, key = _address_value(source, cache, name, facts, code)
    entry = store.find(key)
    return None if entry is None else load_value(kind, entry.folder)


def _address_value(
    source: Path | None, cache: ResultCache, name: str, facts: Mapping[str, Any], code: str
) -> tuple[ResultCache, CacheKey]:
    """Return where a value is kept, and under which key."""
    parts: dict[str, Any] = {"facts": dict(facts), "source": hash_sources(code), "libraries": library_versions()}
    if source is None or not has_shot(source):
        return cache, CacheKey(name, parts)
    folder = source / SHOT_FOLDER
    parts["shot"] = hashlib.sha256((folder / SHOT_FILE).read_bytes()).hexdigest()
    store = ResultCache(folder / KEPT_FOLDER) if os.access(folder, os.W_OK) else cache
    return store, CacheKey(name, parts)
