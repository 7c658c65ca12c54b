"""Files of a prediction: prediction.csv and prediction.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from models.core.naming import Naming
from models.core.typing import FloatArray
from models.estimation.forecast.ensemble_prediction import PredictedEvent, ShotPrediction
from models.estimation.forecast.forecast_check import PredictionCheck
from pipeline.io.csv_tables import Columns, write_columns
from pipeline.reporting.text.prediction_sentences import format_ball_prediction
from pipeline.reporting.text.text_formatting import summarize_trust

QUANTILES = {"05": 0.05, "25": 0.25, "50": 0.5, "75": 0.75, "95": 0.95}
NORMAL_QUANTILES = {"05": -1.6448536, "25": -0.6744898, "50": 0.0, "75": 0.6744898, "95": 1.6448536}
"""The same quantiles of the standard normal distribution."""


def write_prediction(prediction: ShotPrediction, shot: int, path: Path) -> None:
    """Write prediction.csv: one row per time and ball that may be on the table.

    Args:
        prediction: Predicted motion of N balls.
        shot: Number of the shot.
        path: File to write; m, m/s, covariance in m^2, quantiles in m.
    """
    row, ball = np.nonzero(np.isfinite(prediction.path[..., 0]))
    cov = prediction.covariance[row, ball]
    columns: Columns = {
        "shot": np.full(len(row), shot), "t": prediction.t[row], "id": [prediction.state.ids[k] for k in ball],
        "x": prediction.path[row, ball, 0], "y": prediction.path[row, ball, 1],
        "vx": prediction.velocity[row, ball, 0], "vy": prediction.velocity[row, ball, 1],
        "sigma": prediction.sigma[row, ball],
        "xx": cov[:, 0, 0], "xy": cov[:, 0, 1], "yy": cov[:, 1, 1],
    }  # fmt: skip
    for axis, letter in enumerate("xy"):
        for name, values in _compute_quantiles(prediction, axis).items():
            columns[f"{letter}{name}"] = values[row, ball]
    columns["on_table"] = prediction.on_table[row, ball]
    columns["ensemble"] = prediction.is_ensemble[row].astype(np.int64)
    write_columns(columns, path)


def _compute_quantiles(prediction: ShotPrediction, axis: int) -> dict[str, FloatArray]:
    """Compute quantiles (T, N): normal at first, later those of the ensemble members with the ball on the table."""
    middle, spread = prediction.path[..., axis], np.sqrt(prediction.covariance[..., axis, axis])
    drawn = np.ma.masked_invalid(prediction.members[..., axis]).filled(np.nan)
    gone = np.isnan(drawn).all(axis=0)
    drawn[:, gone] = 0.0
    shares = np.nanquantile(drawn, list(QUANTILES.values()), axis=0)
    shares[:, gone] = np.nan
    chosen = prediction.is_ensemble[:, None]
    return {
        name: np.where(chosen, share, middle + NORMAL_QUANTILES[name] * spread)
        for name, share in zip(QUANTILES, shares, strict=True)
    }


def summarize_prediction(
    prediction: ShotPrediction, shot: int, check: PredictionCheck | None, naming: Naming
) -> dict[str, Any]:
    """Build the content of prediction.json: possible events, final positions, and a comparison with observations.

    Args:
        prediction: Predicted motion of N balls.
        shot: Number of the shot.
        check: Comparison with later observations; None without any.
        naming: What balls, rails and pockets are called.

    Returns:
        A tree of JSON values with the schema `trueroll.prediction/1`.
    """
    state = prediction.state
    linear = prediction.t[~prediction.is_ensemble]
    return {
        "schema": "trueroll.prediction/1", "shot": shot, "t": state.t, "until": float(prediction.t[-1]),
        "linear_until": float(linear[-1]) if len(linear) else state.t, "draws": len(prediction.members),
        "trust": summarize_trust(state.trust),
        "balls": [_summarize_ball(prediction, k, naming) for k in range(len(state.ids))],
        "events": [_summarize_event(one) for one in prediction.events],
        "compared": None if check is None else _compare_with_observations(prediction, check),
    }  # fmt: skip


def _summarize_ball(prediction: ShotPrediction, k: int, naming: Naming) -> dict[str, Any]:
    on_table = float(prediction.on_table[-1, k])
    end = None
    if on_table > 0:
        place, sigma = prediction.path[-1, k], float(prediction.sigma[-1, k])
        end = {"x": float(place[0]), "y": float(place[1]), "sigma": sigma, "on_table": on_table}
    first = [{"kind": what[0], "b": what[2], "probability": p} for what, p in prediction.first_contacts[k]]
    sentence = format_ball_prediction(prediction, k, naming)
    return {"id": prediction.state.ids[k], "sentence": sentence, "first": first, "end": end}


def _summarize_event(one: PredictedEvent) -> dict[str, Any]:
    kind, a, b = one.event
    return {"kind": kind, "a": a, "b": b, "probability": one.probability, "t": one.t, "t05": one.t_low,
            "t95": one.t_high}  # fmt: skip


def _compare_with_observations(prediction: ShotPrediction, check: PredictionCheck) -> list[dict[str, Any]]:
    """Compare errors with predicted standard deviations and regions, for each ball that was observed later."""
    rows = []
    for k, name in enumerate(prediction.state.ids):
        own = check.ball == k
        if own.any():
            level = check.level[own & np.isfinite(check.level)]
            rows.append({
                "id": name, "t": float(check.t[own][-1]), "error_mm": 1e3 * float(check.error[own][-1]),
                "sigma_mm": 1e3 * float(check.sigma[own][-1]),
                "rms_error_mm": 1e3 * float(np.sqrt(np.mean(check.error[own] ** 2))),
                "rms_sigma_mm": 1e3 * float(np.sqrt(np.mean(check.sigma[own] ** 2))),
                "within_50": float(np.mean(level <= 0.5)) if len(level) else None,
                "within_90": float(np.mean(level <= 0.9)) if len(level) else None,
            })  # fmt: skip
    return rows
