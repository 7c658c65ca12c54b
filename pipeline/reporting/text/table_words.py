"""Words for places on the table, with the names of the clip."""

from __future__ import annotations

from models.core.naming import Naming
from models.core.number_format import format_measured
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.ball_placement.ball_places import find_nearest_cushions, measure_cushion_distances

# Segments of a long and a short rail between diamonds, from nose to nose; a snooker table has no diamonds.
DIAMONDS = {"pool": (8, 4), "carom": (8, 4), "snooker": None}
# Decimals of centimetres: nobody lays a ball to a tenth of a millimetre.
MAX_CM_DECIMALS = 1


def format_place(xy: FloatArray, sigma: float, table: Table, naming: Naming) -> str:
    """Format where a ball lies by the distances of its centre to a long and a short rail, the nearest of each.

    Args:
        xy: Centre (2,), m.
        sigma: Standard deviation per axis, m; NaN where it is unknown.
        naming: What rails are called.

    Returns:
        Such as `its centre 12.0 cm (0.4 diamonds) from the near long rail and 64.0 cm (2.0 diamonds) from the left
        short rail, each ± 0.5 cm`.
    """
    own = measure_cushion_distances(table, xy[None])[0]
    places, error = [], ""
    for k in find_nearest_cushions(own)[::-1]:
        text, error = format_measured(100 * own[k], 100 * sigma, MAX_CM_DECIMALS)
        text = text if error else f"{100 * own[k]:.{MAX_CM_DECIMALS}f}"
        diamonds, is_long = DIAMONDS[table.game], naming.view.is_long(CUSHIONS[k])
        size = diamonds and (table.width / diamonds[1] if is_long else table.length / diamonds[0])
        shown = f" ({own[k] / size:.1f} diamonds)" if size else ""
        places.append(f"{text} cm{shown} from {naming.say(CUSHIONS[k])}")
    return f"its centre {' and '.join(places)}{error and f', each ± {error} cm'}"
