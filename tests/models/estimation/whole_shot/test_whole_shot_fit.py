"""Contact models and spin of whole shots, from tracks and the fit of their segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.simulated_shots import LAWS, SIGMA, TABLE, numbers, opening

from models.core.fit_result import Fit, Trust
from models.core.options import FitOptions
from models.core.tracks import Tracks
from models.estimation.whole_shot import whole_shot_fit
from models.estimation.whole_shot.whole_shot_fit import MAX_CHI2, fit_shot_laws
from models.physics.billiards.simulation.parametrised_shot import convert_to_states, pack_start, simulate_start

SECONDS = 4.0


def simulate_fit(seed: int) -> tuple[Fit, Tracks, np.ndarray]:
    """A fit and tracks as from the pipeline, and the true state (7,) of the cue ball at the strike."""
    rng = np.random.default_rng(seed)
    start, moving = opening(rng)
    run = simulate_start(pack_start(start, moving), moving, TABLE, numbers(), LAWS, SECONDS)
    t = np.arange(round(60 * SECONDS)) / 60
    xy = run.states_at(t)[..., :2] + SIGMA * rng.normal(size=(len(t), 3, 2))
    sigma, none = np.full((len(t), 3), SIGMA), np.zeros((len(t), 3, 2))
    tracks = Tracks(
        np.arange(len(t)), t, run.balls.ids, ("ball",) * 3, xy, xy, sigma, sigma, none, 30 + 0 * sigma,
        np.zeros((3, 3)),
    )  # fmt: skip
    speed = np.hypot(*np.moveaxis(run.states_at(t)[..., 2:4], -1, 0))
    everywhere = np.ones(speed.shape, bool)
    fit = Fit(run.events, run.to_trajectory(), (), SIGMA, 1.0, none, speed > 0.02, everywhere, Trust("green", ()))
    return fit, tracks, convert_to_states(start, TABLE.ball_radius)[0][0]


def test_a_whole_shot_identifies_its_contact_model_and_initial_spin() -> None:
    fit, tracks, truth = simulate_fit(3)
    laws = fit_shot_laws(fit, tracks, TABLE, FitOptions()).solution
    assert laws is not None
    assert (laws.cushion_model, laws.ball_model) == ("mirror", "inelastic")
    assert 0.4 < laws.chi2_per_dof < 1.2
    cue = laws.ids.index("0")
    pull = (laws.state[cue] - truth) / np.sqrt(np.diag(laws.covariance[cue]))
    assert np.all(np.abs(pull) < 4), pull
    e = next(p for p in laws.parameters if p.name == "cushion_restitution.e")
    assert not e.prior_only
    assert abs(e.value - 0.85) < 4 * e.sigma


def test_a_shot_without_explanation_reports_its_misfit() -> None:
    fit, tracks, _ = simulate_fit(3)
    bent = replace(tracks, xy=tracks.xy + 0.01 * np.sin(3 * tracks.t)[:, None, None])
    result = fit_shot_laws(fit, bent, TABLE, FitOptions())
    assert result.solution is None
    misfit = result.misfit
    assert misfit is not None
    assert misfit.deviation > 2 * SIGMA
    assert misfit.times_noise > 1.2
    events = list(zip(fit.events.kind, fit.events.t.tolist(), strict=True))
    assert (misfit.contact, misfit.t) in events
    assert misfit.whole_times_noise > MAX_CHI2**0.5
    assert misfit.explained_until <= misfit.t


def test_a_search_repeats_exactly() -> None:
    fit, tracks, _ = simulate_fit(3)
    first, second = (fit_shot_laws(fit, tracks, TABLE, FitOptions()).solution for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.state, second.state)


def test_a_break_shot_is_not_fitted_whole() -> None:
    """Two balls that meet two others are fitted; every ball more multiplies the orders of contacts."""
    fit, tracks, _ = simulate_fit(3)
    five, four = (replace(fit, moving=np.ones((len(tracks.t), count), bool)) for count in (5, 4))
    assert "5 balls" in fit_shot_laws(five, tracks, TABLE, FitOptions()).refusal
    assert whole_shot_fit._find_refusal(four) == ""


def test_a_clip_without_motion_is_not_fitted() -> None:
    fit, tracks, _ = simulate_fit(3)
    assert fit_shot_laws(replace(fit, moving=np.zeros_like(fit.moving)), tracks, TABLE, FitOptions()).refusal
