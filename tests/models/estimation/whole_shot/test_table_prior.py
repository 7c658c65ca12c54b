"""A table with known physics: the fit of its next shot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import SIGMA, TABLE, filmed, numbers

from models.estimation.whole_shot.known_table import build_table_prior
from models.estimation.whole_shot.shot_segments import estimate_initial_states
from models.estimation.whole_shot.table_fit import search_laws, table_priors
from models.physics.billiards.simulation.parametrised_shot import ContactModels

KNOWN = {
    "sliding_friction.mu": (0.2, 0.002), "rolling_resistance.mu": (0.01, 0.0001), "spin_decay.rate": (10.0, 0.5),
    "cushion_restitution.e": (0.85, 0.002), "cushion_friction.mu": (0.17, 0.002), "ball_restitution.e": (0.95, 0.002),
    "ball_friction.mu": (0.05, 0.002),
}  # fmt: skip


def test_further_effects_of_a_table_are_fitted_with_the_default_ones() -> None:
    table = build_table_prior(
        "mirror", "inelastic", {"slope.slope_x": (1.5, 0.1), "rolling_resistance.mu": (0.008, None)}
    )
    usual = table_priors(table.laws)
    result = {prior.name: prior for prior in table.merge_priors(usual)}
    assert set(result) == {prior.name for prior in usual} | {"slope.slope_x"}
    assert (result["slope.slope_x"].value, result["slope.slope_x"].sigma) == (1.5, 0.1)
    assert result["rolling_resistance.mu"].value == 0.008
    assert result["rolling_resistance.mu"].sigma == pytest.approx(0.004)


def test_parameters_of_other_contact_models_are_not_fitted() -> None:
    table = build_table_prior("mirror", "elastic", {"ball_friction.mu": (0.05, 0.01)})
    assert "ball_friction.mu" not in {prior.name for prior in table.merge_priors(table_priors(table.laws))}


def test_an_unknown_parameter_name_is_refused() -> None:
    with pytest.raises(ValueError, match="lens"):
        build_table_prior("mirror", "inelastic", {"lens_distortion.k1": (0.1, 0.01)})


def test_one_shot_on_a_known_slope_is_explained_with_it() -> None:
    values = numbers(slope__slope_x=2.0)
    one = filmed(np.random.default_rng(3), values, 0, 1.2, ContactModels())
    start, moving = estimate_initial_states(one.t, one.xy, np.full(one.xy.shape[:2], SIGMA))
    segment = replace(one, start=start, moving=moving, image_row=None, dropped_frame_delay=None)
    fitted = search_laws(
        (segment,), TABLE, build_table_prior("mirror", "inelastic", {**KNOWN, "slope.slope_x": (2.1, 0.2)})
    ).best
    by_name = {parameter.name: parameter for parameter in fitted.parameters}
    assert fitted.is_explained
    assert abs(by_name["slope.slope_x"].value - 2.0) < 4 * by_name["slope.slope_x"].sigma
    assert by_name["slope.slope_x"].sigma < 0.2
    assert by_name["rolling_resistance.mu"].sigma <= 0.0001
