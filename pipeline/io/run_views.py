"""All views of the shot of a run, as its outputs show them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from models.core.fit_result import Fit, WholeShotFit
from models.core.shot import Shot
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.shot_numbers.measure_shots import measure_shots
from pipeline.io.view_profile import list_profile_misfits
from pipeline.reporting.text.run_trust import assess_run_trust

_KEPT_VIEWS = 4
"""Shots whose views are kept in memory: a command reads one, and compares it with few."""


@lru_cache(_KEPT_VIEWS)
def view_run(shot: Shot, laws: WholeShotFit | None = None, profile: str = "") -> Fit:
    """Evaluate the views of a shot with everything that a run adds.

    Args:
        shot: The shot.
        laws: What published contact models make of it, where somebody asked for them.
        profile: Content of the table profile, JSON; empty for none.

    Returns:
        The views, with numbers for players and the trust level of the run.
    """
    fit = replace(view_shot(shot), laws=laws)
    fit = replace(fit, profile_misfits=list_profile_misfits(profile, shot.scene.cloth_lab, fit.parameters))
    if shot.solution is not None:
        fit = replace(fit, shot_numbers=measure_shots(fit, shot.solution, shot.tracks, shot.scene.table))
    return replace(fit, trust=assess_run_trust(shot.notes, fit))
