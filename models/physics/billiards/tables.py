"""Tables and balls on the market: sizes, how a user names a table, and which ball size that implies."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from decimal import Decimal

from models.core.errors import OptionError
from models.core.scene import BallSize, Game, Table


@dataclass(frozen=True, slots=True)
class BallSpecification:
    """Size and mass of a ball."""

    radius: float
    """m."""
    mass: float
    """kg."""
    tolerance: float
    """m, largest deviation of the radius."""


# 2 1/4 in (+ 0.127 mm), 5.5 to 6 oz (WPA equipment specifications, section 16).
POOL_BALL = BallSpecification(0.028575, 0.170, 6.35e-5)
# 52.5 +- 0.05 mm (WPBSA rules, section 1.2).
SNOOKER_BALL = BallSpecification(0.02625, 0.142, 2.5e-5)
# 52.3 mm, measured on sets for small tables; their spread is a guess.
CLUB_SNOOKER_BALL = BallSpecification(0.02615, 0.142, 1e-4)
# 61 to 61.5 mm, 205 to 220 g (UMB rules, article 12).
CAROM_BALL = BallSpecification(0.03075, 0.210, 2.5e-4)
# 2 in (WEPF blackball rules, equipment); the tolerance is a guess.
BLACKBALL_BALL = BallSpecification(0.0254, 0.118, 1e-4)
# 1 5/8 in, as most makers deliver with tables of 4 to 4 1/2 ft; others deliver 38 to 44 mm, hence the tolerance.
HOME_BALL = BallSpecification(0.0206, 0.064, 1.5e-3)
BALL_SPECIFICATIONS = (POOL_BALL, SNOOKER_BALL, CLUB_SNOOKER_BALL, CAROM_BALL, BLACKBALL_BALL, HOME_BALL)
# m, radii of balls.
BALL_RADIUS_RANGE = (0.01, 0.06)
# m, prior standard deviation of the offset of each cushion nose: errors of the calibration, and rubber that yields.
NOSE_SIGMA = 0.004

# Tables by name.
TABLE_PRESETS: dict[str, Table] = {}


def _add_preset(name: str, game: Game, length: float, width: float, ball: BallSpecification) -> None:
    TABLE_PRESETS[name] = Table(name, game, length, width, ball.radius, ball.mass, pockets=game != "carom")


# Playing surfaces between the noses: WPA equipment specifications section 2 (100 x 50 in, 88 x 44 in; BCA: 78 x 39 in;
# makers call 92 x 46 in a "pro" or "oversize" 8 ft),
# WPBSA rules section 1.1 (11 ft 8 1/2 in x 5 ft 10 in), UMB rules article 11 (2.84 x 1.42 m); the rest: makers' sheets.
_add_preset("pool-9ft", "pool", 2.54, 1.27, POOL_BALL)
_add_preset("pool-8ft", "pool", 2.2352, 1.1176, POOL_BALL)
_add_preset("pool-8ft-pro", "pool", 2.3368, 1.1684, POOL_BALL)
_add_preset("pool-7ft", "pool", 1.9812, 0.9906, POOL_BALL)
_add_preset("blackball-7ft", "pool", 1.8288, 0.9144, BLACKBALL_BALL)
_add_preset("blackball-6ft", "pool", 1.6764, 0.8382, BLACKBALL_BALL)
_add_preset("home-4ft", "pool", 1.22, 0.61, HOME_BALL)
_add_preset("snooker-12ft", "snooker", 3.569, 1.778, SNOOKER_BALL)
_add_preset("snooker-10ft", "snooker", 2.9, 1.45, SNOOKER_BALL)
_add_preset("snooker-9ft", "snooker", 2.54, 1.27, SNOOKER_BALL)
_add_preset("snooker-6ft", "snooker", 1.881, 0.943, CLUB_SNOOKER_BALL)
_add_preset("carom-match", "carom", 2.84, 1.42, CAROM_BALL)
_add_preset("carom-230", "carom", 2.30, 1.15, CAROM_BALL)
_add_preset("carom-210", "carom", 2.10, 1.05, CAROM_BALL)


def parse_table(text: str, ball_radius: float | None = None) -> Table:
    """Parse the table of an option.

    Args:
        text: Name of a preset, or `LENGTHxWIDTH` in metres.
        ball_radius: m; replaces the radius of the preset's balls.

    Returns:
        The table.

    Raises:
        OptionError: The text is neither, or a size is impossible.
    """
    name = text.strip().lower()
    table = TABLE_PRESETS.get(name)
    if table is None:
        table = _parse_size(name, text)
    if ball_radius is not None:
        table = replace_ball_radius(table, ball_radius)
    return table


def replace_ball_radius(table: Table, radius: float) -> Table:
    """Replace the balls of a table by balls of another radius and of the same material.

    Args:
        table: Table with balls of the usual size.
        radius: m.

    Returns:
        The table with the new radius and mass of a ball.

    Raises:
        OptionError: The radius is not that of a ball in metres.
    """
    if not BALL_RADIUS_RANGE[0] < radius < BALL_RADIUS_RANGE[1]:
        low, high = BALL_RADIUS_RANGE
        raise OptionError(
            f"balls are {2e3 * low:g} to {2e3 * high:g} mm in diameter, and not {2e3 * radius:g} mm", remedy="radius"
        )
    return replace(table, ball_radius=radius, ball_mass=scale_ball_mass(table, radius))


def scale_ball_mass(table: Table, radius: float) -> float:
    """Compute the mass of a ball of the table's material and another radius.

    Args:
        table: Table with the radius and mass of its usual balls.
        radius: m.

    Returns:
        kg; the mass grows with the cube of the radius.
    """
    return table.ball_mass * (radius / table.ball_radius) ** 3


def _parse_size(name: str, text: str) -> Table:
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*[x×*]\s*(\d+(?:\.\d*)?|\.\d+)\s*m?", name)
    if match is None:
        raise OptionError(
            f"a table is LENGTHxWIDTH in metres, such as 2.54x1.27, or one of {', '.join(TABLE_PRESETS)}; got {text!r}"
        )
    width, length = sorted(float(number) for number in match.groups())
    if not (0.5 < length < 5 and 0.3 * length < width):
        raise OptionError(f"a table is 0.5 to 5 m long and about half as wide; got {text!r}")
    return replace(find_nearest_preset(length), name=f"{length:g}x{width:g}", length=length, width=width)


def find_nearest_preset(length: float) -> Table:
    """Find the preset of the nearest length, whose balls a table has of which only the size is known.

    Args:
        length: Distance between the noses of the short cushions, m.

    Returns:
        The preset, unchanged.
    """
    return min(TABLE_PRESETS.values(), key=lambda table: abs(table.length - length))


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
        stated = f"stated, {2e3 * nominal.radius:g} mm in diameter"
        return f"The {what} {size} than {stated}: that or the size of the table may be wrong."
    return (
        f"The {what} {size} than those of a {table_name} table: its size may be wrong; state the table, or the size of"
        " its balls."
    )
