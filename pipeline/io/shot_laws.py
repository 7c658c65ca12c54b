"""Published contact models of a whole shot: kept beside the saved shot, else fitted when an answer needs them."""

from __future__ import annotations

from pathlib import Path

from models.core.fit_result import WholeShotFit
from models.core.options import FitOptions
from models.core.shot import Shot
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
from pipeline.engine.result_cache import ResultCache
from pipeline.io.kept_values import find_kept_value, keep_value
from pipeline.io.shot_folder import hash_tracks


def load_laws(source: Path, shot: Shot, cache: ResultCache) -> WholeShotFit:
    """Find what published contact models make of a shot: kept by `run --laws` or by an answer, else fitted now.

    Args:
        source: Its run folder or track folder.
        shot: The shot.
        cache: Holds the models of track folders.

    Returns:
        The models, or why there are none.
    """
    code, facts = fit_shot_laws.__module__, {"content": hash_tracks(shot.tracks, shot.scene)}
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
    facts = {"content": hash_tracks(shot.tracks, shot.scene), "laws": True}
    keep_value(folder, cache, "laws", facts, WholeShotFit, fit_shot_laws.__module__, lambda: laws)
