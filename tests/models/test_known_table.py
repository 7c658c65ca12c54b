"""A table that is known beforehand: what a fit of the next shot makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import SIGMA, TABLE, filmed, numbers

from models.estimation.whole_shot.initial_states import beginning
from models.estimation.whole_shot.table_fit import fit_known, unknowns_of
from models.estimation.whole_shot.table_prior import known_table
from models.physics.billiards.simulation.parametrised_shot import Laws

KNOWN = {
    "sliding_friction.mu": (0.2, 0.002), "rolling_resistance.mu": (0.01, 0.0001), "spin_decay.rate": (10.0, 0.5),
    "cushion_restitution.e": (0.85, 0.002), "cushion_friction.mu": (0.17, 0.002), "ball_restitution.e": (0.95, 0.002),
    "ball_friction.mu": (0.05, 0.002),
}  # fmt: skip


def test_further_effects_of_a_table_are_sought_with_the_usual_ones() -> None:
    table = known_table("mirror", "inelastic", {"slope.slope_x": (1.5, 0.1), "rolling_resistance.mu": (0.008, None)})
    usual = unknowns_of(table.laws)
    found = {prior.name: prior for prior in table.among(usual)}
    assert set(found) == {prior.name for prior in usual} | {"slope.slope_x"}
    assert (found["slope.slope_x"].value, found["slope.slope_x"].sigma) == (1.5, 0.1)
    assert found["rolling_resistance.mu"].value == 0.008
    assert found["rolling_resistance.mu"].sigma == pytest.approx(0.004)


def test_what_the_laws_do_not_look_at_is_not_sought() -> None:
    table = known_table("mirror", "elastic", {"ball_friction.mu": (0.05, 0.01)})
    assert "ball_friction.mu" not in {prior.name for prior in table.among(unknowns_of(table.laws))}


def test_a_name_that_no_table_has_is_refused() -> None:
    with pytest.raises(ValueError, match="lens"):
        known_table("mirror", "inelastic", {"lens_distortion.k1": (0.1, 0.01)})


def test_one_shot_on_a_known_slope_is_explained_with_it() -> None:
    values = numbers(slope__slope_x=2.0)
    one = filmed(np.random.default_rng(3), values, 0, 1.2, Laws())
    start, moving = beginning(one.t, one.xy, np.full(one.xy.shape[:2], SIGMA))
    stretch = replace(one, start=start, moving=moving, row=None, late=None)
    fitted = fit_known((stretch,), TABLE, known_table("mirror", "inelastic", {**KNOWN, "slope.slope_x": (2.1, 0.2)}))
    told = {parameter.name: parameter for parameter in fitted.parameters}
    assert fitted.explained
    assert abs(told["slope.slope_x"].value - 2.0) < 4 * told["slope.slope_x"].sigma
    assert told["slope.slope_x"].sigma < 0.2
    assert told["rolling_resistance.mu"].sigma <= 0.0001
