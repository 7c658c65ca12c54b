"""What is known of a flight before it is seen can be divided by."""

from dataclasses import replace

import numpy as np
import pytest

from models.core.court import Range, Sport
from models.estimation.rally.single_flight import build_flight_prior
from models.sports.sport_catalogue import find_sports


@pytest.mark.parametrize("sport", find_sports().values(), ids=list(find_sports()))
def test_what_a_sport_knows_exactly_keeps_a_spread_that_fits_can_divide_by(sport: Sport) -> None:
    sure_object = replace(
        sport.object, drag_exponent=Range(0.0, 0.0), turn_drag=Range(0.0, 0.0), lift=0.0, lag_lift=0.0
    )
    assert np.all(build_flight_prior(replace(sport, object=sure_object)).sigma > 0)
