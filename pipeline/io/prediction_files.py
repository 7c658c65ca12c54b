"""A prediction as files and sentences: prediction.csv, prediction.json, and what it says of each ball."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.estimation.forecast.ensemble_prediction import Foretold, Meeting, Prediction
from models.estimation.forecast.forecast_check import Hindsight
from pipeline.io.run_tables import Columns, write_columns
from pipeline.reporting.text.run_trust import trust_facts

QUANTILES = {"05": 0.05, "25": 0.25, "50": 0.5, "75": 0.75, "95": 0.95}
NORMAL = {"05": -1.6448536, "25": -0.6744898, "50": 0.0, "75": 0.6744898, "95": 1.6448536}
"""The same of a standard normal distribution."""
LYING = 0.005
"""m: a ball that no course moves farther lies."""
SURE = 0.995
LIKELY = 0.1
"""Probability from which a sentence mentions something."""


def write_prediction(found: Prediction, shot: int, path: Path) -> None:
    """One row per moment and ball that may be on the table; m, m/s, covariance in m^2, quantiles in m."""
    row, ball = np.nonzero(np.isfinite(found.path[..., 0]))
    cov = found.covariance[row, ball]
    columns: Columns = {
        "shot": np.full(len(row), shot), "t": found.t[row], "id": [found.outlook.ids[k] for k in ball],
        "x": found.path[row, ball, 0], "y": found.path[row, ball, 1],
        "vx": found.velocity[row, ball, 0], "vy": found.velocity[row, ball, 1], "sigma": found.sigma[row, ball],
        "xx": cov[:, 0, 0], "xy": cov[:, 0, 1], "yy": cov[:, 1, 1],
    }  # fmt: skip
    for axis, letter in enumerate("xy"):
        for name, values in _quantiles(found, axis).items():
            columns[f"{letter}{name}"] = values[row, ball]
    columns["on_table"] = found.on_table[row, ball]
    columns["ensemble"] = found.ensemble[row].astype(np.int64)
    write_columns(columns, path)


def _quantiles(found: Prediction, axis: int) -> dict[str, FloatArray]:
    """(T, N) each: of the normal distribution, then of the courses that have the ball on the table."""
    middle, spread = found.path[..., axis], np.sqrt(found.covariance[..., axis, axis])
    drawn = np.ma.masked_invalid(found.courses[..., axis]).filled(np.nan)
    gone = np.isnan(drawn).all(axis=0)
    drawn[:, gone] = 0.0
    shares = np.nanquantile(drawn, list(QUANTILES.values()), axis=0)
    shares[:, gone] = np.nan
    chosen = found.ensemble[:, None]
    return {
        name: np.where(chosen, share, middle + NORMAL[name] * spread)
        for name, share in zip(QUANTILES, shares, strict=True)
    }


def summary(found: Prediction, shot: int, after: Hindsight | None) -> dict[str, Any]:
    """prediction.json: what may happen, where every ball ends, and how right it was where that was seen."""
    look = found.outlook
    linear = found.t[~found.ensemble]
    return {
        "schema": "trueroll.prediction/1", "shot": shot, "t": look.t, "until": float(found.t[-1]),
        "linear_until": float(linear[-1]) if len(linear) else look.t, "draws": len(found.courses),
        "trust": trust_facts(look.trust),
        "balls": [_ball(found, k) for k in range(len(look.ids))],
        "events": [_event(one) for one in found.foretold],
        "compared": None if after is None else _compared(found, after),
    }  # fmt: skip


def _ball(found: Prediction, k: int) -> dict[str, Any]:
    on_table = float(found.on_table[-1, k])
    end = None
    if on_table > 0:
        place, sigma = found.path[-1, k], float(found.sigma[-1, k])
        end = {"x": float(place[0]), "y": float(place[1]), "sigma": sigma, "on_table": on_table}
    first = [{"kind": what[0], "b": what[2], "probability": p} for what, p in found.first[k]]
    return {"id": found.outlook.ids[k], "sentence": sentence(found, k), "first": first, "end": end}


def _event(one: Foretold) -> dict[str, Any]:
    kind, a, b = one.meeting
    return {"kind": kind, "a": a, "b": b, "probability": one.probability, "t": one.t, "t05": one.t_low,
            "t95": one.t_high}  # fmt: skip


def _compared(found: Prediction, after: Hindsight) -> list[dict[str, Any]]:
    """Per ball that was seen afterwards: its error beside the promised one, and how much of it lay in the regions."""
    rows = []
    for k, name in enumerate(found.outlook.ids):
        own = after.ball == k
        if own.any():
            level = after.level[own & np.isfinite(after.level)]
            rows.append({
                "id": name, "t": float(after.t[own][-1]), "error_mm": 1e3 * float(after.error[own][-1]),
                "sigma_mm": 1e3 * float(after.sigma[own][-1]),
                "rms_error_mm": 1e3 * float(np.sqrt(np.mean(after.error[own] ** 2))),
                "rms_sigma_mm": 1e3 * float(np.sqrt(np.mean(after.sigma[own] ** 2))),
                "within_50": float(np.mean(level <= 0.5)) if len(level) else None,
                "within_90": float(np.mean(level <= 0.9)) if len(level) else None,
            })  # fmt: skip
    return rows


def as_text(document: dict[str, Any]) -> str:
    """Strict JSON; numbers that are not known are null."""

    def strict(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: strict(one) for key, one in value.items()}
        if isinstance(value, list):
            return [strict(one) for one in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return json.dumps(strict(document), indent=1, allow_nan=False)


def sentence(found: Prediction, k: int) -> str:
    """What is to come for ball k, in one sentence."""
    name, look = found.outlook.ids[k], found.outlook
    parts = [f"{_verb(what)}{_surely(p)}" for what, p in found.first[k][:2] if p >= LIKELY]
    here = found.path[0, k]
    moved = np.hypot(*(np.nan_to_num(found.courses[:, -1, k], nan=9.0) - here).T)
    met = " or ".join(parts)
    if not look.moving[k] and not met:
        return f"{name} lies at {_place(here)} and stays there{_surely(float(np.mean(moved < LYING)))}."
    begin = f"{name} {'moves on' if look.moving[k] else 'lies'}"
    if met:
        begin += f", {met}"
        left = 1 - sum(p for _, p in found.first[k])
        begin += f", or meets nothing ({left:.0%})" if left >= LIKELY else ""
    potted = 1 - float(found.on_table[-1, k])
    if potted >= SURE:
        return f"{begin}, and is potted."
    rest = next((one for one in found.foretold if one.meeting == ("rest", name, "")), None)
    when = f"at {found.t[-1]:.2f} s it is at"
    if rest is not None and rest.probability >= 0.5:
        when = f"it rests from {rest.t:.2f} s on{_surely(rest.probability)} at"
    end = f"; {when} {_place(found.path[-1, k])} ± {1e3 * found.sigma[-1, k]:.0f} mm"
    return begin + end + (f" unless it is potted ({potted:.0%})." if potted >= 0.02 else ".")


def _verb(what: Meeting) -> str:
    kind, _, other = what
    return {
        "ball": f"meets {other} first",
        "cushion": f"hits the {other} cushion first",
        "pocket": f"falls into the {other} pocket",
    }[kind]


def _surely(probability: float) -> str:
    return "" if probability >= SURE else f" ({probability:.0%})"


def _place(xy: FloatArray) -> str:
    return f"({xy[0]:.3f}, {xy[1]:.3f}) m"
