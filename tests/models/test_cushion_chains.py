"""Paths tied together at cushions: exact slopes for every law, and laws that data tell apart."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from models.core.events import Events
from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import shoot
from models.estimation.whole_shot.cushion_chains import Bounce, CushionChains, Leg, chain_priors, glide, legs_of
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, mirror, stronge

TABLE = Table("carom-match", "carom", 2.84, 1.42, 0.03075, 0.21, False)
SHARED = np.array([0.2, 0.01, 0.85, 0.18, 0.001, 0.002, -0.001, 0.0005])
SIGMA = 0.001
LAWS = [mirror, han_2005, mathavan_2010, stronge]


def leg(begin: float, tied: bool, bounce: Bounce | None, t: FloatArray, xy: FloatArray) -> Leg:
    return Leg(0, "white", begin, tied, t, xy, np.tile(np.eye(2) / SIGMA, (len(t), 1, 1)), bounce)


def empty(begin: float, tied: bool, bounce: Bounce | None) -> Leg:
    return leg(begin, tied, bounce, np.empty(0), np.empty((0, 2)))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("cushion", "v"), [("right", (1.5, 0.6)), ("left", (-1.1, 0.9)), ("top", (0.3, -1.2)), ("bottom", (-0.7, 1.0))]
)
def test_slopes_through_a_cushion_are_those_of_finite_differences(
    law: ModuleType, cushion: str, v: tuple[float, float]
) -> None:
    start = np.array([1.4, 0.7, *v, 0.3, -0.4, 0.5])
    model = CushionChains((empty(0.0, False, Bounce(cushion, 0.8)), empty(1.5, True, None)), TABLE, law.rebound)
    inputs = np.concatenate([start, SHARED])
    _, by_start, by_shared = model.hop(model.legs[0], start, 1.5, SHARED)
    for k in range(len(inputs)):
        step = 1e-6 * np.eye(len(inputs))[k]
        ends = [model.hop(model.legs[0], z[:7], 1.5, z[7:])[0] for z in (inputs + step, inputs - step)]
        slope = (ends[0] - ends[1]) / 2e-6
        assert np.allclose(np.column_stack([by_start, by_shared])[:, k], slope, atol=2e-5, rtol=2e-5), k


def test_a_rebound_takes_place_one_radius_and_the_nose_from_the_wall() -> None:
    start = np.array([2.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0])
    shared = SHARED.copy()
    shared[4 + CUSHIONS.index("right")] = 0.004
    model = CushionChains((empty(0.0, False, Bounce("right", 0.9)), empty(0.9, True, None)), TABLE, mirror.rebound)
    reach = TABLE.length - TABLE.ball_radius - 0.004 - 2.0
    tau = (1 - np.sqrt(1 - 2 * 0.0981 * reach)) / 0.0981
    end, _, _ = model.hop(model.legs[0], start, tau, shared)
    assert np.isclose(end[0], 2.0 + reach, atol=1e-9)
    assert end[2] < 0


def filmed(rng: np.random.Generator, law: ModuleType, shots: int) -> tuple[Leg, ...]:
    """Balls that meet the right cushion and run on for 1.2 s, seen 30 times a second."""
    legs: list[Leg] = []
    for shot in range(shots):
        v = np.array([rng.uniform(0.8, 2.0), rng.uniform(-0.8, 0.8)])
        start = np.array([1.9, 0.7, *v, *rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.8, 0.8)])
        meet = (TABLE.length - TABLE.ball_radius - 1.9) / v[0]
        first, second = empty(0.0, False, Bounce("right", meet)), empty(meet, True, None)
        after, _, _ = CushionChains((first, second), TABLE, law.rebound).hop(first, start, meet, SHARED)
        for begin, state, t in ((0.0, start, np.arange(1 / 30, meet - 0.02, 1 / 30)),
                                (meet, after, meet + 0.04 + np.arange(36) / 30)):  # fmt: skip
            xy = glide(state, t - begin, SHARED)[0][:, :2] + SIGMA * rng.standard_normal((len(t), 2))
            legs.append(leg(begin, begin > 0, None if begin else Bounce("right", meet), t, xy))
            legs[-1] = replace(legs[-1], chain=shot)
    return tuple(legs)


@pytest.mark.parametrize("law", [mirror, han_2005])
def test_restitution_and_friction_are_found_within_their_errors(law: ModuleType) -> None:
    fit = shoot(CushionChains(filmed(np.random.default_rng(1), law, 8), TABLE, law.rebound, scatter=0.003))
    pulls = (fit.shared - SHARED) / fit.sigma
    assert np.all(np.abs(pulls) < 4), pulls
    assert fit.sigma[2] < 0.02


def test_data_tell_laws_apart() -> None:
    legs = filmed(np.random.default_rng(2), han_2005, 8)
    fits = [shoot(CushionChains(legs, TABLE, law.rebound, scatter=0.003)) for law in (han_2005, mirror)]
    assert fits[0].log_evidence > fits[1].log_evidence + 10


def test_legs_are_tied_at_cushions_and_begin_anew_at_balls() -> None:
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
    legs = [one for one in legs_of(tracks, events, 7) if one.ball == "white"]
    assert [one.tied for one in legs] == [False, True, False, True]
    assert [one.chain for one in legs] == [7, 7, 8, 8]
    assert [one.bounce.cushion if one.bounce else "" for one in legs] == ["left", "", "top", ""]
    assert len(chain_priors()) == len(SHARED)
