"""Files and sentences of a prediction: prediction.csv, prediction.json, and a sentence per ball."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.estimation.forecast.ensemble_prediction import EventKey, PredictedEvent, ShotPrediction
from models.estimation.forecast.forecast_check import PredictionCheck
from pipeline.io.csv_tables import Columns, write_columns
from pipeline.reporting.text.text_formatting import summarize_trust

QUANTILES = {"05": 0.05, "25": 0.25, "50": 0.5, "75": 0.75, "95": 0.95}
NORMAL_QUANTILES = {"05": -1.6448536, "25": -0.6744898, "50": 0.0, "75": 0.6744898, "95": 1.6448536}
"""The same quantiles of the standard normal distribution."""
MAX_REST_SHIFT = 0.005
"""m, largest displacement of a ball that is described as staying at rest."""
CERTAIN_PROBABILITY = 0.995
MIN_REPORTED_PROBABILITY = 0.1
"""Least probability of an event that a sentence mentions."""


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


def summarize_prediction(prediction: ShotPrediction, shot: int, check: PredictionCheck | None) -> dict[str, Any]:
    """Build the content of prediction.json: possible events, final positions, and a comparison with observations.

    Args:
        prediction: Predicted motion of N balls.
        shot: Number of the shot.
        check: Comparison with later observations; None without any.

    Returns:
        A tree of JSON values with the schema `trueroll.prediction/1`.
    """
    state = prediction.state
    linear = prediction.t[~prediction.is_ensemble]
    return {
        "schema": "trueroll.prediction/1", "shot": shot, "t": state.t, "until": float(prediction.t[-1]),
        "linear_until": float(linear[-1]) if len(linear) else state.t, "draws": len(prediction.members),
        "trust": summarize_trust(state.trust),
        "balls": [_summarize_ball(prediction, k) for k in range(len(state.ids))],
        "events": [_summarize_event(one) for one in prediction.events],
        "compared": None if check is None else _compare_with_observations(prediction, check),
    }  # fmt: skip


def _summarize_ball(prediction: ShotPrediction, k: int) -> dict[str, Any]:
    on_table = float(prediction.on_table[-1, k])
    end = None
    if on_table > 0:
        place, sigma = prediction.path[-1, k], float(prediction.sigma[-1, k])
        end = {"x": float(place[0]), "y": float(place[1]), "sigma": sigma, "on_table": on_table}
    first = [{"kind": what[0], "b": what[2], "probability": p} for what, p in prediction.first_contacts[k]]
    return {"id": prediction.state.ids[k], "sentence": format_ball_sentence(prediction, k), "first": first, "end": end}


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


def format_ball_sentence(prediction: ShotPrediction, k: int) -> str:
    """Format the prediction of ball k as one sentence."""
    name, state = prediction.state.ids[k], prediction.state
    parts = [
        f"{_format_contact(what)}{_format_probability(p)}"
        for what, p in prediction.first_contacts[k][:2]
        if p >= MIN_REPORTED_PROBABILITY
    ]
    here = prediction.path[0, k]
    moved = np.hypot(*(np.nan_to_num(prediction.members[:, -1, k], nan=9.0) - here).T)
    contacts = " or ".join(parts)
    if not state.moving[k] and not contacts:
        stays = _format_probability(float(np.mean(moved < MAX_REST_SHIFT)))
        return f"{name} is at rest at {_format_position(here)} and stays there{stays}."
    begin = f"{name} {'keeps moving' if state.moving[k] else 'is at rest'}"
    if contacts:
        begin += f", {contacts}"
        left = 1 - sum(p for _, p in prediction.first_contacts[k])
        begin += f", or touches nothing ({100 * left:.0f} %)" if left >= MIN_REPORTED_PROBABILITY else ""
    potted = 1 - float(prediction.on_table[-1, k])
    if potted >= CERTAIN_PROBABILITY:
        return f"{begin}, and is potted."
    rest = next((one for one in prediction.events if one.event == ("rest", name, "")), None)
    when = f"at {prediction.t[-1]:.2f} s it is at"
    if rest is not None and rest.probability >= 0.5:
        when = f"it comes to rest at {rest.t:.2f} s{_format_probability(rest.probability)} at"
    end = f"; {when} {_format_position(prediction.path[-1, k])} ± {1e3 * prediction.sigma[-1, k]:.0f} mm"
    return begin + end + (f" unless it is potted ({100 * potted:.0f} %)." if potted >= 0.02 else ".")


def _format_contact(what: EventKey) -> str:
    kind, _, other = what
    return {
        "ball": f"touches {other} first",
        "cushion": f"hits the {other} cushion first",
        "pocket": f"falls into the {other} pocket",
    }[kind]


def _format_probability(probability: float) -> str:
    return "" if probability >= CERTAIN_PROBABILITY else f" ({100 * probability:.0f} %)"


def _format_position(xy: FloatArray) -> str:
    return f"({xy[0]:.3f}, {xy[1]:.3f}) m"
