"""What is known of a flight before it is seen can be divided by."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.drawn_courts import aim_camera

from models.core.court import Range, Sport
from models.estimation.rally import single_flight
from models.estimation.rally.flight_observations import prepare_observations
from models.estimation.rally.single_flight import build_flight_prior
from models.sports.sport_catalogue import find_sports


@pytest.mark.parametrize("sport", find_sports().values(), ids=list(find_sports()))
def test_what_a_sport_knows_exactly_keeps_a_spread_that_fits_can_divide_by(sport: Sport) -> None:
    sure_object = replace(
        sport.object, drag_exponent=Range(0.0, 0.0), turn_drag=Range(0.0, 0.0), lift=0.0, lag_lift=0.0
    )
    assert np.all(build_flight_prior(replace(sport, object=sure_object)).sigma > 0)


# Where a search ended on a lob that was followed by a bird: the lift is 33 standard deviations from its prior, so that
# small changes turn the path anywhere.
CHAOTIC = np.array([6.7, 3.05, 2.0, 4.0183, -4.8514, 4.7889, 0.3559, -1.9775, 0.3122, 0.7774, 11.006, -0.4341, 1.2298])


@pytest.mark.parametrize(("shift", "is_flight"), [(0.0, False), (1.0, True)])
def test_a_law_that_turns_its_path_anywhere_is_no_flight(
    shift: float, is_flight: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    sport, t = find_sports()["badminton"], np.arange(37) / 25
    prior = build_flight_prior(sport)
    point = CHAOTIC + shift * (prior.mean - CHAOTIC)
    monkeypatch.setattr(single_flight, "minimize_residuals", lambda *_: SimpleNamespace(point=point, cost=1.0))
    camera = aim_camera((-12.0, 3.0, 7.0), (6.0, 3.05, 0.0), 1650, is_left_handed=True)
    px = camera.to_pixels(np.column_stack([np.linspace(-3, -1, 37), np.full(37, -3.0), np.full(37, 2.0)]))
    observed = prepare_observations(camera, np.arange(37), t, px, 0 * px, np.full_like(px, 0.7))
    assert (single_flight.fit_single_flight(observed, sport, prior) is not None) == is_flight
