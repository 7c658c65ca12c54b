"""Shots and what answers compute of them later: kept beside a saved shot by key, or in the cache."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from models.core.errors import OptionError
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from pipeline.engine.result_cache import CacheKey, ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions
from pipeline.engine.value_files import FORMAT, hash_value, load_value, save_value
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.run_folder import SOURCE_FILE
from pipeline.io.saved_shot import SHOT_FOLDER, has_shot, read_shot

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


def load_shot(source: Path, number: int | None, cache: ResultCache) -> Shot:
    """Read the saved shot of a run folder, or explain the tracks of a track folder.

    Args:
        source: A run folder, a track folder or a tracks.csv.
        number: Number of the shot; None for the first.
        cache: Holds the shots of track folders.

    Returns:
        The shot.

    Raises:
        OptionError: The source is no shot of billiards or cannot be read, or an earlier version wrote the run folder.
    """
    if has_shot(source) or (source / SOURCE_FILE).is_file():
        if number:
            raise OptionError(f"{source} is the folder of a run, with shot 0 alone; shot {number} is not among them")
        return read_shot(source)
    tracks, scene, _ = read_observed_shot(source, number)
    return explain_tracks(tracks, scene, cache)


def explain_tracks(tracks: Tracks, scene: Scene, cache: ResultCache) -> Shot:
    """Explain tracks without pixels, or read the kept explanation.

    Args:
        tracks: Tracks of the shot.
        scene: Its table and camera.
        cache: Holds the shots.

    Returns:
        The shot.
    """
    facts = {"tracks": hash_value(tracks), "scene": hash_value(scene)}
    return keep_value(None, cache, "explain", facts, Shot, explain.__module__, lambda: explain(tracks, scene))
