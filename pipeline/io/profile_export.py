"""Files of an improved billiards simulator: a table profile, and its parameters in the conventions of pooltool.

pooltool (Kiefl 2024, doi:10.21105/joss.07301; names and formulae as in version 0.6.0) has a ball (`BallParams`) with
sliding friction u_s, rolling friction u_r, spinning friction u_sp = u_sp_proportionality R, ball friction u_b, ball
restitution e_b, cushion restitution e_c and cushion friction f_c; side spin decays at 5 u_sp g / (2 R). u_b is used
only by the ball friction model `average`. Effects that pooltool does not have are listed under `not_held`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from models.core.constants import GRAVITY
from models.core.fit_result import Parameter
from models.core.scene import Table
from models.physics.billiards.ball_cushion.stronge import FREQUENCY_RATIO
from models.physics.billiards.contact_model import NOSE_HEIGHT, NOSE_HEIGHT_PARAMETER

SCHEMA = "trueroll.profile/1"
# pooltool's name of each parameter, and the factor from our value to its value.
_POOLTOOL_NAMES: Mapping[str, tuple[str, float]] = {
    "sliding_friction.mu": ("u_s", 1.0),
    "rolling_resistance.mu": ("u_r", 1.0),
    "spin_decay.rate": ("u_sp_proportionality", 2 / (5 * GRAVITY)),
    "ball_friction.mu": ("u_b", 1.0),  # times (1 + e_b) / (2 e_b): its impulse: mu e v; here: mu (1 + e) v / 2
    "ball_restitution.e": ("e_b", 1.0),
    "cushion_friction.mu": ("f_c", 1.0),
    "cushion_restitution.e": ("e_c", 1.0),
}
# Friction coefficient of an absent effect: pooltool rejects zero; this value slows a ball by 10 um/s in 1 s.
_NEGLIGIBLE_FRICTION = 1e-6
_ABSENT_PARAMETERS = dict.fromkeys(("u_s", "u_r", "u_sp_proportionality", "u_b", "f_c"), _NEGLIGIBLE_FRICTION) | {
    "e_b": 1.0,
    "e_c": 1.0,
}
# pooltool's name and options of each cushion model. It has no mirror with friction: the most similar model,
# `impulse_frictional_inelastic`, reduces the roll of a ball that hits the cushion head-on.
_CUSHION_MODELS: Mapping[str, tuple[str, dict[str, bool | float]]] = {
    "mirror": ("unrealistic", {"restitution": True}),
    "han_2005": ("han_2005", {}),
    "mathavan_2010": ("mathavan_2010", {}),
    "stronge": ("stronge_compliant", {"omega_ratio": FREQUENCY_RATIO}),
}
# pooltool's names of each ball contact model and of its friction model.
_BALL_MODELS = {
    "elastic": ("frictionless_elastic", None),
    "inelastic": ("frictional_inelastic", "average"),
    "alciatore": ("frictional_inelastic", "alciatore"),
}


def describe_physics(fitted: Iterable[Parameter], cushion: str, ball: str, table: Table) -> dict[str, Any]:
    """Describe effects with values and standard deviations, and contact models, as in a table profile."""
    effects: dict[str, dict[str, Any]] = {}
    for one in fitted:
        effect, parameter = one.name.split(".")
        effects.setdefault(effect, {})[parameter] = {"value": one.value, "sigma": one.sigma, "unit": one.unit}
    return {
        "schema": SCHEMA,
        "scene": "billiards",
        "table": {"length": table.length, "width": table.width},
        "ball_radius": table.ball_radius,
        "effects": effects,
        "laws": {"cushion": cushion, "ball": ball},
    }


def build_pooltool_parameters(fitted: Sequence[Parameter], cushion: str, ball: str, table: Table) -> dict[str, Any]:
    """Build the content of pooltool.json: ball parameters, contact models, and effects that pooltool does not have."""
    exported = [one for one in fitted if one.name in _POOLTOOL_NAMES]
    factors = {one.name: _POOLTOOL_NAMES[one.name][1] for one in exported}
    restitution = next((one.value for one in exported if one.name == "ball_restitution.e"), 1.0)
    if "ball_friction.mu" in factors:
        factors["ball_friction.mu"] = (1 + restitution) / (2 * restitution)
    cushion_model, cushion_options = _CUSHION_MODELS[cushion]
    ball_model, friction = _BALL_MODELS[ball]
    has_height = cushion != "mirror"  # pooltool's mirror touches the centre
    height = next((one.value for one in fitted if has_height and one.name == NOSE_HEIGHT_PARAMETER), NOSE_HEIGHT)
    missing = {
        one.name.split(".")[0]
        for one in fitted
        if one.name not in _POOLTOOL_NAMES and not (has_height and one.name == NOSE_HEIGHT_PARAMETER)
    }
    if cushion == "mirror" and "cushion_friction.mu" in factors:
        missing |= {"cushion_friction of a mirror"}
    return {
        "ball_params": {"m": table.ball_mass, "R": table.ball_radius, "g": GRAVITY, **_ABSENT_PARAMETERS}
        | {_POOLTOOL_NAMES[one.name][0]: max(one.value * factors[one.name], _NEGLIGIBLE_FRICTION) for one in exported},
        "sigma": {_POOLTOOL_NAMES[one.name][0]: one.sigma * factors[one.name] for one in exported},
        "table_specs": {"l": table.length, "w": table.width, "cushion_height": height * table.ball_radius},
        "ball_cushion": cushion_model,
        "ball_cushion_options": cushion_options,
        "ball_ball": ball_model,
        "ball_ball_friction": friction,
        "not_held": sorted(missing),
    }
