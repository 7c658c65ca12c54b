"""Files of a shot that is played otherwise: what_if.json and what_if.csv."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.estimation.what_if.changed_shot import ChangedShot
from models.estimation.what_if.shot_outcome import ShotGoal
from models.estimation.what_if.stroke_change import PlayerSpread, StrokeChange, change_stroke, measure_stroke
from models.estimation.what_if.struck_ensemble import StruckEnsemble
from pipeline.io.csv_tables import Columns, write_columns

SCHEMA = "trueroll.what-if/1"
QUANTILES = {"05": 0.05, "25": 0.25, "50": 0.5, "75": 0.75, "95": 0.95}


def summarize_changed_shot(
    ensemble: StruckEnsemble, change: StrokeChange, spread: PlayerSpread, spread_source: str, goal: ShotGoal,
    real: ChangedShot, changed: ChangedShot, did_score: bool, ends: tuple[float, float],
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
        did_score: Whether the real shot scored.
        ends: s of the clip at which it ends, and s after the strike at which the drawn plays end at the latest.

    Returns:
        A tree of JSON values with the schema `trueroll.what-if/1`.
    """
    return {
        "schema": SCHEMA,
        "t": ensemble.t,
        "cue": ensemble.ids[ensemble.cue],
        "draws": len(ensemble.members),
        "model": "whole_shot" if ensemble.is_whole_shot else "segments",
        "change": asdict(change),
        "stroke": {"real": _describe_stroke(ensemble, StrokeChange()), "changed": _describe_stroke(ensemble, change)},
        "clip_end": ends[0],
        "play_end": ensemble.t + ends[1],
        "spread": {"speed": spread.speed, "angle_deg": spread.angle, "source": spread_source},
        "goal": asdict(goal),
        "real": {"scored": did_score, **_summarize_play(ensemble, real)},
        "changed": _summarize_play(ensemble, changed),
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
        for name, values in zip(QUANTILES, _compute_quantiles(changed.members[..., axis]), strict=True):
            columns[f"{letter}{name}"] = values[row, ball]
    columns["on_table"] = on_table[row, ball]
    write_columns(columns, path)


def _compute_quantiles(places: FloatArray) -> FloatArray:
    """Compute the quantiles (Q, T, N) over the plays (M, T, N) in which a ball is on the table."""
    gone = np.isnan(places).all(axis=0)
    filled = np.where(gone, 0.0, places)
    return np.asarray(np.nanquantile(filled, list(QUANTILES.values()), axis=0))


def _describe_stroke(ensemble: StruckEnsemble, change: StrokeChange) -> dict[str, float]:
    """Describe the median stroke of the ensemble with a change: speed (m/s), side spin and top spin as shares."""
    strokes = []
    for member in ensemble.members:
        radius = float(member.balls.radius[ensemble.cue])
        struck = change_stroke(member.balls.state[ensemble.cue], radius, change, 1.0, 0.0)
        strokes.append(measure_stroke(struck, radius))
    names = ("speed", "side", "top")
    sigmas = zip((f"{name}_sigma" for name in names), np.std(strokes, axis=0).tolist(), strict=True)
    return {**dict(zip(names, np.median(strokes, axis=0).tolist(), strict=True)), **dict(sigmas)}


def _summarize_play(ensemble: StruckEnsemble, shot: ChangedShot) -> dict[str, Any]:
    events = [
        {"kind": one.event[0], "a": one.event[1], "b": one.event[2], "probability": one.probability,
         "t": ensemble.t + one.t, "t05": ensemble.t + one.t_low, "t95": ensemble.t + one.t_high}
        for one in shot.events
    ]  # fmt: skip
    return {"probability": shot.probability, "probability_sigma": shot.probability_sigma, "events": events}
