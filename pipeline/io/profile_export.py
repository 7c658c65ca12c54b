"""The cure of a billiards gap, as files: a table profile, and the same numbers as pooltool counts them.

pooltool (Kiefl 2024, doi:10.21105/joss.07301; names and formulae as in version 0.6.0) has a ball (`BallParams`) with
sliding friction u_s, rolling friction u_r, spinning friction u_sp = u_sp_proportionality R, ball friction u_b, ball
restitution e_b, cushion restitution e_c and cushion friction f_c; side spin decays at 5 u_sp g / (2 R). u_b counts only
where the friction of the ball's law is `average`. What it cannot hold is named, not dropped.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diagnosis.verdicts.verdict import Report
from models.core.scene import Table
from models.physics.billiards.ball_cushion.cushion_contact import NOSE_HEIGHT
from models.physics.billiards.ball_cushion.stronge import RATIO
from models.physics.billiards.parameters import GRAVITY
from pipeline.engine.atomic_write import aside

SCHEMA = "trueroll.profile/1"
PROFILE, POOLTOOL = "profile.json", "pooltool.json"
_NAMES: Mapping[str, tuple[str, float]] = {
    "sliding_friction.mu": ("u_s", 1.0),
    "rolling_resistance.mu": ("u_r", 1.0),
    "spin_decay.rate": ("u_sp_proportionality", 2 / (5 * GRAVITY)),
    "ball_friction.mu": ("u_b", 1.0),  # times (1 + e_b) / (2 e_b): its impulse is mu e v, ours mu (1 + e) v / 2
    "ball_restitution.e": ("e_b", 1.0),
    "cushion_friction.mu": ("f_c", 1.0),
    "cushion_restitution.e": ("e_c", 1.0),
}
"""By parameter of ours: pooltool's name, and the factor from ours to it."""
_HARDLY = 1e-6
"""for a friction that is absent: pooltool refuses zero, and this takes 10 um/s from a ball in a second."""
_ABSENT = dict.fromkeys(("u_s", "u_r", "u_sp_proportionality", "u_b", "f_c"), _HARDLY) | {"e_b": 1.0, "e_c": 1.0}
_CUSHIONS: Mapping[str, tuple[str, dict[str, bool | float]]] = {
    "mirror": ("unrealistic", {"restitution": True}),
    "han_2005": ("han_2005", {}),
    "mathavan_2010": ("mathavan_2010", {}),
    "stronge": ("stronge_compliant", {"omega_ratio": RATIO}),
}
"""By law of ours: pooltool's name of it, and its options. A mirror with friction has none there: what comes nearest,
`impulse_frictional_inelastic`, takes roll from a ball that meets the cushion head-on."""
_BALLS = {
    "elastic": ("frictionless_elastic", None),
    "inelastic": ("frictional_inelastic", "average"),
    "alciatore": ("frictional_inelastic", "alciatore"),
}
"""By law of ours: pooltool's name of it, and of its friction."""


def has_cure(report: Report) -> bool:
    """Whether there is anything to write: nothing is fitted where there is too little to test."""
    return bool(report.fitted)


def write_cure(report: Report, table: Table, folder: Path) -> None:
    """Both files, each in one step, where something was fitted."""
    if not has_cure(report):
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
    factors = {one.name: _NAMES[one.name][1] for one in known}
    restitution = next((one.value for one in known if one.name == "ball_restitution.e"), 1.0)
    if "ball_friction.mu" in factors:
        factors["ball_friction.mu"] = (1 + restitution) / (2 * restitution)
    law, law_options = _CUSHIONS[cushion]
    met, friction = _BALLS[ball]
    missing = {one.name.split(".")[0] for one in report.fitted if one.name not in _NAMES}
    if cushion == "mirror" and "cushion_friction.mu" in factors:
        missing |= {"cushion_friction of a mirror"}
    return {
        "ball_params": {"m": table.ball_mass, "R": table.ball_radius, "g": GRAVITY, **_ABSENT}
        | {_NAMES[one.name][0]: max(one.value * factors[one.name], _HARDLY) for one in known},
        "sigma": {_NAMES[one.name][0]: _finite(one.sigma * factors[one.name]) for one in known},
        "table_specs": {"l": table.length, "w": table.width, "cushion_height": NOSE_HEIGHT * table.ball_radius},
        "ball_cushion": law,
        "ball_cushion_options": law_options,
        "ball_ball": met,
        "ball_ball_friction": friction,
        "not_held": sorted(missing),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
