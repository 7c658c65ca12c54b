"""The neural residual: exact derivatives, no effect at zero, physical at any weights, disabled where useless."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import fit_windows
from models.estimation.neural_residual.corrected_motion import CLOTH_WEIGHTS, WEIGHTS
from models.estimation.neural_residual.residual_training import (
    MIN_GAIN,
    geometric_mean_error,
    prediction_errors,
    train_residual,
)
from models.estimation.neural_residual.residual_windows import ResidualChains, residual_priors
from models.estimation.whole_shot.cushion_chains import ChainSegment, CushionBounce, CushionChains, predict_motion
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, mirror, stronge
from models.physics.billiards.ball_cushion.cushion_models import CUSHION_MODELS

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
SHARED = np.array([0.2, 0.01, 0.85, 0.18, 0.001, 0.002, -0.001, 0.0005])
START = np.array([1.4, 0.7, 1.5, 0.6, 0.3, -0.4, 0.5])
TAU = np.arange(1, 41) / 30
SIGMA = 0.001


def chain_segment(
    number: int, begin: float, tied: bool, t: FloatArray, xy: FloatArray, bounce: CushionBounce | None = None
) -> ChainSegment:
    return ChainSegment(number, "cue", begin, tied, t, xy, np.tile(np.eye(2) / SIGMA, (len(t), 1, 1)), bounce)


def segments_through(cushion: str, at: float, until: float) -> tuple[ChainSegment, ChainSegment]:
    """Two segments without samples, linked at a cushion."""
    nothing, nowhere = np.empty(0), np.empty((0, 2))
    first = chain_segment(0, 0.0, False, nothing, nowhere, CushionBounce(cushion, at))
    return first, chain_segment(0, until, True, nothing, nowhere)


def any_weights(seed: int, size: float) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.array([prior.value for prior in residual_priors(0.1, seed)]) + size * rng.standard_normal(WEIGHTS)


def energy(states: FloatArray) -> FloatArray:
    """Twice the energy per mass of states (..., 7) with slip."""
    v, slip, side = states[..., 2:4], states[..., 4:6], states[..., 6]
    return np.asarray((v**2).sum(-1) + 0.4 * (((v - slip) ** 2).sum(-1) + side**2))


@pytest.mark.parametrize("law", [mirror, han_2005, mathavan_2010, stronge])
def test_with_zero_output_it_is_the_physics_in_closed_form(law) -> None:  # type: ignore[no-untyped-def]
    name = CUSHION_MODELS[[mirror, han_2005, mathavan_2010, stronge].index(law)]
    legs = segments_through("right", 0.8, 1.5)
    weights = residual_priors(0.1, 3)
    numbers = np.concatenate([SHARED, [prior.value for prior in weights]])
    silent = ResidualChains(legs, TABLE, name, weights)
    assert np.allclose(silent.predict_motion(START, TAU, numbers)[0], predict_motion(START, TAU, SHARED)[0], atol=1e-9)
    expected, by_start, by_shared = CushionChains(legs, TABLE, law.rebound).predict_past_cushion(
        legs[0], START, 1.5, SHARED
    )
    result, slope, met = silent.predict_past_cushion(legs[0], START, 1.5, numbers)
    assert met
    assert np.allclose(result, expected, atol=1e-9)
    assert np.allclose(slope[:, :15], np.column_stack([by_start, by_shared]), atol=1e-6)


def test_jacobians_by_start_physics_and_weights_equal_finite_differences() -> None:
    legs = segments_through("bottom", 0.8, 1.4)
    model = ResidualChains(legs, TABLE, "han_2005", residual_priors(0.1, 1))
    point = np.concatenate([START, SHARED, any_weights(1, 0.2)])
    _, by_glide = model.predict_motion(START, TAU, point[7:])
    _, by_hop, _ = model.predict_past_cushion(legs[0], START, 1.4, point[7:])
    for k in [*range(15), 20, 15 + CLOTH_WEIGHTS - 2, 15 + CLOTH_WEIGHTS + 3, len(point) - 2]:
        step = 1e-6 * np.eye(len(point))[k]
        glides = [model.predict_motion(z[:7], TAU, z[7:])[0] for z in (point + step, point - step)]
        hops = [model.predict_past_cushion(legs[0], z[:7], 1.4, z[7:])[0] for z in (point + step, point - step)]
        assert np.allclose(by_glide[:, :, k], (glides[0] - glides[1]) / 2e-6, atol=2e-5), k
        assert np.allclose(by_hop[:, k], (hops[0] - hops[1]) / 2e-6, atol=2e-5), k


@pytest.mark.parametrize("seed", range(12))
def test_energy_never_grows_whatever_the_weights(seed: int) -> None:
    rng = np.random.default_rng(seed)
    legs = segments_through("right", 0.5, 1.0)
    numbers = np.concatenate([SHARED, any_weights(seed, 2.0)])
    model = ResidualChains(legs, TABLE, CUSHION_MODELS[seed % 4], residual_priors(0.1, seed))
    start = np.array([2.45, 0.6, rng.uniform(0.5, 3), rng.uniform(-1, 1), *rng.uniform(-2, 2, 3)])
    before = energy(np.vstack([start, model.predict_motion(start, np.arange(1, 200) / 25, numbers)[0]]))
    assert np.all(np.diff(before) <= 1e-12 * before[0])
    end, _, _ = model.predict_past_cushion(legs[0], start, 1.0, numbers)
    assert energy(end) <= before[0] + 1e-12


@pytest.mark.parametrize("seed", range(4))
def test_a_ball_at_rest_stays_whatever_the_weights(seed: int) -> None:
    model = ResidualChains(segments_through("right", 1.0, 1.0), TABLE, "mirror", residual_priors(0.1, seed))
    numbers = np.concatenate([SHARED, any_weights(seed, 2.0)])
    still = np.array([1.0, 0.5, 0, 0, 0, 0, 0])
    assert np.array_equal(model.predict_motion(still, TAU, numbers)[0], np.tile(still, (len(TAU), 1)))


def test_shorter_intervals_converge() -> None:
    model = ResidualChains(segments_through("right", 1.0, 1.0), TABLE, "mirror", residual_priors(0.1, 5))
    numbers = np.concatenate([SHARED, any_weights(5, 0.5)])
    rolling = np.array([0.4, 0.5, 1.2, 0.4, 0, 0, 0])
    ends = [
        model.predict_motion(rolling, np.arange(1, n + 1) * 1.2 / n, numbers)[0][-1, :2] for n in (30, 60, 120, 960)
    ]
    errors = [float(np.linalg.norm(end - ends[-1])) for end in ends[:-1]]
    assert errors[0] < 3e-4
    assert errors[0] / errors[1] > 1.7
    assert errors[1] / errors[2] > 1.7


def simulate_rolling(pull: FloatArray, seed: int, shots: int) -> tuple[ChainSegment, ...]:
    """Integrate balls that roll in all directions on a table that accelerates them by `pull` (2,) m/s^2."""
    rng, legs = np.random.default_rng(seed), []
    for shot in range(shots):
        angle, dt = rng.uniform(0, 2 * np.pi), 1 / 3000
        x, v = np.array([1.27, 0.635]), rng.uniform(0.25, 0.5) * np.array([np.cos(angle), np.sin(angle)])
        observed = []
        for step in range(4500):
            if step % 100 == 0:
                observed.append(x.copy())
            v = v + (pull - 0.0981 * v / max(float(np.hypot(*v)), 1e-9)) * dt
            x = x + v * dt
        t = np.arange(len(observed)) / 30
        legs.append(chain_segment(shot, -1e-6, False, t, np.array(observed) + SIGMA * rng.standard_normal((len(t), 2))))
    return tuple(legs)


def test_a_missing_force_is_learned_and_improves_hold_out_predictions() -> None:
    legs = simulate_rolling(np.array([0.02, -0.015]), 0, 18)
    result = train_residual(legs[:7], legs[7:12], TABLE, "mirror", seed=0)
    assert result.is_enabled
    bare = ResidualChains(legs[12:], TABLE, "mirror")
    without = geometric_mean_error(prediction_errors(bare, result.physics_values))
    assert (
        geometric_mean_error(prediction_errors(result.build_model(legs[12:], TABLE, "mirror"), result.parameter_values))
        < 0.7 * without
    )


def test_where_nothing_is_missing_it_stays_disabled_and_changes_nothing() -> None:
    legs = simulate_rolling(np.zeros(2), 1, 13)
    result = train_residual(legs[:7], legs[7:], TABLE, "mirror", seed=0)
    assert not result.is_enabled
    assert result.gain < MIN_GAIN
    assert result.active_weights == ()
    assert np.array_equal(result.parameter_values, result.physics_values)


def test_zero_output_has_more_evidence_where_nothing_is_missing() -> None:
    model = ResidualChains(simulate_rolling(np.zeros(2), 2, 4), TABLE, "mirror")
    loud = replace(model, weights=residual_priors(0.3, 0))
    assert fit_windows(model).log_evidence > fit_windows(loud).log_evidence + 2


def test_the_same_seed_gives_the_same_network() -> None:
    assert residual_priors(0.1, 4) == residual_priors(0.1, 4)
    assert residual_priors(0.1, 4) != residual_priors(0.1, 5)
    assert len(residual_priors(0.1, 4)) == WEIGHTS


def test_an_unknown_contact_model_is_refused() -> None:
    with pytest.raises(ValueError, match="mirror"):
        ResidualChains((), TABLE, "magic")
