"""Files of a learned table: its profile, and what pooltool can hold of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

from models.core.fit_result import Parameter
from models.core.scene import CUSHIONS, Table
from models.estimation.table_learning.learn_table import TableLesson
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.effects.catalogue import find_prior
from pipeline.engine.atomic_write import write_json
from pipeline.io.profile_export import build_pooltool_parameters, describe_physics

_LEARNED_ONLY = ("offsets of the noses", "scatter of cushion contacts")
"""Properties of a learned table that pooltool does not have."""
LEARNED_BALL_MODEL = "alciatore"
"""Ball model of predictions on a learned table."""


def write_learned_profile(
    lesson: TableLesson, table: Table, shot_count: int, path: Path, views: Mapping[str, Any] = MappingProxyType({})
) -> tuple[str, ...]:
    """Write the profile of a learned table and, beside it, what pooltool can hold of it, each in one step.

    Args:
        lesson: What was learned.
        table: The table.
        shot_count: Number of shots that taught it.
        path: The file.
        views: View, cloth and balls of the shots, of `collect_views`.

    Returns:
        What pooltool cannot hold.
    """
    learned = lesson.table
    content = describe_physics(lesson.parameters, learned.cushion_law, LEARNED_BALL_MODEL, table) | {
        "scatter": asdict(learned.scatter),
        "noses": {
            side: {"value": float(value), "sigma": float(sigma), "unit": "m"}
            for side, value, sigma in zip(CUSHIONS, learned.noses, learned.nose_sigma, strict=True)
        },
        "covariance": {
            "parameters": [PARAMETER_NAMES[k] for k in learned.uncertain],
            "matrix": learned.covariance.tolist(),
            "noses": learned.nose_covariance.tolist(),
        },
        "learned_from": {"shots": shot_count, "cushion_contacts": lesson.contact_count},
        "correction": {"gain": lesson.correction_gain, "weights": learned.correction.tolist()},
        "cushion_models": [{"name": name, "log_evidence": value} for name, value in lesson.candidates],
        **views,
    }
    e = find_prior("ball_restitution", "e")  # as in predictions on a learned table
    usual = Parameter("ball_restitution.e", e.value, e.sigma, e.unit, True)
    exported = build_pooltool_parameters((*lesson.parameters, usual), learned.cushion_law, LEARNED_BALL_MODEL, table)
    corrected = ("correction of the cushion model",) if len(learned.correction) else ()
    exported["not_held"] = sorted({*exported["not_held"], *_LEARNED_ONLY, *corrected})
    write_json(content, path)
    write_json(exported, name_pooltool_file(path))
    return tuple(exported["not_held"])


def name_pooltool_file(path: Path) -> Path:
    """Name the file of pooltool's parameters beside a profile, such as club.pooltool.json beside club.json."""
    return path.with_name(f"{path.stem}.pooltool.json")
