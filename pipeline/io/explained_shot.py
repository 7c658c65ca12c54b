"""The shot behind a run folder or a track folder: read where it is saved, else explained once and kept."""

from __future__ import annotations

from pathlib import Path

from models.core.errors import OptionError
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.value_files import hash_value
from pipeline.io.kept_values import keep_value
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.run_folder import SOURCE_FILE
from pipeline.io.shot_folder import has_shot, read_shot


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
