"""Play a shot of a run folder otherwise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from models.core.errors import OptionError, TrackError
from models.core.fit_result import Fit
from models.core.joint_solution import JointSolution
from models.core.options import FitOptions
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.estimation.forecast.probability_regions import ensemble_outlyingness
from models.estimation.joint_fit.fit_solution import ClipMotion
from models.estimation.reconstruction.fit_shot import fit_with_solution
from models.estimation.shot_numbers.session_statistics import estimate_player_spread
from models.estimation.table_learning.learned_table import LearnedTable
from models.estimation.what_if.changed_shot import ChangedShot, play_changed_shot
from models.estimation.what_if.shot_outcome import ShotGoal, group_by_ball, is_scored
from models.estimation.what_if.stroke_change import PlayerSpread, StrokeChange
from models.estimation.what_if.struck_ensemble import StruckEnsemble, draw_struck_ensemble
from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
from pipeline.actions.compare_session import read_session
from pipeline.actions.fit_table import hash_shot
from pipeline.engine.atomic_write import replace_file
from pipeline.engine.cache_key import CacheKey
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions
from pipeline.engine.value_files import load_value, save_value
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.prediction_files import format_strict_json
from pipeline.io.session.what_if_files import summarize_changed_shot, write_changed_paths
from video.drawing.prediction_fan import PredictionFan, draw_changed_shot

MIN_PROBABILITY = 0.5
"""Probability from which an event of the real shot counts."""
STAGE = "struck-shot"
"""Name of the cached fits."""
SECONDS = 6.0
"""s after the strike whose paths are drawn and listed."""
STEP_S = 0.02
"""s between rows of what_if.csv."""
MAX_REPEATED_TURN = 5.0
"""Degrees of spread of the direction up to which the shots of a session are repetitions of one: no player who aims at
the same place scatters more."""


@dataclass(frozen=True, slots=True)
class StrokePlan:
    """What is changed, how the player scatters, and what counts."""

    change: StrokeChange
    spread: PlayerSpread
    spread_source: str
    """`user`, `session` or `none`."""
    goal: ShotGoal


def estimate_session_spread(sources: list[Path]) -> PlayerSpread:
    """Estimate the spread of a player from run folders in which one shot is repeated.

    Args:
        sources: Run folders or folders of run folders.

    Returns:
        Spread of speed and direction.

    Raises:
        OptionError: There are too few shots, or they are no repetitions.
    """
    shots, _ = read_session(sources)
    try:
        speed, angle = estimate_player_spread([shot for _, _, shot in shots])
    except ValueError as error:
        raise OptionError(f"--session needs repetitions of one shot: {error}") from error
    if angle > MAX_REPEATED_TURN:
        raise OptionError(
            f"--session needs repetitions of one shot; the directions of these {len(shots)} shots scatter by"
            f" {angle:.0f} degrees. Name the folders of one shot, or give --spread"
        )
    return PlayerSpread(speed, angle)


def fit_struck_shot(tracks: Tracks, scene: Scene, cache: ResultCache) -> tuple[Fit, JointSolution]:
    """Fit a clip and its whole shots, or read the cached fit.

    Args:
        tracks: Tracks of the clip.
        scene: Its table and camera.
        cache: Holds the fits.

    Returns:
        The fit and the joint solution.

    Raises:
        TrackError: Physics could not be fitted.
    """
    parts = {
        "content": hash_shot(tracks, scene),
        "source": {**hash_sources(fit_with_solution.__module__), **hash_sources(fit_shot_laws.__module__)},
        "libraries": library_versions(),
    }

    def build(folder: Path) -> None:
        fit, solution = fit_with_solution(tracks, scene)
        if solution is not None:
            fit = fit_shot_laws(fit, tracks, scene.table, FitOptions())
        save_value(ClipMotion(fit, solution), folder)

    one = load_value(ClipMotion, cache.find_or_build(CacheKey(STAGE, parts), build).folder)
    if one.solution is None:
        raise TrackError(f"physics could not be fitted; {one.fit.trust.reasons[0]}")
    return one.fit, one.solution


def play_otherwise(
    source: Path, stroke: int, plan: StrokePlan, learned: LearnedTable | None, draws: int, seed: int, folder: Path,
    cache: ResultCache, on_activity: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:  # fmt: skip
    """Play a shot otherwise, and write what_if.json, what_if.csv and what_if.png.

    Args:
        source: Run folder, track folder or tracks.csv.
        stroke: Number of the stroke in the clip, from 0.
        plan: What is changed, and what counts.
        learned: What other shots taught about the table.
        draws: Number of plays.
        seed: Random seed.
        folder: Folder of the results.
        cache: Holds the fit.
        on_activity: Called with what is done next.

    Returns:
        Content of what_if.json.

    Raises:
        OptionError: The source is no shot of billiards, or the goal does not suit it.
        TrackError: Physics could not be fitted, or there is no such stroke.
    """
    tracks, scene, _ = read_observed_shot(source)
    _require_possible_goal(plan.goal, tracks, scene)
    on_activity("fitting the shot, about half a minute unless it is cached")
    fit, solution = fit_struck_shot(tracks, scene, cache)
    on_activity(f"playing the shot {draws} times as it was struck, and {draws} times otherwise")
    ensemble = draw_struck_ensemble(fit, solution, tracks, scene.table, stroke, draws, seed, learned)
    t = np.arange(0.0, SECONDS + 1e-9, STEP_S)
    real = play_changed_shot(ensemble, StrokeChange(), plan.spread, plan.goal, t, seed)
    changed = play_changed_shot(ensemble, plan.change, plan.spread, plan.goal, t, seed)
    document = summarize_changed_shot(
        ensemble,
        plan.change,
        plan.spread,
        plan.spread_source,
        plan.goal,
        real,
        changed,
        _did_score(fit, ensemble, plan),
        (float(tracks.t[-1]), SECONDS),
    )
    folder.mkdir(parents=True, exist_ok=True)
    with replace_file(folder / "what_if.csv") as path:
        write_changed_paths(ensemble, changed, path)
    with replace_file(folder / "what_if.png") as path:
        Image.fromarray(_draw_plays(ensemble, changed, tracks)).save(path, format="PNG")
    with replace_file(folder / "what_if.json") as path:
        path.write_text(format_strict_json(document), encoding="utf-8")
    return document


def _require_possible_goal(goal: ShotGoal, tracks: Tracks, scene: Scene) -> None:
    if goal.game == "pot" and not scene.table.pockets:
        raise OptionError("--game pot needs a table with pockets; this one has none, so name carom or three-cushion")
    if goal.game != "pot" and len(tracks.ids) != 3:
        raise OptionError(f"--game {goal.game} needs three balls; this clip has {len(tracks.ids)}")
    if goal.ball and goal.ball not in tracks.ids:
        raise OptionError(f"--ball is one of {', '.join(tracks.ids)}; got {goal.ball}")


def _did_score(fit: Fit, ensemble: StruckEnsemble, plan: StrokePlan) -> bool:
    """Return whether the real shot scored, by its probable events."""
    events = fit.events
    contacts = [
        (float(events.t[k]), (events.kind[k], events.a[k], events.b[k]))
        for k in range(len(events))
        if events.probability[k] >= MIN_PROBABILITY and events.t[k] >= ensemble.t
    ]
    return is_scored(group_by_ball(contacts, ensemble.ids), ensemble.ids, ensemble.cue, plan.goal)


def _draw_plays(ensemble: StruckEnsemble, changed: ChangedShot, tracks: Tracks) -> np.ndarray:
    fans = []
    for k, name in enumerate(ensemble.ids):
        plays = changed.members[:, :, k]
        real = tracks.xy[tracks.t >= ensemble.t - 1e-9, tracks.ids.index(name)]
        fans.append(PredictionFan(name, real, plays, ensemble_outlyingness(plays), np.empty((0, 2))))
    title = (
        f"Thick lines: the shot played otherwise, until the balls rest or {SECONDS:g} s after the strike;"
        f" shaded: 50 and 90 % of {len(changed.members)} plays.\nThin lines: the real shot, until the clip ends."
    )
    return draw_changed_shot(ensemble.table, fans, title)
