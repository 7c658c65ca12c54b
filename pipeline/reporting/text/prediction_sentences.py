"""Sentences about the predicted rest of a shot, and about places on the table."""

from __future__ import annotations

import numpy as np

from models.core.naming import Naming
from models.core.number_format import (
    EXTREME_PROBABILITY,
    format_doubt,
    format_measured,
    format_moment,
    format_probability,
    format_time,
)
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.ball_places import find_nearest_cushions, measure_cushion_distances
from models.estimation.forecast.ensemble_prediction import ShotPrediction
from pipeline.reporting.text.text_formatting import format_meeting, start_sentence

# Segments of a long and a short rail between diamonds, from nose to nose; a snooker table has no diamonds.
DIAMONDS = {"pool": (8, 4), "carom": (8, 4), "snooker": None}
# Decimals of centimetres: nobody lays a ball to a tenth of a millimetre.
MAX_CM_DECIMALS = 1
# m, largest displacement of a ball that is described as staying at rest.
MAX_REST_SHIFT = 0.005
# Least probability of an event that a sentence mentions.
MIN_REPORTED_PROBABILITY = 0.1
# Probability above which the time of an event is that of the first contact in most plays.
MIN_TIMED_PROBABILITY = 0.5
# Least probability of a pot that a sentence mentions.
MIN_REPORTED_POT = 0.02


def format_ball_prediction(prediction: ShotPrediction, k: int, naming: Naming) -> str:
    """Format the prediction of one ball as a sentence.

    Args:
        k: Index of the ball.
        naming: What balls, rails and pockets are called.

    Returns:
        Such as `The cue ball keeps moving, touches red 3 first (97 %); it comes to rest at 2.31 s ± 40 ms, its centre
        12 cm (0.4 diamonds) from the near long rail and 64 cm (2.0 diamonds) from the left short rail, each ± 2 cm.`
    """
    state, table = prediction.state, prediction.state.table
    name = start_sentence(naming.say(state.ids[k]))
    moves = state.moving[k]
    times = {frozenset(one.event): f" at {format_time(one.t, one.t_sigma)}" for one in prediction.events}
    contacts = []
    for event, p in prediction.first_contacts[k][:2]:
        kind, _, other = event
        met = f"{format_meeting(kind, other, naming)}{' first' * (kind != 'pocket')}"
        what = met if moves else f"{naming.say(other)} touches it"
        when = times.get(frozenset(event), "") if p > MIN_TIMED_PROBABILITY else ""
        contacts += [f"{what}{when}{format_doubt(p)}"] * (p >= MIN_REPORTED_PROBABILITY)
    here = prediction.path[0, k]
    if stays_at_rest(prediction, k):
        moved = np.hypot(*(np.nan_to_num(prediction.members[:, -1, k], nan=9.0) - here).T)
        stays = format_doubt(float(np.mean(moved < MAX_REST_SHIFT)))
        unless = f", unless {' or '.join(contacts)}" if contacts else ""
        return f"{name} stays at rest{stays}, {format_place(here, np.nan, table, naming)}{unless}."
    begin = f"{name} {'keeps moving' if moves else 'is at rest'}"
    left = 1 - sum(p for _, p in prediction.first_contacts[k])
    if contacts:
        begin += f"{',' if moves else ' until'} {' or '.join(contacts)}"
        nothing = "touches nothing" if moves else "nothing touches it"
        begin += f", or {nothing} ({format_probability(left)})" if left >= MIN_REPORTED_PROBABILITY else ""
    potted = 1 - float(prediction.on_table[-1, k])
    if potted > 1 - EXTREME_PROBABILITY:
        return f"{begin}, and is potted."
    rest = next((one for one in prediction.events if one.event == ("rest", state.ids[k], "")), None)
    when = f"at {format_moment(prediction.t[-1])} it has"
    if rest is not None and rest.probability >= 0.5:
        when = f"it comes to rest at {format_time(rest.t, rest.t_sigma)}{format_doubt(rest.probability)},"
    place = format_place(prediction.path[-1, k], float(prediction.sigma[-1, k]), table, naming)
    unless = f", unless it is potted ({format_probability(potted)})" if potted >= MIN_REPORTED_POT else ""
    return f"{begin}; {when} {place}{unless}."


def stays_at_rest(prediction: ShotPrediction, k: int) -> bool:
    """Return whether a ball rests and probably nothing touches it.

    Its predicted place is then where it lies, not the mean over all simulated plays, a few of which may move it.
    """
    return not prediction.state.moving[k] and sum(p for _, p in prediction.first_contacts[k]) < 0.5


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
