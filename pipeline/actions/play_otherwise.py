"""Play a shot of a run folder otherwise, and write what_if.json, what_if.csv and the drawing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from models.core.answer import Answer, Quantity
from models.core.errors import NO_STROKE, OptionError, TrackError
from models.core.events import Events
from models.core.fit_result import Fit, ShotNumbers, WholeShotFit
from models.core.shot import Shot
from models.core.typing import FloatArray
from models.estimation.changed_shot import (
    GAMES,
    ChangedShot,
    Game,
    PlayerSpread,
    ShotGoal,
    StrokeChange,
    StruckEnsemble,
    draw_struck_ensemble,
    group_by_ball,
    is_scored,
    measure_stroke,
    play_changed_shot,
)
from models.estimation.forecast.ensemble_prediction import QUANTILES, compute_quantiles
from models.estimation.shot_numbers.session_statistics import estimate_player_spread
from models.estimation.table_learning.learned_table import LearnedTable
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.engine.result_cache import ResultCache
from pipeline.io.csv_tables import Columns, write_columns
from pipeline.io.image_file import write_image
from pipeline.io.kept_values import load_shot
from pipeline.io.run_views import view_run
from pipeline.io.shot_laws import load_laws
from pipeline.io.strict_json import write_json
from pipeline.reporting.text.number_sentences import format_what_if, format_what_if_question
from video.drawing.prediction_fan import PredictionFan, draw_prediction_fans

# Probability from which an event of the real shot counts.
MIN_PROBABILITY = 0.5
# s after the strike that every play lasts at least: most balls rest by then. A longer film is played to its end, so
# that the plays can score whatever it shows.
SECONDS = 6.0
# Plays of a stroke by default: a chance is known to 2.5 %.
PLAYS = 400
# s between rows of what_if.csv.
STEP_S = 0.02
# Degrees of spread of the direction up to which the shots of a session are repetitions of one: no player who aims at
# the same place scatters more.
MAX_REPEATED_TURN = 5.0


@dataclass(frozen=True, slots=True)
class StrokePlan:
    """What is changed, how the player scatters, and what counts."""

    change: StrokeChange
    spread: PlayerSpread
    spread_source: str
    """`user`, `session` or `none`."""
    game: Game | None = None
    """What scores; None: pot on a table with pockets, else carom."""
    ball: str = ""
    pocket: str = ""
    """The only ball and the only pocket that count, by id or name; empty: any."""

    def __post_init__(self) -> None:
        if self.game not in (None, *GAMES):
            raise OptionError(f"is one of {', '.join(GAMES)}; got {self.game}", option="game")


def estimate_session_spread(sources: Sequence[Path]) -> PlayerSpread:
    """Estimate the spread of a player from run folders in which one shot is repeated.

    Args:
        sources: Run folders or folders of run folders.

    Returns:
        Spread of speed and direction.

    Raises:
        OptionError: There are too few shots, or they are no repetitions.
    """
    from pipeline.actions.compare_session import read_session  # slow to import

    shots, _ = read_session(sources)
    try:
        speed, angle = estimate_player_spread([one.shot for one in shots])
    except ValueError as error:
        raise OptionError(f"--session needs repetitions of one shot: {error}") from error
    if angle > MAX_REPEATED_TURN:
        raise OptionError(
            f"--session needs repetitions of one shot; the directions of these {len(shots)} shots scatter by"
            f" {angle:.0f} degrees. Name the folders of one shot, or give --spread"
        )
    return PlayerSpread(speed, angle)


@dataclass(frozen=True, slots=True, eq=False)
class StruckShot:
    """One stroke of a shot with its ensemble, ready to be played otherwise; equal only to itself, as a key."""

    shot: Shot
    fit: Fit
    stroke: int
    """Its number in the clip, from 0."""
    ensemble: StruckEnsemble

    @property
    def times(self) -> FloatArray:
        """(T,) s after the strike of which a play is kept."""
        return list_play_times(float(self.shot.tracks.t[-1]) - self.ensemble.t)


@dataclass(frozen=True, slots=True)
class PlayedShot:
    """A shot that was played otherwise."""

    struck: StruckShot
    changed: ChangedShot
    answer: Answer

    def draw_fans(self) -> list[PredictionFan]:
        """Return the fan of every ball over its observed path since the strike."""
        ensemble, tracks = self.struck.ensemble, self.struck.shot.tracks
        since = tracks.t >= ensemble.t - 1e-9
        return [
            PredictionFan(
                name, tracks.xy[since, tracks.ids.index(name)], self.changed.members[:, :, k], np.empty((0, 2))
            )
            for k, name in enumerate(ensemble.ids)
        ]


def play_otherwise(
    source: Path, stroke: int, plan: StrokePlan, learned: LearnedTable | None, draws: int, seed: int, folder: Path,
    cache: ResultCache, on_activity: Callable[[str], None] = lambda _: None,
) -> Answer:  # fmt: skip
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
        The answer.

    Raises:
        OptionError: The source is no shot of billiards, or the goal does not suit it.
        TrackError: Physics could not be fitted, or there is no such stroke.
    """
    on_activity("reading the shot")
    shot = load_shot(source, None, cache)
    find_goal(plan, shot)
    laws = None
    if learned is None and shot.solution is not None and view_run(shot).moving.any():
        words = "finding the contact models that explain the whole shot, once for each shot, up to a minute"
        laws = load_laws(source, shot, cache, lambda: on_activity(words))
    on_activity(f"playing the shot {draws} times as it was struck, and {draws} times otherwise")
    played = play_struck_shot(draw_struck_shot(shot, laws, stroke, learned, draws, seed), plan, seed)
    require_writable_folder(folder)
    write_changed_paths(played.struck.ensemble, played.changed, folder / "what_if.csv")
    write_image(_draw_plays(played), folder / "what_if.png")
    write_json(played.answer.document, folder / "what_if.json")
    document = {"folder": str(folder), **played.answer.document}
    return replace(played.answer, document=document, figures=(str(folder / "what_if.png"),))


def draw_struck_shot(
    shot: Shot, laws: WholeShotFit | None, stroke: int, learned: LearnedTable | None, draws: int, seed: int
) -> StruckShot:
    """Draw the ensemble of a stroke.

    Args:
        laws: What published contact models make of the shot; None where they are not known.
        stroke: Number of the stroke in the clip, from 0.
        learned: What other shots taught about the table.
        draws: Number of plays.
        seed: Random seed.

    Returns:
        The stroke.

    Raises:
        TrackError: Physics could not be fitted, or there is no such stroke.
    """
    fit = view_run(shot, laws)
    if shot.solution is None:
        raise TrackError(f"physics could not be fitted; {fit.trust.reasons[0]}")
    if not fit.moving.any():
        raise TrackError(NO_STROKE)
    ensemble = draw_struck_ensemble(fit, shot.solution, shot.tracks, shot.scene.table, stroke, draws, seed, learned)
    return StruckShot(shot, fit, stroke, ensemble)


def play_struck_shot(struck: StruckShot, plan: StrokePlan, seed: int) -> PlayedShot:
    """Play a stroke as it was struck, and otherwise.

    Args:
        plan: What is changed, and what counts.
        seed: Random seed of the player's strokes.

    Raises:
        OptionError: The goal does not suit the shot.
    """
    ensemble, naming, t = struck.ensemble, struck.fit.naming, struck.times
    goal = find_goal(plan, struck.shot)
    real = _play_as_struck(struck, plan.spread, goal, seed)
    changed = play_changed_shot(ensemble, plan.change, plan.spread, goal, t, seed)
    document = summarize_changed_shot(
        ensemble, plan.change, plan.spread, plan.spread_source, goal, real, changed, struck.fit.events,
        (float(struck.shot.tracks.t[-1]), float(t[-1])), struck.fit.shot_numbers[struck.stroke : struck.stroke + 2],
    )  # fmt: skip
    quantities = tuple(
        Quantity(name, play.probability, play.probability_sigma)
        for name, play in (("chance as struck", real), ("chance otherwise", changed))
    )
    question, sentences = format_what_if_question(document, naming), format_what_if(document, naming)
    return PlayedShot(struck, changed, Answer(question, sentences, quantities=quantities, document=document))


@lru_cache(4)
def _play_as_struck(struck: StruckShot, spread: PlayerSpread, goal: ShotGoal, seed: int) -> ChangedShot:
    """Play a stroke as it was struck; kept, because a page asks for many changes of one stroke."""
    return play_changed_shot(struck.ensemble, StrokeChange(), spread, goal, struck.times, seed)


def list_play_times(filmed: float) -> FloatArray:
    """List the times (T,) s after the strike of which a play is kept, for a film that ends so many seconds after it."""
    return STEP_S * np.arange(np.ceil(max(SECONDS, filmed) / STEP_S) + 1)


def find_goal(plan: StrokePlan, shot: Shot) -> ShotGoal:
    """Find what must happen to score; raises OptionError for what cannot happen on this table."""
    tracks, scene, naming = shot.tracks, shot.scene, shot.naming
    game = plan.game or ("pot" if scene.table.pockets else "carom")
    ball, pocket = naming.find_ball(plan.ball), naming.find_pocket(plan.pocket)
    if game == "pot" and not scene.table.pockets:
        raise OptionError("pot needs a table with pockets; this one has none, so name carom or three-cushion",
                          option="game")  # fmt: skip
    if game != "pot" and len(tracks.ids) != 3:
        raise OptionError(f"{game} needs three balls; this clip has {len(tracks.ids)}", option="game")
    if plan.ball and ball is None:
        raise OptionError(f"is one of {naming.list_balls()}; got {plan.ball}", option="ball")
    if plan.pocket and pocket is None:
        raise OptionError(f"is one of {', '.join(naming.view.pockets)}; got {plan.pocket}", option="pocket")
    return ShotGoal(game, ball or "", pocket or "")


def _did_score(events: Sequence[dict[str, Any]], ensemble: StruckEnsemble, goal: ShotGoal) -> bool:
    """Return whether the real shot scored, by its probable events."""
    contacts = [
        (one["t"], (one["kind"], one["a"], one["b"])) for one in events if one["probability"] >= MIN_PROBABILITY
    ]
    return is_scored(group_by_ball(contacts, ensemble.ids), ensemble.ids, ensemble.cue, goal)


def _draw_plays(played: PlayedShot) -> np.ndarray:
    changed = played.changed
    title = (
        f"Thick lines: the shot played otherwise, until the balls rest or {changed.t[-1]:.1f} s after the strike; the"
        f" stronger the shade, the more of {len(changed.members)} plays pass there.\n"
        "Thin lines: the real shot, until the clip ends."
    )
    table, naming = played.struck.ensemble.table, played.struck.fit.naming
    return draw_prediction_fans(table, naming, played.draw_fans(), title, is_played_otherwise=True)


SCHEMA = "trueroll.what-if/1"
# Numbers of the shot that describe its stroke.
STROKE_NUMBERS = {"speed": "cue_speed", "side": "side_spin_share", "top": "top_spin_share"}


def summarize_changed_shot(
    ensemble: StruckEnsemble, change: StrokeChange, spread: PlayerSpread, spread_source: str, goal: ShotGoal,
    real: ChangedShot, changed: ChangedShot, events: Events, ends: tuple[float, float], strokes: Sequence[ShotNumbers],
) -> dict[str, Any]:  # fmt: skip
    """Build the content of what_if.json.

    Args:
        ensemble: The shot at its strike.
        change: How the stroke differs from the real one.
        spread: Scatter of the player's strokes.
        spread_source: `user`, `session` or `none`.
        goal: What must happen to score.
        real: The shot as it was struck, played again.
        changed: The shot with the change.
        events: What happened in the film.
        ends: s of the clip at which it ends, and s after the strike at which the drawn plays end at the latest.
        strokes: What the run states of the stroke, and of the next one if there is one.

    Returns:
        A tree of JSON values with the schema `trueroll.what-if/1`. The events of the real shot are those of the film;
        those of a shot in which nothing is changed are the same ones.
    """
    stroke = _describe_stroke(ensemble, strokes[0])
    filmed = _list_filmed_events(events, ensemble, strokes[1].t if len(strokes) > 1 else np.inf)
    chances = [{"probability": one.probability, "probability_sigma": one.probability_sigma} for one in (real, changed)]
    played = filmed if change == StrokeChange() else _list_played_events(ensemble, changed)
    return {
        "schema": SCHEMA,
        "t": ensemble.t,
        "cue": ensemble.ids[ensemble.cue],
        "draws": len(ensemble.members),
        "model": "whole_shot" if ensemble.is_whole_shot else "segments",
        "change": asdict(change),
        "stroke": {"real": stroke, "changed": _describe_changed_stroke(stroke, change)},
        "clip_end": ends[0],
        "play_end": ensemble.t + ends[1],
        "spread": {"speed": spread.speed, "angle_deg": spread.angle, "source": spread_source},
        "goal": asdict(goal),
        "real": {"scored": _did_score(filmed, ensemble, goal), **chances[0], "events": filmed},
        "changed": {**chances[1], "events": played},
    }


def write_changed_paths(ensemble: StruckEnsemble, changed: ChangedShot, path: Path) -> None:
    """Write what_if.csv: quantiles of the places of every ball over time.

    Args:
        ensemble: The shot at its strike.
        changed: The shot with the change.
        path: File to write; s of the clip, m.
    """
    on_table = np.isfinite(changed.members[..., 0]).mean(axis=0)
    row, ball = np.nonzero(on_table > 0)
    columns: Columns = {"t": ensemble.t + changed.t[row], "id": [ensemble.ids[k] for k in ball]}
    for axis, letter in enumerate("xy"):
        for name, values in zip(QUANTILES, compute_quantiles(changed.members[..., axis]), strict=True):
            columns[f"{letter}{name}"] = values[row, ball]
    columns["on_table"] = on_table[row, ball]
    write_columns(columns, path)


def _describe_stroke(ensemble: StruckEnsemble, numbers: ShotNumbers) -> dict[str, Any]:
    """Describe the real stroke as the run states it, else by the median of the plays: speed (m/s), spins as shares."""
    balls, cue = [member.balls for member in ensemble.members], ensemble.cue
    strokes = [measure_stroke(one.state[cue], float(one.radius[cue])) for one in balls]
    stroke: dict[str, Any] = {"observable": []}
    for k, (name, number) in enumerate(STROKE_NUMBERS.items()):
        played, stated = [one[k] for one in strokes], numbers.find_number(number, numbers.cue)
        stroke[name], stroke[f"{name}_sigma"] = float(np.median(played)), float(np.std(played))
        if stated is not None and stated.observable:
            stroke[name], stroke[f"{name}_sigma"] = stated.value, stated.sigma
            stroke["observable"].append(name)
    return stroke


def _describe_changed_stroke(real: dict[str, Any], change: StrokeChange) -> dict[str, float]:
    """Describe a stroke with a change by the real one."""
    replaced = {"speed": change.speed, "side": change.side, "top": change.top}
    factors, added = {"speed": change.speed_factor}, {"side": change.side_added, "top": change.top_added}
    changed: dict[str, float] = {}
    for name, value in replaced.items():
        factor, sigma = factors.get(name, 1.0), real[f"{name}_sigma"]
        changed[name] = real[name] * factor + added.get(name, 0.0) if value is None else value
        changed[f"{name}_sigma"] = sigma * factor if value is None else 0.0
    return changed


def _list_filmed_events(events: Events, ensemble: StruckEnsemble, end: float) -> list[dict[str, Any]]:
    """List what happened in the film from the strike of a shot until a time, s."""
    return [
        {"kind": events.kind[k], "a": events.a[k], "b": events.b[k], "probability": float(events.probability[k]),
         "t": float(events.t[k]), "t_sigma": float(events.t_sigma[k])}
        for k in range(len(events))
        if events.kind[k] != "strike" and ensemble.t <= events.t[k] < end
    ]  # fmt: skip


def _list_played_events(ensemble: StruckEnsemble, shot: ChangedShot) -> list[dict[str, Any]]:
    """List what happens in at least a few plays of a shot."""
    return [
        {"kind": one.event[0], "a": one.event[1], "b": one.event[2], "probability": one.probability,
         "t": ensemble.t + one.t, "t_sigma": one.t_sigma}
        for one in shot.events
    ]  # fmt: skip
