"""Ball sizes that a user typed or a table implies, and the sentence on other estimates that contradict them."""

from __future__ import annotations

import math
from decimal import Decimal

from models.core.scene import BallSize, Table
from models.physics.billiards.tables import BALL_SPECIFICATIONS

# Largest relative standard deviation of a radius that the user typed, whatever its number of digits.
MAX_TYPED_SHARE = 0.005


def estimate_typed_ball_size(radius: float) -> BallSize:
    """Make the estimate of a radius that the user typed.

    Args:
        radius: m.

    Returns:
        The radius with half a unit of its last digit as standard deviation, at most `MAX_TYPED_SHARE` of it.
    """
    exponent = Decimal(repr(float(radius))).as_tuple().exponent
    half_unit = 0.5 * 10.0 ** int(exponent)
    return BallSize(radius, min(half_unit, MAX_TYPED_SHARE * radius), "user")


def estimate_preset_ball_size(table: Table) -> BallSize:
    """Estimate the size of a table's balls from the specification of its game.

    Args:
        table: A preset, or a table of another size with the balls of the nearest preset.

    Returns:
        The nominal radius; its standard deviation is that of a uniform distribution within the tolerance.
    """
    nominal = table.ball_radius
    tolerance = max((ball.tolerance for ball in BALL_SPECIFICATIONS if ball.radius == nominal), default=0.0)
    return BallSize(nominal, tolerance / math.sqrt(3), "preset")


def format_contradiction(nominal: BallSize, other: BallSize, table_name: str) -> str:
    """Format a contradiction as a sentence for the user.

    Args:
        nominal: Estimate of the user or of a preset.
        other: Estimate from images or contacts.

    Returns:
        The sentence, with a remedy.
    """
    change = round(100 * (other.radius / nominal.radius - 1))
    what = "balls look" if other.source == "image" else "distances of touching balls make the balls"
    size = f"{abs(change)} % {'larger' if change > 0 else 'smaller'}"
    if nominal.source == "user":
        return f"The {what} {size} than --ball-radius {nominal.radius:g}: it or the size of the table may be wrong."
    return (
        f"The {what} {size} than those of a {table_name} table: its size may be wrong; give --table or --ball-radius."
    )
