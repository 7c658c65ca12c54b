"""Files of a shot that is played otherwise: what_if.json and what_if.csv."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.estimation.what_if.changed_shot import ChangedShot
from models.estimation.what_if.shot_outcome import ShotGoal
from models.estimation.what_if.stroke_change import PlayerSpread, StrokeChange
from models.estimation.what_if.struck_ensemble import StruckEnsemble
from pipeline.io.run_tables import Columns, write_columns

SCHEMA = "trueroll.what-if/1"
QUANTILES = {"05": 0.05, "25": 0.25, "50": 0.5, "75": 0.75, "95": 0.95}


def summarize_changed_shot(
    ensemble: StruckEnsemble, change: StrokeChange, spread: PlayerSpread, spread_source: str, goal: ShotGoal,
    real: ChangedShot, changed: ChangedShot, did_score: bool,
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


def _summarize_play(ensemble: StruckEnsemble, shot: ChangedShot) -> dict[str, Any]:
    events = [
        {"kind": one.event[0], "a": one.event[1], "b": one.event[2], "probability": one.probability,
         "t": ensemble.t + one.t, "t05": ensemble.t + one.t_low, "t95": ensemble.t + one.t_high}
        for one in shot.events
    ]  # fmt: skip
    return {"probability": shot.probability, "probability_sigma": shot.probability_sigma, "events": events}
