"""Continuation fit of one shot: it explains any spin from the observations alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import LAWS, SIGMA, TABLE, filmed, numbers

from models.estimation.whole_shot.continuation_fit import ShotGuess, fit_by_continuation, is_explained, next_view_time
from models.estimation.whole_shot.shot_segments import estimate_initial_states
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.estimation.whole_shot.table_fit import table_priors
from models.physics.billiards.simulation.parametrised_shot import pack_start


def shot_from_observations(seed: int, seconds: float = 4.0) -> tuple[ShotWindows, np.ndarray]:
    """A shot with initial states estimated from observations, and the true states (N, 7)."""
    one = filmed(np.random.default_rng(seed), numbers(), 0, seconds, LAWS)
    start, moving = estimate_initial_states(one.t, one.xy, np.full(one.xy.shape[:2], SIGMA))
    segment = replace(one, start=start, moving=moving, image_row=None, dropped_frame_delay=None)
    return ShotWindows((segment,), TABLE, table_priors(LAWS), LAWS), one.start


def prior_values(model: ShotWindows) -> np.ndarray:
    return np.array([prior.value for prior in model.unknowns])


@pytest.mark.parametrize("seed", range(4))
def test_a_shot_is_explained_with_the_spin_that_no_frame_shows(seed: int) -> None:
    model, truth = shot_from_observations(seed)
    result = fit_by_continuation(model, prior_values(model), np.random.default_rng(0))
    # the predicted decrease beside a kink of the loss depends on the last bits, and so on the processor
    assert result.chi2_per_dof == pytest.approx(1.0, abs=0.15)
    pulls = (result.starts[0][:7] - truth[0]) / np.sqrt(np.diag(result.start_covariances[0])[:7])
    assert np.all(np.abs(pulls) < 4), pulls


def test_the_fitted_part_grows_past_the_next_contact_and_then_to_the_end() -> None:
    model, truth = shot_from_observations(1)
    now = ShotGuess((pack_start(truth, model.segments[0].moving),), prior_values(model))
    run = model.simulate_possible_run(0, now.starts[0], now.shared)
    assert run is not None
    times = run.contacts[:, 1]
    view = next_view_time(model, now, 0.0)
    assert times[0] < view < 4.0
    assert next_view_time(model, now, float(times[-1])) == model.segments[0].t[-1]


def test_a_wrong_slip_does_not_explain_later_observations() -> None:
    model = shot_from_observations(1)[0]
    best = fit_by_continuation(model, prior_values(model), np.random.default_rng(0))
    assert is_explained(model, ShotGuess(best.starts, best.shared), 1.0)
    wrong = best.starts[0].copy()
    wrong[4:6] = -wrong[4:6]
    assert not is_explained(model, ShotGuess((wrong,), best.shared), 1.0)


def test_a_simulated_window_equals_a_linearized_one() -> None:
    model, truth = shot_from_observations(2)
    start = pack_start(truth, model.segments[0].moving)
    glance, flow = model.simulate(0, start, prior_values(model)), model.linearize(0, start, prior_values(model))
    np.testing.assert_array_equal(glance.residual, flow.residual)
    assert glance.event_order == flow.event_order
