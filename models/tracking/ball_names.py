"""Names of balls as a person says them: the colour, and the number where the colours of the set leave no doubt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.ball_look import BallLook, describe_unseen_balls, make_names_unique
from models.core.scene import Game
from models.core.typing import BoolArray, FloatArray

PAINT = {
    "yellow": (78, 70, 82), "blue": (33, 50, 292), "red": (45, 66, 29), "purple": (33, 35, 312), "orange": (59, 70, 48),
    "green": (42, 36, 155), "maroon": (31, 32, 23), "brown": (43, 42, 53), "pink": (74, 35, 10),
}  # fmt: skip
"""L*, chroma and hue (degrees) of the paints of pool balls in neutral light, read off the makers' photographs; accurate
to about 10."""
STANDARD_SET = (("yellow",), ("blue",), ("red",), ("purple",), ("orange",), ("green",), ("maroon", "brown"))
"""Paints of the numbers 1 to 7, and of the stripes 9 to 15 (WPA equipment specifications, section 16)."""
TELEVISION_SET = (("yellow",), ("blue",), ("red",), ("pink",), ("orange", "purple"), ("green",), ("maroon", "brown"))
"""The same of sets whose 4 is pink, so that it differs from the 2 on a screen."""
LIGHTNESS_WEIGHT = 0.5
"""Weight of lightness against chroma and hue: it changes most with the light."""
MAX_NUMBER_COST, MIN_NUMBER_MARGIN = 18.0, 12.0
"""Distance from the paint up to which, and least cost of every other assignment of the set from which, a colour gives a
number: the errors of `PAINT` and of the light, twice and once. A wrong number is worse than none."""
MIN_COLOUR_MARGIN = 3.0
"""The same margin from which the set decides on the name of the colour; below it, the nearest paint does."""
MIN_PINK_GAIN = 12.0
"""Reduction of the cost by which a set must look like one for television."""
STRIPE_NUMBER = 8
"""Number of a stripe less that of the solid of the same colour."""


def name_balls(
    ids: Sequence[str], kinds: Sequence[str], paint: FloatArray, is_certain: BoolArray, game: Game
) -> tuple[tuple[str, int], ...]:
    """Name balls.

    Args:
        ids: N ids.
        kinds: N ball classes.
        paint: (N, 3) CIE L*a*b* of their paint in neutral light; NaN where it is unknown.
        is_certain: (N,) whether a number may follow from the paint.
        game: Game that the table is for.

    Returns:
        N unique names, and the numbers of the balls; 0 where none is certain.
    """
    looks = list(describe_unseen_balls(ids, kinds))
    if game == "pool":
        for kind, first in (("solid", 0), ("stripe", STRIPE_NUMBER)):
            own = [k for k, one in enumerate(kinds) if one == kind and np.isfinite(paint[k]).all()]
            for k, (colour, matched) in zip(own, _match_set(paint[own]), strict=True):
                number = matched if is_certain[k] else 0
                name = f"{colour} {number + first}" if number else f"{colour} {kind}".removesuffix(" solid")
                looks[k] = BallLook(name, number=number + first if number else 0)
    return tuple((look.name, look.number) for look in make_names_unique(looks))


def _match_set(paint: FloatArray) -> list[tuple[str, int]]:
    """Match paints (n, 3) of solids, or of stripes, with the colours of a set: colour and number, 0 if uncertain."""
    if not len(paint):
        return []
    standard, television = (_assign_colours(paint, one) for one in (STANDARD_SET, TELEVISION_SET))
    is_television = television[0] < standard[0] - MIN_PINK_GAIN
    _, slots, costs, margins = television if is_television else standard
    colours = TELEVISION_SET if is_television else STANDARD_SET
    matched = []
    for own, slot, cost, margin in zip(paint, slots, costs, margins, strict=True):
        names = colours[slot] if slot >= 0 and margin >= MIN_COLOUR_MARGIN else tuple(PAINT)
        is_certain = slot >= 0 and cost <= MAX_NUMBER_COST and margin >= MIN_NUMBER_MARGIN
        matched.append((min(names, key=lambda name: _distance(own, name)), slot + 1 if is_certain else 0))
    return matched


def _assign_colours(
    paint: FloatArray, colours: Sequence[tuple[str, ...]]
) -> tuple[float, list[int], list[float], list[float]]:
    """Assign each colour of a set to at most one paint (n, 3).

    Returns:
        The total cost; per paint its colour (-1 for none), its cost, and how much more any other colour would cost.
    """
    cost = np.array([[min(_distance(own, name) for name in names) for names in colours] for own in paint])
    n, free = len(paint), np.full((len(paint), len(paint)), 3 * MAX_NUMBER_COST)
    cost = np.hstack([cost, free])  # a ball may be none of the set
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
    """Return the distance of a colour (3,) from a paint."""
    lightness, chroma, hue = PAINT[name]
    reference = np.array([lightness, chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))])
    return float(np.linalg.norm((lab - reference) * [LIGHTNESS_WEIGHT, 1.0, 1.0]))
