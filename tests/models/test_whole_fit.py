"""The physics of a table from whole shots: what is true is found again within its errors, and the law is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import SIGMA, TABLE, filmed, numbers

from models.estimation.multiple_shooting.shooting_fit import ShootingOptions
from models.estimation.whole_shot.continuation_fit import grown_if_lawful
from models.estimation.whole_shot.initial_states import beginning
from models.estimation.whole_shot.shot_segments import Stretch
from models.estimation.whole_shot.shot_windows import Shots
from models.estimation.whole_shot.table_fit import fit_table, numbers_of, unknowns_of
from models.physics.billiards.simulation.parametrised_shot import NUMBERS, Laws

MIRROR, HAN = Laws("mirror", "inelastic"), Laws("han_2005", "inelastic")


def seen_shots(seed: int, laws: Laws, count: int = 3) -> tuple[Stretch, ...]:
    """Shots that are begun from what was seen alone."""
    rng, values, found = np.random.default_rng(seed), numbers(), []
    for shot in range(count):
        one = filmed(rng, values, shot, 2.0, laws)
        start, moving = beginning(one.t, one.xy, np.full(one.xy.shape[:2], SIGMA))
        found.append(replace(one, start=start, moving=moving, row=None, late=None))
    return tuple(found)


def test_shots_tell_the_numbers_of_their_table() -> None:
    fitted = fit_table(seen_shots(1, MIRROR), TABLE, (MIRROR,))
    assert fitted.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    truth = numbers()
    for parameter in fitted.parameters:
        assert abs(parameter.value - truth[NUMBERS.index(parameter.name)]) < 4 * parameter.sigma, parameter.name
        assert parameter.sigma > 0
    values = numbers_of(fitted)
    assert values[NUMBERS.index("cushion_restitution.e")] == pytest.approx(0.85, abs=0.005)


@pytest.mark.slow
def test_shots_name_the_law_of_their_cushions() -> None:
    fitted = fit_table(seen_shots(1, MIRROR), TABLE, (HAN, MIRROR))
    assert [laws for laws, _ in fitted.evidence] == [MIRROR, HAN]
    assert fitted.evidence[0][1] - fitted.evidence[1][1] > 20


def test_only_what_the_laws_look_at_is_sought() -> None:
    names = {prior.name for prior in unknowns_of(Laws("mirror", "alciatore"))}
    assert "ball_friction.mu" not in names
    assert "cushion_restitution_power.power" not in names
    assert {"sliding_friction.mu", "cushion_friction.mu", "ball_restitution.e", "nose.left"} <= names


def test_nothing_to_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="0 stretches"):
        fit_table((), TABLE)


def test_a_search_is_given_up_under_a_law_that_cannot_explain_the_shot() -> None:
    stretches, options = seen_shots(1, MIRROR, 1), ShootingOptions()
    for laws, explains in ((MIRROR, True), (Laws("stronge", "inelastic"), False)):
        model = Shots(stretches, TABLE, unknowns_of(laws), laws)
        usual = np.array([prior.value for prior in model.unknowns])
        found = grown_if_lawful(model, usual, np.random.default_rng(0), options)
        assert (found is not None) == explains, laws
