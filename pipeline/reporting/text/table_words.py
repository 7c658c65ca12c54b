"""Words for places on the table, with the names of the clip."""

from __future__ import annotations

from models.core.naming import Naming
from models.core.number_format import format_measured
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.ball_placement.ball_places import find_nearest_cushions, measure_cushion_distances

MAX_CM_DECIMALS = 1
"""Decimals of centimetres: nobody lays a ball to a tenth of a millimetre."""


def format_place(xy: FloatArray, sigma: float, table: Table, naming: Naming) -> str:
    """Format where a ball lies by its distances to a long and a short rail, the nearest of each.

    Args:
        xy: Centre (2,), m.
        sigma: Standard deviation per axis, m; NaN where it is unknown.
        table: The table.
        naming: What rails are called.

    Returns:
        Such as `12.0 cm from the near long rail and 64.0 cm from the left short rail, each ± 0.5 cm`.
    """
    own = measure_cushion_distances(table, xy[None])[0]
    nearest = find_nearest_cushions(own)[::-1]
    texts = [format_measured(100 * own[k], 100 * sigma, MAX_CM_DECIMALS) for k in nearest]
    names = [naming.say(CUSHIONS[k]) for k in nearest]
    places = " and ".join(f"{text} cm from {name}" for (text, _), name in zip(texts, names, strict=True))
    return places + (f", each ± {texts[0][1]} cm" if texts[0][1] else "")
