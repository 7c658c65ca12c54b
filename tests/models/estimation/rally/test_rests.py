"""An object that lies still is no flight, and one that flies is no rest."""

import numpy as np

from models.core.rally import FLIGHT_PARAMETERS, Flight
from models.estimation.rally.flight_observations import find_rests


def test_an_object_rests_before_and_after_it_moves():
    rng = np.random.default_rng(1)
    moving = 100 + 9.0 * np.arange(20)[:, None] * [1, -1]
    px = np.concatenate([np.tile([100.0, 50], (10, 1)), moving, np.full((10, 2), 300.0)])
    resting = find_rests(px + 0.7 * rng.standard_normal(px.shape), np.arange(40) / 25)
    assert resting[:9].all()
    assert not resting[12:28].any()
    assert resting[31:].all()


def test_a_few_frames_at_an_apex_are_no_rest():
    t = np.arange(40) / 50
    px = np.stack([20 * t, 400 * (t - 0.4) ** 2], axis=1)  # 400 px/s^2 up and down, slowly along
    assert not find_rests(px, t).any()


def test_two_places_alone_are_no_rest():
    """An object that nobody saw between may have flown away and come back."""
    px = np.full((12, 2), 100.0)
    sparse = np.array([0.0, 2.0, 4.0, *(6 + np.arange(9) / 25)])
    assert find_rests(px, sparse).tolist() == [False] * 3 + [True] * 9


def test_a_flight_saved_before_the_law_grew_has_the_new_parameters_at_zero():
    flight = Flight(0.0, 1.0, np.arange(11.0), np.eye(11), True, 1.0)
    assert flight.parameters.tolist() == [*range(11), 0, 0]
    assert flight.covariance.shape == (len(FLIGHT_PARAMETERS),) * 2
    assert np.trace(flight.covariance) == 11
