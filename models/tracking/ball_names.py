"""Names of balls as a person says them: the colour, and the number where the colours of the set leave no doubt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.ball_look import BallLook, describe_unseen_balls, format_colour, make_names_unique, parse_colour
from models.core.scene import Game
from models.core.typing import BoolArray, FloatArray

# L*, chroma and hue (degrees) of the paints of pool balls in neutral light, read off the makers' photographs; accurate
# to about 10.
PAINT = {
    "yellow": (78, 70, 82), "blue": (33, 50, 292), "red": (45, 66, 29), "purple": (33, 35, 312), "orange": (59, 70, 48),
    "green": (42, 36, 155), "maroon": (31, 32, 23), "brown": (43, 42, 53), "pink": (68, 47, 16),
}  # fmt: skip
ColourSet = tuple[tuple[str, ...], ...]
# Paints of the numbers 1 to 7, and of the stripes 9 to 15 (WPA equipment specifications, section 16).
STANDARD_SET: ColourSet = (("yellow",), ("blue",), ("red",), ("purple",), ("orange",), ("green",), ("maroon", "brown"))
# The same of sets whose 4 is pink, so that it differs from the 2 on a screen.
TELEVISION_SET: ColourSet = (*STANDARD_SET[:3], ("pink",), ("orange", "purple"), *STANDARD_SET[5:])
# Weight of lightness against chroma and hue: it changes most with the light.
LIGHTNESS_WEIGHT = 0.5
# Distance from the paint up to which, and least cost of every other assignment of the set from which, a colour gives a
# number: the errors of `PAINT` and of the light, twice and once. A wrong number is worse than none.
MAX_NUMBER_COST, MIN_NUMBER_MARGIN = 9.0, 7.0
# The same margin from which the set decides on the name of the colour; below it, the nearest paint does.
MIN_COLOUR_MARGIN = 2.0
# Reduction of the cost by which a set must look like one for television.
MIN_PINK_GAIN = 5.0
EIGHT = 8
# Number of the first colour of a set by class.
FIRST_NUMBERS = {"solid": 1, "stripe": 9}


def name_balls(
    ids: Sequence[str], kinds: Sequence[str], paint: FloatArray, is_certain: BoolArray, shows_class: BoolArray,
    game: Game,
) -> tuple[tuple[str, int], ...]:  # fmt: skip
    """Name balls.

    Args:
        ids: N ids.
        kinds: N ball classes.
        paint: (N, 3) CIE L*a*b* of their paint in neutral light; NaN where it is unknown.
        is_certain: (N,) whether a number may follow from the paint.
        shows_class: (N,) whether it is certain that a solid or stripe is one.
        game: Game that the table is for.

    Returns:
        N unique names, and the numbers of the balls; 0 where none is certain.
    """
    looks = list(describe_unseen_balls(ids, kinds))
    if game != "pool":
        return tuple((look.name, look.number) for look in looks)
    own = [[k for k, one in enumerate(kinds) if one == kind] for kind in FIRST_NUMBERS]
    shown = [[k for k in balls if np.isfinite(paint[k]).all()] for balls in own]
    colours = _choose_set([paint[balls] for balls in shown])
    for (kind, first), balls, painted in zip(FIRST_NUMBERS.items(), own, shown, strict=True):
        matched = dict(zip(painted, _match_set(paint[painted], colours), strict=True))
        for k in balls:
            colour, number = matched.get(k, ("", 0))
            number = number + first - 1 if number and is_certain[k] and shows_class[k] else 0
            pattern = "ball" if kind == "stripe" and not shows_class[k] else kind
            name = f"{colour} {number or pattern}".strip().removesuffix(" solid")
            looks[k] = BallLook(name, number=number)
    return tuple((look.name, look.number) for look in make_names_unique(looks))


def correct_looks(
    ids: Sequence[str], looks: Sequence[BallLook], corrected: Mapping[str, Mapping[str, Any]]
) -> tuple[BallLook, ...]:
    """Correct looks by those of a file in which a person changed some.

    Args:
        ids: N ids.
        looks: N looks.
        corrected: By id, `name`, `number` (0 for none) or `colour` (such as `#d63b3b`).

    Returns:
        N looks with the values that differ; a number that was changed alone gives the name of the standard set, and
        number 0 the name without one.
    """
    result = []
    for ball, look in zip(ids, looks, strict=True):
        own = corrected.get(ball, {})
        number, name = own.get("number", look.number), own.get("name", look.name)
        if number != look.number:
            standard = "black" if number == EIGHT else STANDARD_SET[number % EIGHT - 1][0]
            without = look.name.removesuffix(f" {look.number}") + " stripe" * look.is_striped
            name = name if name != look.name else f"{standard} {number}" if number else without
            look = replace(look, number=number, is_striped=number > EIGHT if number else look.is_striped)
        result.append(replace(look, name=name, colour=parse_colour(own.get("colour", format_colour(look.colour)))))
    return make_names_unique(result)


def _choose_set(paints: Sequence[FloatArray]) -> ColourSet:
    """Choose the set that the paints (n, 3) of solids and of stripes look like."""
    standard, television = (
        sum(_assign_colours(paint, colours)[0] for paint in paints) for colours in (STANDARD_SET, TELEVISION_SET)
    )
    return TELEVISION_SET if television < standard - MIN_PINK_GAIN else STANDARD_SET


def _match_set(paint: FloatArray, colours: ColourSet) -> list[tuple[str, int]]:
    """Match paints (n, 3) of solids, or of stripes, with a set: colour, and place in the set from 1; 0 if uncertain."""
    matched = []
    for own, slot, cost, margin in zip(paint, *_assign_colours(paint, colours)[1:], strict=True):
        names = colours[slot] if slot >= 0 and margin >= MIN_COLOUR_MARGIN else tuple(PAINT)
        is_certain = slot >= 0 and cost <= MAX_NUMBER_COST and margin >= MIN_NUMBER_MARGIN
        matched.append((min(names, key=lambda name: _distance(own, name)), slot + 1 if is_certain else 0))
    return matched


def _assign_colours(paint: FloatArray, colours: ColourSet) -> tuple[float, list[int], list[float], list[float]]:
    """Assign each colour of a set to at most one paint (n, 3).

    Returns:
        The total cost; per paint its colour (-1 for none), its cost, and how much more any other colour would cost.
    """
    n = len(paint)
    cost = np.full((n, len(colours) + n), 3 * MAX_NUMBER_COST)  # a ball may be none of the set
    for k, own in enumerate(paint):
        cost[k, : len(colours)] = [min(_distance(own, name) for name in names) for names in colours]
    total, columns = _solve(cost)
    margins = []
    for k in range(n):
        other = cost.copy()
        other[k, columns[k]] = 10 * other.max()
        margins.append(_solve(other)[0] - total)
    slots = [int(column) if column < len(colours) else -1 for column in columns]
    return total, slots, [float(cost[k, columns[k]]) for k in range(n)], margins


def _solve(cost: FloatArray) -> tuple[float, list[int]]:
    rows, columns = linear_sum_assignment(cost)
    return float(cost[rows, columns].sum()), columns.tolist()


def _distance(lab: FloatArray, name: str) -> float:
    """Return the distance of a colour (3,) from a paint: CIE 1994, with less weight of lightness."""
    lightness, chroma, hue = PAINT[name]
    own = float(np.hypot(lab[1], lab[2]))
    turn = 2 * np.sqrt(own * chroma) * np.sin((np.arctan2(lab[2], lab[1]) - np.radians(hue)) / 2)
    across = np.hypot((own - chroma) / (1 + 0.045 * chroma), turn / (1 + 0.015 * chroma))
    return float(np.hypot(LIGHTNESS_WEIGHT * (lab[0] - lightness), across))
