"""The cure of a billiards gap, as files: a table profile, and the same numbers as pooltool counts them.

pooltool (Kiefl 2024, doi:10.21105/joss.07301) has a ball (`BallParams`) with sliding friction u_s, rolling friction
u_r, spinning friction u_sp = u_sp_proportionality R, ball friction u_b, ball restitution e_b, cushion restitution e_c
and cushion friction f_c; side spin decays at 5 u_sp g / (2 R). In later versions u_b and e_b belong to the law of two
balls and are no longer the ball's. What it cannot hold is named, not dropped.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diagnosis.verdict import Report, Strength
from models.billiards.parameters import GRAVITY
from models.scene import Table
from pipeline.publish import aside

SCHEMA = "trueroll.profile/1"
PROFILE, POOLTOOL = "profile.json", "pooltool.json"
_NAMES: Mapping[str, tuple[str, float]] = {
    "sliding_friction.mu": ("u_s", 1.0),
    "rolling_resistance.mu": ("u_r", 1.0),
    "spin_decay.rate": ("u_sp_proportionality", 2 / (5 * GRAVITY)),
    "ball_friction.mu": ("u_b", 1.0),
    "ball_restitution.e": ("e_b", 1.0),
    "cushion_friction.mu": ("f_c", 1.0),
    "cushion_restitution.e": ("e_c", 1.0),
}
"""By parameter of ours: pooltool's name, and the factor from ours to it."""
_ABSENT = {"u_s": 0.0, "u_r": 0.0, "u_sp_proportionality": 0.0, "u_b": 0.0, "e_b": 1.0, "f_c": 0.0, "e_c": 1.0}
_CUSHIONS = {"han_2005": "han_2005", "mathavan_2010": "mathavan_2010", "stronge": "stronge_compliant"}
"""pooltool's name of a cushion's law; its own mirror knows no friction and is called unrealistic."""
_BALLS = {"elastic": "frictionless_elastic", "inelastic": "frictional_inelastic"}


def write_cure(report: Report, table: Table, folder: Path) -> None:
    """Both files, each in one step, where something was fitted."""
    if not report.fitted:
        return
    for name, content in ((PROFILE, profile(report, table)), (POOLTOOL, pooltool(report, table))):
        with aside(folder / name) as path:
            path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def profile(report: Report, table: Table) -> dict[str, Any]:
    """The improved simulator: effects with values and sigmas, and laws."""
    cushion, ball = report.forms
    effects: dict[str, dict[str, Any]] = {}
    for one in report.fitted:
        effect, parameter = one.name.split(".")
        effects.setdefault(effect, {})[parameter] = {"value": one.value, "sigma": _finite(one.sigma), "unit": one.unit}
    return {
        "schema": SCHEMA,
        "scene": report.scene,
        "table": {"length": table.length, "width": table.width},
        "ball_radius": table.ball_radius,
        "effects": effects,
        "laws": {"cushion": cushion, "ball": ball},
    }


def pooltool(report: Report, table: Table) -> dict[str, Any]:
    """Parameters of a ball, names of laws, and what pooltool cannot hold."""
    cushion, ball = report.forms
    known = [one for one in report.fitted if one.name in _NAMES]
    values = _ABSENT | {_NAMES[one.name][0]: one.value * _NAMES[one.name][1] for one in known}
    return {
        "ball_params": {"m": table.ball_mass, "R": table.ball_radius, "g": GRAVITY, **values},
        "sigma": {_NAMES[one.name][0]: _sigma(one) for one in known},
        "table_specs": {"l": table.length, "w": table.width},
        "ball_cushion": _CUSHIONS.get(cushion),
        "ball_ball": _BALLS.get(ball),
        "not_held": sorted(
            {one.name.split(".")[0] for one in report.fitted if one.name not in _NAMES}
            | ({f"cushion_law {cushion}"} if cushion not in _CUSHIONS else set())
            | ({f"ball_law {ball}"} if ball not in _BALLS else set())
        ),
    }


def _sigma(one: Strength) -> float | None:
    return _finite(one.sigma * _NAMES[one.name][1])


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
