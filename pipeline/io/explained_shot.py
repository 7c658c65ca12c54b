"""The shot behind a run folder or a track folder: read where it is saved, else explained once and kept."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.fit_result import WholeShotFit
from models.core.options import FitOptions
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
from pipeline.engine.result_cache import ResultCache
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.run_folder import SOURCE_FILE
from pipeline.io.shot_folder import find_kept_value, has_shot, keep_value, read_shot


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
    facts = {"content": _hash_tracks(tracks, scene)}
    return keep_value(None, cache, "explain", facts, Shot, explain.__module__, lambda: explain(tracks, scene))


def load_laws(source: Path, shot: Shot, cache: ResultCache) -> WholeShotFit:
    """Find what published contact models make of a shot: kept by `run --laws` or by an answer, else fitted now.

    Args:
        source: Its run folder or track folder.
        shot: The shot.
        cache: Holds the models of track folders.

    Returns:
        The models, or why there are none.
    """
    code, facts = fit_shot_laws.__module__, {"content": _hash_tracks(shot.tracks, shot.scene)}
    complete = find_kept_value(source, cache, "laws", facts | {"laws": True}, WholeShotFit, code)
    if complete is not None:
        return complete

    def fit_laws() -> WholeShotFit:
        return fit_shot_laws(view_shot(shot), shot.tracks, shot.scene.table, FitOptions())

    return keep_value(source, cache, "laws", facts | {"laws": False}, WholeShotFit, code, fit_laws)


def keep_laws(folder: Path, shot: Shot, laws: WholeShotFit, cache: ResultCache) -> None:
    """Keep the contact models of `trueroll run --laws` beside the saved shot.

    Args:
        folder: The run folder.
        shot: Its shot.
        laws: The models.
        cache: Holds them where the folder cannot be written.
    """
    facts = {"content": _hash_tracks(shot.tracks, shot.scene), "laws": True}
    keep_value(folder, cache, "laws", facts, WholeShotFit, fit_shot_laws.__module__, lambda: laws)


def _hash_tracks(tracks: Tracks, scene: Scene) -> str:
    """Hash what the explanation of tracks depends on."""
    digest = hashlib.sha256(repr((tracks.ids, tracks.kinds, scene.table)).encode())
    positions = tracks.xy, tracks.sigma, tracks.sigma_along, tracks.streak
    for array in (tracks.frame, tracks.t, *positions, scene.camera.matrix):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
