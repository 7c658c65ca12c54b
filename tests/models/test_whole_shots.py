"""Laws and spin of whole shots, from tracks and the fit of their pieces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.simulated_shots import LAWS, SIGMA, TABLE, numbers, opening

from models.core.fit_result import Fit, Trust
from models.core.options import FitOptions
from models.core.tracks import Tracks
from models.estimation.whole_shot.whole_shot_fit import MOST_BALLS, with_laws
from models.physics.billiards.simulation.parametrised_shot import packed, played, spins

SECONDS = 4.0


def followed(seed: int) -> tuple[Fit, Tracks, np.ndarray]:
    """A shot as the chain hands it over, and the true state (7,) of the cue ball at the strike."""
    rng = np.random.default_rng(seed)
    start, moving = opening(rng)
    run = played(packed(start, moving), moving, TABLE, numbers(), LAWS, SECONDS)
    t = np.arange(round(60 * SECONDS)) / 60
    xy = run.at(t)[..., :2] + SIGMA * rng.normal(size=(len(t), 3, 2))
    sigma, none = np.full((len(t), 3), SIGMA), np.zeros((len(t), 3, 2))
    tracks = Tracks(
        np.arange(len(t)), t, run.balls.ids, ("ball",) * 3, xy, xy, sigma, sigma, none, 30 + 0 * sigma,
        np.zeros((3, 3)),
    )  # fmt: skip
    speed = np.hypot(*np.moveaxis(run.at(t)[..., 2:4], -1, 0))
    everywhere = np.ones(speed.shape, bool)
    fit = Fit(run.events, run.trajectory(), (), SIGMA, 1.0, none, speed > 0.02, everywhere, Trust("green", ()))
    return fit, tracks, spins(start, TABLE.ball_radius)[0][0]


def test_a_whole_shot_tells_its_law_and_the_spin_of_the_strike() -> None:
    fit, tracks, truth = followed(3)
    laws = with_laws(fit, tracks, TABLE, FitOptions()).laws
    assert laws is not None
    assert (laws.cushion, laws.ball) == ("mirror", "inelastic")
    assert 0.4 < laws.chi2_per_dof < 1.2
    cue = laws.ids.index("0")
    pull = (laws.state[cue] - truth) / np.sqrt(np.diag(laws.covariance[cue]))
    assert np.all(np.abs(pull) < 4), pull
    e = next(p for p in laws.parameters if p.name == "cushion_restitution.e")
    assert not e.prior_only
    assert abs(e.value - 0.85) < 4 * e.sigma


def test_a_shot_that_no_law_explains_says_by_how_much() -> None:
    fit, tracks, _ = followed(3)
    bent = replace(tracks, xy=tracks.xy + 0.01 * np.sin(3 * tracks.t)[:, None, None])
    found = with_laws(fit, bent, TABLE, FitOptions())
    assert found.laws is None
    assert "No published law explains" in found.lawless


def test_a_break_is_not_tried() -> None:
    fit, tracks, _ = followed(3)
    many = replace(fit, moving=np.ones((len(tracks.t), MOST_BALLS + 1), bool))
    assert "too many" in with_laws(many, tracks, TABLE, FitOptions()).lawless


def test_where_nothing_moves_there_is_nothing_to_explain() -> None:
    fit, tracks, _ = followed(3)
    assert with_laws(replace(fit, moving=np.zeros_like(fit.moving)), tracks, TABLE, FitOptions()).lawless
