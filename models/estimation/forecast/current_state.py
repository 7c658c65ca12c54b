"""State of a shot at a moment, from the explanation of everything observed until then."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.core.errors import TrackError
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.estimation.forecast.solution_state import (
    build_state_estimate,
    collect_captured_observations,
    estimate_lack_of_fit,
)
from models.estimation.forecast.state_estimate import StateEstimate
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.table_learning.learned_table import LearnedTable

MIN_FRAMES = 5
"""Least number of frames that give speeds."""


Explain = Callable[[Tracks, Scene], Shot]
"""A function that explains the frames until a moment."""


def estimate_state(
    tracks: Tracks, scene: Scene, t: float, learned: LearnedTable | None = None, explain_past: Explain = explain
) -> StateEstimate:
    """Estimate the state of a shot at a moment; only frames until then are fitted.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        t: Presentation time, s.
        learned: What other shots taught about the table.
        explain_past: Explains the frames until then, or finds an explanation that was kept.

    Returns:
        States of the balls on the table, with their covariance.

    Raises:
        TrackError: If there are too few frames, or physics cannot be fitted.
    """
    return estimate_states(tracks, scene, t, (learned,), explain_past)[0]


def estimate_states(
    tracks: Tracks, scene: Scene, t: float, tables: Sequence[LearnedTable | None], explain_past: Explain = explain
) -> tuple[StateEstimate, ...]:
    """Estimate the state as `estimate_state` for several tables, with one fit.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        t: Presentation time, s.
        tables: What other shots taught about the table, in several ways; None for nothing.
        explain_past: As in `estimate_state`.

    Returns:
        One state per table.

    Raises:
        TrackError: If there are too few frames, or physics cannot be fitted.
    """
    observed_tracks = tracks.truncate_after(t)
    if len(observed_tracks.t) < MIN_FRAMES:
        raise TrackError(
            f"{len(observed_tracks.t)} frames were detected until {t:g} s; a prediction needs at least {MIN_FRAMES}"
        )
    shot = explain_past(observed_tracks, scene)
    fit, solution = view_shot(shot), shot.solution
    if solution is None:
        raise TrackError(f"physics could not be fitted to the frames until {t:g} s; {fit.trust.reasons[0]}")
    clock = fit.trajectory.clock
    now = t if clock is None else float(clock.capture_time_at(np.array(t)))
    inflation = estimate_lack_of_fit(solution, collect_captured_observations(observed_tracks, clock, scene.table))
    events = fit.events
    pocketed = {a for a, kind in zip(events.a, events.kind, strict=True) if kind == "pocket"}
    states = (
        build_state_estimate(
            solution, observed_tracks.ids, now, scene.table, pocketed, fit.trust, inflation, learned
        )
        for learned in tables
    )  # fmt: skip
    return tuple(replace(state, t=t) for state in states)
