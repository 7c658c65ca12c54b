"""What effects, parameters, phases and groups of observations are called where people read of them."""

from __future__ import annotations

from collections.abc import Mapping

CAUSES: Mapping[str, str] = {
    "none": "nothing",
    "unknown": "something unknown",
    "spin_decay": "decay of side spin",
    "nap": "nap of the cloth",
    "cushion_restitution_speed": "cushion restitution that falls with speed",
    "cushion_restitution_power": "power of that fall",
    "cushion_cloth": "friction of the cloth under the nose",
    "cushion_law": "another cushion law",
    "ball_law": "another law of ball contacts",
    "unequal_mass": "unequal masses of balls",
    "unequal_radius": "unequal sizes of balls",
    "lens_second_term": "second term of the lens",
    "perspective": "perspective of the camera",
    "scale": "wrong scale of the picture",
    "dropped_frames": "dropped pictures",
    "rods": "make of the rods",
    "magnus": "lift by spin",
    "gravity_tilt": "tilt of the camera against the plumb line",
    "parallax_shift": "shift by parallax",
    "frame_rate": "rate of the pictures",
}
"""Effects, gauges and verdicts that their names do not tell."""
LAWS: Mapping[str, str] = {"cushion_law": "the right law of cushions", "ball_law": "the right law of ball contacts"}
"""Choices between published laws, in the order of a report's forms: what is lacked where the wrong one is assumed."""
PARAMETERS: Mapping[str, str] = {
    "mu": "\N{GREEK SMALL LETTER MU}",
    "slope_x": "along x",
    "slope_y": "along y",
    "wind_x": "along x",
    "wind_y": "along y",
    "p_x": "along x",
    "p_y": "along y",
    "ratio": "more by",
    "seen": "too large by",
    "frames": "pictures",
    "dry_2": "dry, second joint",
    "viscous_2": "viscous, second joint",
}
PHASES: Mapping[str, str] = {
    "free_roll": "in free roll",
    "after_strike": "after a strike",
    "ball_contact": "where balls touch",
    "cushion_contact": "at cushions",
    "rest": "at rest",
    "image_region": "in parts of the picture",
    "time_jump": "at jumps in time",
    "flight": "in flight",
    "swing": "in the swing",
    "slide": "while sliding",
}
"""Where something shows."""
GROWING: Mapping[str, str] = {
    "time since contact": "the time since the last contact",
    "radius": "the distance from the middle of the picture",
}
"""With what something grows, where the name does not tell it."""
_GROUPS: Mapping[str, str] = {
    "all": "everywhere",
    "shot": "in shot {}",
    "body": "of body number {}",
    "speed": "at speeds of {}",
    "direction": "in the direction of {}",
    "place": "around {}",
    "time": "at {} s",
    "since_contact": "{} s after a contact",
    "radius": "at {} px from the middle of the picture",
    "row": "at {} px below the middle of the picture",
}
_DIRECTIONS: Mapping[str, str] = {
    "along": "along the motion",
    "across": "across the motion",
    "waves": "slowly, as time goes by",
    "0": "along the first axis",
    "1": "along the second axis",
    "2": "along the third axis",
}


def named(cause: str) -> str:
    """An effect, a gauge or a verdict in words; a name that no table holds is words with underscores between them."""
    return CAUSES.get(cause, _spaced(cause))


def parameter(name: str) -> str:
    """A parameter in words; `effect.parameter` has its effect before it."""
    effect, _, own = name.rpartition(".")
    word = PARAMETERS.get(own, _spaced(own))
    return f"{named(effect)}, {word}" if effect else word


def phase(name: str) -> str:
    """Where something shows, to go on after a verb: at cushions."""
    return PHASES.get(name, f"in {_spaced(name)}")


def law(name: str) -> str:
    """A published law of cushions or balls, by its author and year."""
    return _spaced(name).capitalize()


def growing(name: str) -> str:
    """With what something grows."""
    return GROWING.get(name, _spaced(name))


def group(family: str, label: str) -> str:
    """A group of observations: where, when or of whom."""
    if family == "phase":
        return phase(label)
    return _GROUPS.get(family, f"at {_spaced(family)} {{}}").format(label)


def direction(name: str) -> str:
    """Which way something is off."""
    return _DIRECTIONS.get(name, _spaced(name))


def _spaced(name: str) -> str:
    return name.replace("_", " ")
