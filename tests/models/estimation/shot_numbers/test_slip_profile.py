"""The profile over top spin states how little a strike that soon rolls shows."""

from __future__ import annotations

import numpy as np
from support.filmed_pot import SCENE, film_pot, true_numbers

from models.estimation.forecast.solution_state import collect_captured_observations, inflate_covariance
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.shot_numbers.posterior_view import PosteriorView
from models.estimation.shot_numbers.shot_course import list_shot_courses
from models.estimation.shot_numbers.strike_numbers import SlipProfile, profile_slip


def profile_of(seed: int) -> SlipProfile:
    tracks = film_pot(seed)
    explained = explain(tracks, SCENE)
    fit, solution = view_shot(explained), explained.solution
    assert solution is not None
    (course,) = list_shot_courses(solution.graph, 0, lambda _ball, _t: True)
    view = PosteriorView(solution, inflate_covariance(solution, 1.0), SCENE.table.ball_radius)
    observations = collect_captured_observations(tracks, fit.trajectory.clock, SCENE.table)
    profile = profile_slip(view, observations, course.segments[0][0], 1.0, (0.2, 0.1))
    assert profile is not None
    return profile


def test_speed_and_spin_lie_within_the_profile() -> None:
    truth = true_numbers()
    speeds, shares = [], []
    for seed in range(4):
        one = profile_of(seed)
        speeds.append((one.speed - truth["cue_speed"]) / one.speed_sigma)
        shares.append((one.share - truth["top_spin_share"]) / one.share_sigma)
        assert one.share_sigma < 0.2
    assert np.abs([*speeds, *shares]).max() < 3.5
    assert np.sqrt(np.mean(np.square([*speeds, *shares]))) < 2.0
