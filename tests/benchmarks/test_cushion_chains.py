"""Paths linked at cushions: exact derivatives of every contact model, and models that data distinguish."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from benchmarks.fitting.cushion_chains import (
    ChainSegment,
    CushionBounce,
    CushionChains,
    chain_priors,
    extract_chain_segments,
    predict_motion,
)
from models.core.events import Events
from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import fit_windows
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, mirror, stronge

TABLE = Table("carom-match", "carom", 2.84, 1.42, 0.03075, 0.21, False)
SHARED = np.array([0.2, 0.01, 0.85, 0.18, 0.001, 0.002, -0.001, 0.0005])
SIGMA = 0.001
LAWS = [mirror, han_2005, mathavan_2010, stronge]


def chain_segment(
    begin: float, tied: bool, bounce: CushionBounce | None, t: FloatArray, xy: FloatArray
) -> ChainSegment:
    return ChainSegment(0, "white", begin, tied, t, xy, np.tile(np.eye(2) / SIGMA, (len(t), 1, 1)), bounce)


def empty_segment(begin: float, tied: bool, bounce: CushionBounce | None) -> ChainSegment:
    return chain_segment(begin, tied, bounce, np.empty(0), np.empty((0, 2)))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("cushion", "v"), [("right", (1.5, 0.6)), ("left", (-1.1, 0.9)), ("top", (0.3, -1.2)), ("bottom", (-0.7, 1.0))]
)
def test_jacobians_through_a_cushion_equal_finite_differences(
    law: ModuleType, cushion: str, v: tuple[float, float]
) -> None:
    start = np.array([1.4, 0.7, *v, 0.3, -0.4, 0.5])
    model = CushionChains(
        (empty_segment(0.0, False, CushionBounce(cushion, 0.8)), empty_segment(1.5, True, None)), TABLE, law.rebound
    )
    inputs = np.concatenate([start, SHARED])
    _, by_start, by_shared = model.predict_past_cushion(model.segments[0], start, 1.5, SHARED)
    for k in range(len(inputs)):
        step = 1e-6 * np.eye(len(inputs))[k]
        ends = [
            model.predict_past_cushion(model.segments[0], z[:7], 1.5, z[7:])[0] for z in (inputs + step, inputs - step)
        ]
        slope = (ends[0] - ends[1]) / 2e-6
        assert np.allclose(np.column_stack([by_start, by_shared])[:, k], slope, atol=2e-5, rtol=2e-5), k


def test_a_rebound_takes_place_one_radius_and_the_nose_from_the_wall() -> None:
    start = np.array([2.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0])
    shared = SHARED.copy()
    shared[4 + CUSHIONS.index("right")] = 0.004
    model = CushionChains(
        (empty_segment(0.0, False, CushionBounce("right", 0.9)), empty_segment(0.9, True, None)), TABLE, mirror.rebound
    )
    reach = TABLE.length - TABLE.ball_radius - 0.004 - 2.0
    tau = (1 - np.sqrt(1 - 2 * 0.0981 * reach)) / 0.0981
    end, _, _ = model.predict_past_cushion(model.segments[0], start, tau, shared)
    assert np.isclose(end[0], 2.0 + reach, atol=1e-9)
    assert end[2] < 0


def simulate_segments(rng: np.random.Generator, law: ModuleType, shots: int) -> tuple[ChainSegment, ...]:
    """Balls that hit the right cushion and roll on for 1.2 s, observed at 30 Hz."""
    legs: list[ChainSegment] = []
    for shot in range(shots):
        v = np.array([rng.uniform(0.8, 2.0), rng.uniform(-0.8, 0.8)])
        start = np.array([1.9, 0.7, *v, *rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.8, 0.8)])
        meet = (TABLE.length - TABLE.ball_radius - 1.9) / v[0]
        first, second = empty_segment(0.0, False, CushionBounce("right", meet)), empty_segment(meet, True, None)
        after, _, _ = CushionChains((first, second), TABLE, law.rebound).predict_past_cushion(
            first, start, meet, SHARED
        )
        for begin, state, t in ((0.0, start, np.arange(1 / 30, meet - 0.02, 1 / 30)),
                                (meet, after, meet + 0.04 + np.arange(36) / 30)):  # fmt: skip
            xy = predict_motion(state, t - begin, SHARED)[0][:, :2] + SIGMA * rng.standard_normal((len(t), 2))
            legs.append(chain_segment(begin, begin > 0, None if begin else CushionBounce("right", meet), t, xy))
            legs[-1] = replace(legs[-1], chain=shot)
    return tuple(legs)


@pytest.mark.parametrize("law", [mirror, han_2005])
def test_restitution_and_friction_are_found_within_their_errors(law: ModuleType) -> None:
    fit = fit_windows(
        CushionChains(simulate_segments(np.random.default_rng(1), law, 8), TABLE, law.rebound, scatter=0.003)
    )
    pulls = (fit.shared - SHARED) / fit.sigma
    assert np.all(np.abs(pulls) < 4), pulls
    assert fit.sigma[2] < 0.02


def test_data_distinguish_contact_models() -> None:
    legs = simulate_segments(np.random.default_rng(2), han_2005, 8)
    fits = [fit_windows(CushionChains(legs, TABLE, law.rebound, scatter=0.003)) for law in (han_2005, mirror)]
    assert fits[0].log_evidence > fits[1].log_evidence + 10


def test_segments_are_linked_at_cushions_and_begin_again_at_balls() -> None:
    t = np.arange(90) / 30
    sigma = np.full((90, 2), SIGMA)
    xy = np.random.default_rng(0).uniform(0.3, 0.9, (90, 2, 2))
    tracks = Tracks(
        np.arange(90), t, ("white", "red"), ("white", "red"), xy, xy * 200, sigma, sigma, np.zeros_like(xy),
        np.full_like(sigma, 6.5), np.zeros((2, 3)),
    )  # fmt: skip
    when, nothing = np.array([0.31, 1.01, 1.61, 2.21]), np.full(4, np.nan)
    events = Events(
        ("strike", "cushion", "ball", "cushion"), when, np.full(4, 0.01), 30 * when, ("white",) * 4,
        ("", "left", "red", "top"), np.zeros((4, 2)), np.ones(4), nothing, nothing, np.ones(4),
    )  # fmt: skip
    legs = [one for one in extract_chain_segments(tracks, events, 7) if one.ball == "white"]
    assert [one.continues_previous for one in legs] == [False, True, False, True]
    assert [one.chain for one in legs] == [7, 7, 8, 8]
    assert [one.bounce.cushion if one.bounce else "" for one in legs] == ["left", "", "top", ""]
    assert len(chain_priors()) == len(SHARED)
