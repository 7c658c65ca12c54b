"""Explanations of one clip weighed together."""

import numpy as np
import pytest
from support.staged_rally import stage_rally

from models.estimation.rally.explain_rally import RallyExplanations, combine_explanations
from models.estimation.rally.rally_revision import Doubt
from models.sports.tennis import SPORT as TENNIS


def test_a_doubt_about_a_bounce_lowers_its_landing() -> None:
    rally = stage_rally(TENNIS, (22.0, 5.0))
    (landing,) = rally.landings
    sure = combine_explanations(RallyExplanations((rally,), np.zeros(1), ()))
    doubtful = combine_explanations(RallyExplanations((rally,), np.zeros(1), (Doubt("bounce", landing.t, 0.0),)))
    elsewhere = combine_explanations(RallyExplanations((rally,), np.zeros(1), (Doubt("bounce", landing.t - 0.2, 0.0),)))
    assert sure.landings[0].weight == elsewhere.landings[0].weight == pytest.approx(1.0)
    assert doubtful.landings[0].weight == pytest.approx(0.5)  # the other explanation is as good
    assert doubtful.no_landing == pytest.approx(0.5)
