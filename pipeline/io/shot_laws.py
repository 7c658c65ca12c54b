"""Published contact models of a whole shot: kept beside the saved shot, else fitted when an answer needs them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.core.fit_result import WholeShotFit
from models.core.options import FitOptions
from models.core.shot import Shot
from models.estimation.reconstruction.shot_views import view_captured
from models.estimation.whole_shot.known_table import TablePrior
from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.value_files import hash_value
from pipeline.io.kept_values import find_kept_value, keep_value

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
