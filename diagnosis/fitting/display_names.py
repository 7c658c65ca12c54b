"""Names of effects, parameters, phases and groups of observations as reports print them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from models.physics.billiards.simulation.table_physics import BILLIARDS_MODEL_CHOICES
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS

# Effects, gauges and verdicts whose identifier is not a readable name.
CAUSES: Mapping[str, str] = {
    "none": "nothing",
    "unknown": "a cause that trueroll does not know",
    **{effect.name: effect.phrase for effect in BILLIARDS_EFFECTS if effect.phrase},
    **{choice.name: choice.phrase for choice in BILLIARDS_MODEL_CHOICES},
    "rods": "masses and lengths of the rods",
    "magnus": "lift by spin",
    "gravity_tilt": "tilt of the camera against the plumb line",
    "parallax_shift": "shift by parallax",
}
# Choices between published contact models, in the order of a report's forms: the missing effect if a form is wrong.
LAWS: Mapping[str, str] = {"cushion_law": "the right law of cushions", "ball_law": "the right law of ball contacts"}
PARAMETERS: Mapping[str, str] = {
    "mu": "\N{GREEK SMALL LETTER MU}",
    "slope_x": "fall towards +x",
    "slope_y": "fall towards +y",
    "wind_x": "along x",
    "wind_y": "along y",
    "p_x": "along x",
    "p_y": "along y",
    "pull": "gravity over effective length",
    "ratio": "more by",
    "seen": "measured over true lengths",
    "dry_2": "dry, second joint",
    "viscous_2": "viscous, second joint",
    "damping": "servo damping",
    "limit": "upper limit",
    "fall": "loss of force with speed",
}
_FREE_FORMULAS: Mapping[str, str] = {
    "sliding_friction": "a = −μ g, against the motion",
    "viscous_drag": "a = −k v",
    "air_drag": "a = −k |v| v",
    "slope": "a = g × fall / 1000",
}
# Laws of the effects by scene, where one short formula states them; docs/reference/effects.md has all.
FORMULAS: Mapping[str, Mapping[str, str]] = {
    "billiards": {
        "rolling_resistance": "a = −μ g while rolling",
        "sliding_friction": "a = −μ g against the slip",
        "viscous_drag": "a = −k v",
        "air_drag": "a = −k |v| v",
        "slope": "a = g × fall / 1000; 5/7 of it while rolling",
    },
    "slide": _FREE_FORMULAS,
    "flight": {
        "air_drag": "a = −k |u| u, with u relative to the air",
        "viscous_drag": "a = −k u, with u relative to the air",
        "magnus": "a = s v, across the motion",
        "wind": "u = v − wind in the drags",
    },
    "pendulum": {
        "joint_friction": "ω̇ = −viscous × ω − dry × sign(ω)",
        "air_drag": "ω̇ = −k |ω| ω",
        "gravity_tilt": "θ is measured from a tilted vertical",
    },
    "mechanism": {
        "joint_friction": "F = −viscous × v − dry × sign(v)",
        "stribeck": "F = −rise × exp(−(v / speed)²) × sign(v)",
        "air_drag": "F = −k |v| v",
        "spring": "F = rest force − stiffness × q",
        "delay": "u(t) = asked(t − time)",
        "actuator_lag": "time × u̇ = asked − u",
    },
}
# Phases of motion, with a preposition.
PHASES: Mapping[str, str] = {
    "free_roll": "in free roll",
    "after_strike": "after a strike",
    "ball_contact": "where balls touch",
    "cushion_contact": "at cushions",
    "wall_contact": "at walls",
    "rest": "at rest",
    "image_region": "in parts of the image",
    "time_jump": "at jumps in time",
    "flight": "in flight",
    "swing": "in the swing",
    "slide": "while sliding",
    "motion": "while joints move, away from where they turn back",
    "reversal": "where joints turn back",
}
# Variables with which a gap grows, where the identifier is not a readable name.
GROWTH_VARIABLES: Mapping[str, str] = {
    "time since contact": "the time since the last contact",
    "radius": "the distance from the centre of the image",
}
_GROUPS: Mapping[str, str] = {
    "all": "in all shots",
    "shot": "in shot {}",
    "body": "of body number {}",
    "speed": "at speeds of {} {unit}/s",
    "direction": "in the direction of {}",
    "place": "around {axes} = {} {unit}",
    "time": "at {} s",
    "since_contact": "{} s after a contact",
    "radius": "at {} px from the centre of the image",
    "row": "at {} px below the centre of the image",
}
_DIRECTIONS: Mapping[str, str] = {
    "along": "a shift along the motion",
    "across": "a shift across the motion",
    "waves": "a slow drift",
}


def format_cause(cause: str) -> str:
    """Format an effect, a gauge or a verdict in words.

    Args:
        cause: Identifier, such as `air_drag`.

    Returns:
        Its entry in `CAUSES`, or the identifier with spaces for underscores.
    """
    return CAUSES.get(cause, _replace_underscores(cause))


def format_parameter(name: str) -> str:
    """Format a parameter in words.

    Args:
        name: Identifier, such as `mu`, or `effect.parameter`.

    Returns:
        The parameter in words, after its effect where `name` has one.
    """
    effect, _, own = name.rpartition(".")
    word = PARAMETERS.get(own, _replace_underscores(own))
    strength, _, site = own.partition("_")
    if own not in PARAMETERS and strength in PARAMETERS:  # of one joint or actuator of several
        word = f"{PARAMETERS[strength]} of {_replace_underscores(site)}"
    return f"{format_cause(effect)}, {word}" if effect else word


def format_phase(name: str) -> str:
    """Format a phase of motion with its preposition, such as "at cushions".

    Args:
        name: Identifier, such as `cushion_contact`.

    Returns:
        Words that continue a sentence after a verb.
    """
    return PHASES.get(name, f"in {_replace_underscores(name)}")


def format_growth_variable(name: str) -> str:
    """Format the variable with which a gap grows.

    Args:
        name: Identifier, such as `radius`.

    Returns:
        The variable in words.
    """
    return GROWTH_VARIABLES.get(name, _replace_underscores(name))


def format_group(family: str, label: str, unit: str = "m") -> str:
    """Format a group of observations: a place, a time or a body.

    Args:
        family: Family of groups, such as `speed`.
        label: Member of the family, such as "1 to 2".
        unit: Unit of a coordinate, m or rad.

    Returns:
        Words that continue a sentence after a verb.
    """
    if family == "phase":
        return format_phase(label)
    return _GROUPS.get(family, f"at {_replace_underscores(family)} {{}}").format(
        label, unit=unit, axes="(theta1, theta2)" if unit == "rad" else "(x, y)"
    )


def format_direction(name: str, coordinates: Sequence[str]) -> str:
    """Format the direction in which residuals deviate.

    Args:
        name: `along`, `across`, `waves`, or the number of a coordinate.
        coordinates: Names of the coordinates.

    Returns:
        The direction in words.
    """
    if name.isdecimal():
        return f"a shift in {coordinates[int(name)]}"
    return _DIRECTIONS[name]


def _replace_underscores(name: str) -> str:
    return name.replace("_", " ")
