"""Tables and balls that are sold: sizes between the cushion noses, and how a user names one."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from models.core.errors import OptionError
from models.core.scene import Game, Table


@dataclass(frozen=True, slots=True)
class Ball:
    """Radius in m and mass in kg."""

    radius: float
    mass: float


POOL_BALL = Ball(0.028575, 0.170)
"""2 1/4 in, 5.5 to 6 oz (WPA equipment specifications, section 16)."""
SNOOKER_BALL = Ball(0.02625, 0.142)
"""52.5 mm (WPBSA rules, section 1.2)."""
CLUB_SNOOKER_BALL = Ball(0.02615, 0.142)
"""52.3 mm, measured on sets for small tables."""
CAROM_BALL = Ball(0.03075, 0.210)
"""61 to 61.5 mm, 205 to 220 g (UMB rules, article 12)."""
BLACKBALL_BALL = Ball(0.0254, 0.118)
"""2 in (WEPF blackball rules, equipment)."""

PRESETS: dict[str, Table] = {}


def _add(name: str, game: Game, length: float, width: float, ball: Ball) -> None:
    PRESETS[name] = Table(name, game, length, width, ball.radius, ball.mass, pockets=game != "carom")


# Playing surfaces between the noses: WPA equipment specifications section 2 (100 x 50 in, 88 x 44 in; BCA: 78 x 39 in;
# makers call 92 x 46 in a "pro" or "oversize" 8 ft),
# WPBSA rules section 1.1 (11 ft 8 1/2 in x 5 ft 10 in), UMB rules article 11 (2.84 x 1.42 m); the rest: makers' sheets.
_add("pool-9ft", "pool", 2.54, 1.27, POOL_BALL)
_add("pool-8ft", "pool", 2.2352, 1.1176, POOL_BALL)
_add("pool-8ft-pro", "pool", 2.3368, 1.1684, POOL_BALL)
_add("pool-7ft", "pool", 1.9812, 0.9906, POOL_BALL)
_add("blackball-7ft", "pool", 1.8288, 0.9144, BLACKBALL_BALL)
_add("blackball-6ft", "pool", 1.6764, 0.8382, BLACKBALL_BALL)
_add("snooker-12ft", "snooker", 3.569, 1.778, SNOOKER_BALL)
_add("snooker-10ft", "snooker", 2.9, 1.45, SNOOKER_BALL)
_add("snooker-9ft", "snooker", 2.54, 1.27, SNOOKER_BALL)
_add("snooker-6ft", "snooker", 1.881, 0.943, CLUB_SNOOKER_BALL)
_add("carom-match", "carom", 2.84, 1.42, CAROM_BALL)
_add("carom-230", "carom", 2.30, 1.15, CAROM_BALL)
_add("carom-210", "carom", 2.10, 1.05, CAROM_BALL)


def parse_table(text: str, ball_radius: float | None = None) -> Table:
    """The table of a preset's name, or of `LENGTHxWIDTH` in metres; `ball_radius` (m) replaces the preset's.

    OptionError if it is neither.
    """
    name = text.strip().lower()
    table = PRESETS.get(name)
    if table is None:
        table = _of_size(name, text)
    if ball_radius is not None:
        table = with_ball_radius(table, ball_radius)
    return table


def with_ball_radius(table: Table, radius: float) -> Table:
    """The same table with balls of another radius (m) and of the same material."""
    if not 0.01 < radius < 0.06:
        raise OptionError(f"a ball radius in metres is wanted, such as 0.028575; got {radius:g}")
    return replace(table, ball_radius=radius, ball_mass=table.ball_mass * (radius / table.ball_radius) ** 3)


def _of_size(name: str, text: str) -> Table:
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*[x×*]\s*(\d+(?:\.\d*)?|\.\d+)\s*m?", name)
    if match is None:
        raise OptionError(
            f"a table is LENGTHxWIDTH in metres, such as 2.54x1.27, or one of {', '.join(PRESETS)}; got {text!r}"
        )
    width, length = sorted(float(number) for number in match.groups())
    if not (0.5 < length < 5 and 0.3 * length < width):
        raise OptionError(f"a table is 0.5 to 5 m long and about half as wide; got {text!r}")
    return replace(nearest_preset(length), name=f"{length:g}x{width:g}", length=length, width=width)


def nearest_preset(length: float) -> Table:
    """The table that is sold whose length (m) is nearest: whose balls a table has of which only the size is known."""
    return min(PRESETS.values(), key=lambda table: abs(table.length - length))
