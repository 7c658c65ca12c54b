"""Files of a diagnosis: gap.json, gap_predictions.csv, and the profile of an improved billiards simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv

from diagnosis.verdicts.verdict import CandidateEffect, DiagnosisReport, Gap, GapLocation, Strength, Unexplained
from models.core.fit_result import Parameter
from models.core.scene import Table
from pipeline.engine.atomic_write import replace_file
from pipeline.io.profile_export import build_pooltool_parameters, describe_physics
from pipeline.io.strict_json import replace_nonfinite, write_json

SCHEMA = "trueroll.gap/1"
PROFILE_FILE, POOLTOOL_FILE = "profile.json", "pooltool.json"
_DECIMALS = 7
AXES = ("x", "y", "z")
# Phases by another name in the schema, which has one for contacts with cushions and with walls.
_PHASES = {"wall_contact": "cushion_contact"}
_STRENGTH_KEYS = ("value", "sigma", "unit", "prior_only", "shot_spread", "body_spread")


def write_gap_files(report: DiagnosisReport, folder: Path) -> None:
    """Write gap.json and gap_predictions.csv; each file is replaced in one step.

    Args:
        report: Result of a diagnosis.
        folder: Folder of the files; created if it does not exist.
    """
    with replace_file(folder / "gap_predictions.csv") as path:
        csv.write_csv(tabulate_predictions(report.gap), path, csv.WriteOptions(quoting_style="needed"))
    write_json(build_gap_document(report), folder / "gap.json")


def write_profile_files(
    report: DiagnosisReport, table: Table, folder: Path, views: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Write profile.json and pooltool.json, each in one step, if parameters were fitted.

    Args:
        report: Result of a diagnosis of billiards.
        folder: Folder of the files.
        views: View, cloth and balls of the shots, of `collect_views`.
    """
    if not report.fitted:
        return
    cushion, ball = report.forms
    fitted = [Parameter(one.name, one.value, one.sigma, one.unit, one.prior_only) for one in report.fitted]
    write_json({**describe_physics(fitted, cushion, ball, table), **views}, folder / PROFILE_FILE)
    write_json(build_pooltool_parameters(fitted, cushion, ball, table), folder / POOLTOOL_FILE)


def build_gap_document(report: DiagnosisReport) -> dict[str, Any]:
    """Build the content of gap.json.

    Args:
        report: Result of a diagnosis.

    Returns:
        A tree of strict JSON values with the schema `trueroll.gap/1`.
    """
    closing = report.gap.closure
    document = {
        "schema": SCHEMA,
        "scene": report.scene,
        "model": report.model,
        "verdict": report.verdict,
        "effects": report.effects,
        "candidates": [_format_candidate(one) for one in report.candidates],
        "where": [_format_location(one, report.scene) for one in report.where],
        "gap": {
            "metric": report.gap.metric,
            "horizon_s": report.gap.horizon,
            "held_out_shots": report.gap.shots,
            "as_stated": report.gap.as_stated,
            "before": closing.before,
            "after": closing.after,
            "floor": closing.floor,
            "floor_unknown_because": report.gap.floor_reason or None,
            "closed": closing.closed if closing.resolved else None,
            "closed_interval": closing.interval if closing.resolved else None,
            "resolved": closing.resolved,
        },
        "per_effect": [asdict(one) for one in report.per_effect],
        "unexplained": _format_unexplained(report.unexplained, report.scene),
        "fitted": {one.name: _format_strength(one) for one in report.fitted},
        "forms": report.forms,
        "unidentifiable": report.unidentifiable,
        "not_tested": report.not_tested,
        "shot_use": asdict(report.shot_use),
        "film_next": report.film_next,
        "p_value": report.p_value,
        "notes": (report.reason, *report.notes) if report.reason else report.notes,
    }
    strict: dict[str, Any] = replace_nonfinite(document)
    return strict


def _format_location(one: GapLocation, scene: str) -> dict[str, Any]:
    joint = {"joint": one.ball} if scene == "mechanism" else {}
    return asdict(one) | {"phase": _PHASES.get(one.phase, one.phase)} | joint


def _format_unexplained(one: Unexplained, scene: str) -> dict[str, Any]:
    law = None if one.law is None else asdict(one.law) | {"formula": one.law.formula or None}
    if law is not None:
        del law["curve"]  # a line for the page, which the formula or the values beside it give
    where = [_format_location(place, scene) for place in one.where]
    return asdict(one) | {"where": where, "shape": one.shape or None, "law": law}


def _format_candidate(one: CandidateEffect) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "probability": one.probability,
        "group": one.group,
        "sign_flip_p_value": one.sign_flip_p_value,
        "sign_flip_limit": one.sign_flip_limit,
        "fitted_beside": one.fitted_beside,
        "parameters": {s.name: _format_strength(s) for s in one.strengths},
        "detectable_from": {s.name: s.detectable_from for s in one.strengths},
        "per_body": [
            {
                "body": own.body,
                "shots": own.shots,
                "parameters": {s.name: {"value": s.value, "sigma": s.sigma, "unit": s.unit} for s in own.strengths},
            }
            for own in one.per_body
        ],
    }


def _format_strength(one: Strength) -> dict[str, Any]:
    return {name: getattr(one, name) for name in _STRENGTH_KEYS}


def tabulate_predictions(gap: Gap) -> pa.Table:
    """Tabulate the observed and predicted positions of all hold-out windows.

    A scene with one coordinate has y = 0, a scene with three also has z.
    """
    coordinates = gap.before[0].shape[2] if gap.before else 2
    axes = AXES[: max(coordinates, 2)]
    names = [f"{axis}{kind}" for kind in ("", "_before", "_after") for axis in axes]
    rows: dict[str, list[Any]] = {name: [] for name in ("shot", "window", "frame", "t", "id", *names)}
    for number, (one, before, after) in enumerate(zip(gap.windows, gap.before, gap.after, strict=True)):
        row, body = np.nonzero(one.is_predicted)
        places = np.zeros((len(row), 3, len(axes)))
        places[..., :coordinates] = np.stack([x[row, body] for x in (one.segment.positions, before, after)], axis=1)
        columns = (
            np.full(len(row), one.segment.shot), np.full(len(row), number), one.segment.frame[row],
            np.round(one.segment.t[row], _DECIMALS), np.array(one.segment.bodies)[body],
            *np.round(places, _DECIMALS).reshape(len(row), -1).T,
        )  # fmt: skip
        for values, column in zip(rows.values(), columns, strict=True):
            values += column.tolist()
    return pa.table(rows)
