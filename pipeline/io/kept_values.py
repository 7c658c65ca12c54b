"""What answers compute later from a saved shot: kept beside it by key, in a `ResultCache` of its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pipeline.engine.result_cache import CacheKey, ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions
from pipeline.engine.value_files import FORMAT, load_value, save_value
from pipeline.io.shot_folder import SHOT_FOLDER, has_shot

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
        facts: What the value depends on, such as the hash of the shot, as JSON values.
        kind: Type of the value.
        code: Module that computes it.
        build: Computes it.

    Returns:
        The value.
    """
    folder = _find_kept_folder(source)
    store = cache if folder is None else ResultCache(folder)
    entry = store.find_or_build(_build_key(name, facts, code), lambda place: save_value(build(), place))
    return load_value(kind, entry.folder)


def find_kept_value(
    source: Path, cache: ResultCache, name: str, facts: Mapping[str, Any], kind: type[V], code: str
) -> V | None:
    """Find what `keep_value` with the same arguments would return without computing it.

    Args:
        source: Run folder, track folder or tracks.csv that the value belongs to.
        cache: Holds the value where the source has no saved shot, or cannot be written.
        facts: What the value depends on, such as the hash of the shot, as JSON values.
        kind: Type of the value.
        code: Module that computes it.

    Returns:
        The value; None where it was not kept.
    """
    folder = _find_kept_folder(source)
    if folder is not None and not folder.is_dir():
        return None  # a look-up creates no folder
    entry = (cache if folder is None else ResultCache(folder)).find(_build_key(name, facts, code))
    return None if entry is None else load_value(kind, entry.folder)


def _find_kept_folder(source: Path | None) -> Path | None:
    """Find where values of a saved shot are kept; None where there is none, or where it cannot be written."""
    if source is None or not has_shot(source) or not os.access(source / SHOT_FOLDER, os.W_OK):
        return None
    return source / SHOT_FOLDER / KEPT_FOLDER


def _build_key(name: str, facts: Mapping[str, Any], code: str) -> CacheKey:
    """Build the key of a value."""
    return CacheKey(
        name, {"facts": dict(facts), "source": hash_sources(code), "libraries": library_versions(), "format": FORMAT}
    )
