"""The files of a diagnosis: gap.json and gap_predictions.csv, as the contract has them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv

from diagnosis.verdicts.verdict import Candidate, Gap, Report, Strength
from pipeline.engine.atomic_write import aside

SCHEMA = "trueroll.gap/1"
_DECIMALS = 7
AXES = ("x", "y", "z")


def write_gap(report: Report, folder: Path) -> None:
    """Both files, each in one step."""
    folder.mkdir(parents=True, exist_ok=True)
    with aside(folder / "gap_predictions.csv") as path:
        csv.write_csv(predictions(report.gap), path, csv.WriteOptions(quoting_style="needed"))
    with aside(folder / "gap.json") as path:
        path.write_text(json.dumps(as_json(report), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def as_json(report: Report) -> dict[str, Any]:
    """gap.json."""
    told = report.gap.closing
    return {
        "schema": SCHEMA,
        "scene": report.scene,
        "model": list(report.model),
        "verdict": report.verdict,
        "effects": list(report.effects),
        "candidates": [_candidate(one) for one in report.candidates],
        "where": [
            {
                "phase": one.phase,
                "share": one.share,
                "ball": one.ball,
                "shot": one.shot,
                "span": None if one.span is None else list(one.span),
                "region": one.region,
                "grows_with": one.grows_with,
            }
            for one in report.where
        ],
        "shape": report.shape,
        "gap": {
            "metric": report.gap.metric,
            "horizon_s": report.gap.horizon,
            "held_out_shots": list(report.gap.shots),
            "before": _finite(told.before),
            "after": _finite(told.after),
            "floor": _finite(told.floor),
            "closed": _finite(told.closed) if told.resolved else None,
            "closed_interval": list(told.interval) if told.resolved else None,
            "resolved": told.resolved,
        },
        "per_effect": [
            {"effect": one.effect, "closed": _finite(one.closed), "interval": list(one.interval)}
            for one in report.per_effect
        ],
        "fitted": {one.name: _strength(one) for one in report.fitted},
        "forms": list(report.forms),
        "unidentifiable": list(report.unidentifiable),
        "not_tested": list(report.not_tested),
        "film_next": report.film_next,
        "p_value": report.p_value,
        "notes": list(report.notes),
    }


def _candidate(one: Candidate) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "probability": one.probability,
        "group": list(one.group),
        "parameters": {s.name: _strength(s) for s in one.strengths},
        "detectable_from": {s.name: _finite(s.detectable_from) for s in one.strengths},
    }


def _strength(one: Strength) -> dict[str, Any]:
    return {"value": one.value, "sigma": _finite(one.sigma), "unit": one.unit, "prior_only": one.prior_only}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def predictions(gap: Gap) -> pa.Table:
    """Rows of the predicted part of every window; a scene of one coordinate has y = 0, one of three has z too."""
    coordinates = gap.before[0].shape[2] if gap.before else 2
    axes = AXES[: max(coordinates, 2)]
    names = [f"{axis}{kind}" for kind in ("", "_before", "_after") for axis in axes]
    rows: dict[str, list[Any]] = {name: [] for name in ("shot", "window", "frame", "t", "id", *names)}
    for number, (one, before, after) in enumerate(zip(gap.windows, gap.before, gap.after, strict=True)):
        seen = one.piece.seen.copy()
        seen[: one.known] = False
        for row, body in zip(*np.nonzero(seen), strict=True):
            rows["shot"].append(one.piece.shot)
            rows["window"].append(number)
            rows["frame"].append(int(one.piece.frame[row]))
            rows["t"].append(round(float(one.piece.t[row]), _DECIMALS))
            rows["id"].append(one.piece.bodies[body])
            for kind, values in (("", one.piece.places), ("_before", before), ("_after", after)):
                for k, axis in enumerate(axes):
                    value = float(values[row, body, k]) if k < coordinates else 0.0
                    rows[f"{axis}{kind}"].append(round(value, _DECIMALS))
    return pa.table(rows)
