"""Shots and what answers compute of them later: kept beside a saved shot by key, or in the cache, else computed now."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from models.core.errors import OptionError
from models.core.fit_result import WholeShotFit
from models.core.options import FitOptions
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_captured
from models.estimation.whole_shot.known_table import TablePrior
from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
from pipeline.engine.result_cache import CacheKey, ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions
from pipeline.engine.value_files import FORMAT, hash_value, load_value, save_value
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.run_folder import SOURCE_FILE
from pipeline.io.shot_folder import SHOT_FOLDER, has_shot, read_shot

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


_CODE = fit_shot_laws.__module__


def load_laws(source: Path, shot: Shot, cache: ResultCache, on_fit: Callable[[], None] = lambda: None) -> WholeShotFit:
    """Find what published contact models make of a shot: kept by `run --laws` or by an answer, else fitted now.

    Args:
        source: Its run folder or track folder.
        cache: Holds the models of track folders.
        on_fit: Called before a fit, which takes up to a minute.

    Returns:
        The models, or why there are none.
    """

    def fit() -> WholeShotFit:
        on_fit()
        return fit_laws(shot, FitOptions(laws=True))

    return keep_value(source, cache, "laws", _list_facts(shot), WholeShotFit, _CODE, fit)


def fit_laws(shot: Shot, options: FitOptions, prior: TablePrior | None = None) -> WholeShotFit:
    """Fit published contact models to whole shots, at the capture times of the frames.

    Args:
        options: Options of the fit.
        prior: Physics of the table, where it is known.

    Returns:
        The models, or why there are none, at presentation times.
    """
    laws = fit_shot_laws(view_captured(shot), shot.capture_tracks, shot.scene.table, options, prior)
    if shot.clock.is_identity:
        return laws
    solution, misfit = laws.solution, laws.misfit
    if solution is not None:
        solution = replace(solution, t=_show_time(shot, solution.t))
    if misfit is not None:
        until = _show_time(shot, misfit.explained_until)
        misfit = replace(misfit, t=_show_time(shot, misfit.t), explained_until=until)
    return replace(laws, solution=solution, misfit=misfit)


def _show_time(shot: Shot, t: float) -> float:
    """Convert a capture time to a presentation time, s."""
    return float(shot.clock.presentation_time_at(np.array(t)))


def find_laws(source: Path, shot: Shot, cache: ResultCache) -> WholeShotFit | None:
    """Find the contact models that `trueroll run --laws` or an answer kept.

    Args:
        source: Its run folder.
        cache: Holds the models where the folder cannot be written.

    Returns:
        The models, or why there are none; None if nobody asked.
    """
    return find_kept_value(source, cache, "laws", _list_facts(shot), WholeShotFit, _CODE)


def keep_laws(folder: Path, shot: Shot, laws: WholeShotFit, cache: ResultCache) -> None:
    """Keep the contact models of `trueroll run --laws` beside the saved shot.

    Args:
        folder: The run folder.
        shot: Its shot.
        laws: The models.
        cache: Holds them where the folder cannot be written.
    """
    keep_value(folder, cache, "laws", _list_facts(shot), WholeShotFit, _CODE, lambda: laws)


def _list_facts(shot: Shot) -> dict[str, object]:
    """List what contact models depend on."""
    return {"shot": hash_value(shot)}
