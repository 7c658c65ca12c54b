"""The physics of a table from whole shots: true parameters within their errors, and the right contact model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import SIGMA, TABLE, filmed, numbers

from models.estimation.multiple_shooting.shooting_fit import ShootingFit
from models.estimation.whole_shot.continuation_fit import fit_if_explained
from models.estimation.whole_shot.shot_segments import ShotSegment, estimate_initial_states
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.estimation.whole_shot.table_fit import TableFit, search_laws, table_priors
from models.physics.billiards.simulation.parametrised_shot import SHOT_PARAMETERS, ContactModels

MIRROR, HAN = ContactModels("mirror", "inelastic"), ContactModels("han_2005", "inelastic")


def shots_from_observations(seed: int, laws: ContactModels, count: int = 3) -> tuple[ShotSegment, ...]:
    """Shots with initial states estimated from observations."""
    rng, values, result = np.random.default_rng(seed), numbers(), []
    for shot in range(count):
        one = filmed(rng, values, shot, 2.0, laws)
        start, moving = estimate_initial_states(one.t, one.xy, np.full(one.xy.shape[:2], SIGMA))
        result.append(replace(one, start=start, moving=moving, image_row=None, dropped_frame_delay=None))
    return tuple(result)


def fit_candidates(*candidates: ContactModels) -> TableFit:
    return search_laws(shots_from_observations(1, MIRROR), TABLE, candidates=candidates, is_sampled=False).best


def test_shots_identify_the_parameters_of_their_table() -> None:
    fitted = fit_candidates(MIRROR)
    assert fitted.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    truth = numbers()
    for parameter in fitted.parameters:
        assert abs(parameter.value - truth[SHOT_PARAMETERS.index(parameter.name)]) < 4 * parameter.sigma, parameter.name
        assert parameter.sigma > 0
    restitution = next(one for one in fitted.parameters if one.name == "cushion_restitution.e")
    assert restitution.value == pytest.approx(0.85, abs=0.005)


@pytest.mark.slow
def test_shots_select_the_contact_model_of_their_cushions() -> None:
    fitted = fit_candidates(HAN, MIRROR)
    assert [laws for laws, _ in fitted.evidence] == [MIRROR, HAN]
    assert fitted.evidence[0][1] - fitted.evidence[1][1] > 20


def test_only_parameters_of_the_contact_models_are_fitted() -> None:
    names = {prior.name for prior in table_priors(ContactModels("mirror", "alciatore"))}
    assert "ball_friction.mu" not in names
    assert "cushion_restitution_power.power" not in names
    assert {"sliding_friction.mu", "cushion_friction.mu", "ball_restitution.e", "nose.left"} <= names


def test_models_without_a_decisive_reason_against_them_explain_the_shots_as_well() -> None:
    stronge = ContactModels("stronge", "inelastic")
    fitted = TableFit(MIRROR, (), 1.0, True, (), (), ((MIRROR, -90.0), (HAN, -92.0), (stronge, -120.0)))
    assert fitted.equal_models == ("han_2005",)


def test_nothing_to_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="got none"):
        search_laws((), TABLE)


def test_a_fit_stops_where_a_contact_model_cannot_explain_the_shot() -> None:
    segments = shots_from_observations(1, MIRROR, 1)
    for laws, explains in ((MIRROR, True), (ContactModels("stronge", "inelastic"), False)):
        model = ShotWindows(segments, TABLE, table_priors(laws), laws)
        usual = np.array([prior.value for prior in model.unknowns])
        result = fit_if_explained(model, usual, np.random.default_rng(0))
        assert isinstance(result, ShootingFit) == explains, laws
