"""Springs inferred from coordinates: true parameters recovered, irregular motion rejected, rods recognised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from models.core.recording import record_points
from models.core.typing import FloatArray
from models.estimation.springs.latent_inference import (
    REST_AT_START,
    LatentSprings,
    find_nearest_jolt,
    format_not_identifiable,
    infer_springs,
)
from models.physics.springs.spring_system import SpringSystem, build_springs, evaluate_spring_rate, simulate_springs

NOISE = 0.1
"""px."""


def simulate_coordinates(
    graph: SpringSystem, start: FloatArray, t: FloatArray, noise: float, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Positions (T, N, D) by another integrator than that of the fit, true and measured."""
    path = solve_ivp(
        lambda _, y: evaluate_spring_rate(graph, y.reshape(start.shape)).ravel(), (t[0], t[-1]), start.ravel(),
        method="DOP853", rtol=1e-10, atol=1e-10, t_eval=t,
    )  # fmt: skip
    true = path.y.T.reshape(len(t), *start.shape)[:, 0]
    return true, true + noise * np.random.default_rng(seed).standard_normal(true.shape)


def pendulum(stiffness: float, damping: float) -> tuple[SpringSystem, FloatArray]:
    graph = build_springs(np.ones(3), [(0, 1), (1, 2)], stiffness, damping, 80.0, np.array([0.0, 981.0]), fixed=(0,))
    x = np.array([[200.0, 190], [280, 190], [360, 190]])
    return graph, np.stack([x, np.zeros_like(x)])


def values(latent: LatentSprings) -> dict[str, float]:
    return dict(zip(latent.names, latent.values.tolist(), strict=True))


@pytest.fixture(scope="module")
def soft() -> tuple[LatentSprings, FloatArray, FloatArray, FloatArray]:
    """Five seconds of soft springs at 15 Hz; with times and true positions between and after the samples."""
    t = np.arange(0, 7.01, 1 / 30)
    true, observed = simulate_coordinates(*pendulum(300.0, 0.1), t, NOISE, 1)
    return infer_springs(record_points(t[:151:2], observed[:151:2])), t, true, observed


def test_springs_are_recovered_from_coordinates(soft: tuple[LatentSprings, FloatArray, FloatArray, FloatArray]) -> None:
    latent = soft[0]
    assert latent.is_accepted
    assert latent.graph.pairs.tolist() == [[0, 1], [1, 2]]
    assert latent.graph.fixed.tolist() == [True, False, False]
    assert np.allclose(latent.graph.mass, 1.0, rtol=0.02)
    assert np.allclose(latent.graph.stiffness, 300.0, rtol=0.05)
    assert np.allclose(latent.graph.rest, 80.0, rtol=0.02)
    assert np.allclose(latent.graph.gravity, [0, 981], rtol=0.02, atol=3.0)
    assert latent.noise == pytest.approx(NOISE, rel=0.25)


def test_simpler_descriptions_are_found_where_they_hold(
    soft: tuple[LatentSprings, FloatArray, FloatArray, FloatArray],
) -> None:
    assert {"equal mass", "equal stiffness", "no gravity x", REST_AT_START} <= set(soft[0].simplifications)


def test_between_samples_the_fit_beats_a_spline_by_far(
    soft: tuple[LatentSprings, FloatArray, FloatArray, FloatArray],
) -> None:
    latent, t, true, observed = soft
    spline = CubicSpline(t[:151:2], observed[:151:2])(t[1:151:2])
    assert (
        np.mean((latent.states_at(t[1:151:2])[:, 0] - true[1:151:2]) ** 2) < np.mean((spline - true[1:151:2]) ** 2) / 30
    )


def test_the_future_follows_the_fit(soft: tuple[LatentSprings, FloatArray, FloatArray, FloatArray]) -> None:
    latent, t, true, _ = soft
    assert np.abs(latent.states_at(t[151:])[:, 0] - true[151:]).max() < 10.0


def test_errors_match_their_standard_deviations(soft: tuple[LatentSprings, FloatArray, FloatArray, FloatArray]) -> None:
    latent = soft[0]
    truth = {"stiffness": 300.0, "damping": 0.1, "rest": 80.0, "gravity y": 981.0}
    off = [(values(latent)[name] - true) / latent.sigma[latent.names.index(name)] for name, true in truth.items()]
    assert np.abs(off).max() < 5.0


def test_unobservably_stiff_springs_become_rods_with_a_bound() -> None:
    t = np.arange(0, 4, 1 / 15)
    _, observed = simulate_coordinates(*pendulum(1e5, 20.0), t, NOISE, 2)
    latent = infer_springs(record_points(t, observed))
    assert latent.is_accepted
    assert np.all(np.isinf(latent.graph.stiffness))
    assert np.all((latent.stiffness_bound > 1e3) & (latent.stiffness_bound < 1e5))


def test_stiff_springs_that_oscillate_between_samples_are_found() -> None:
    t = np.arange(0, 1.4, 1 / 15)
    _, observed = simulate_coordinates(*pendulum(1e5, 20.0), t, 0.0, 0)
    latent = infer_springs(record_points(t, observed))
    assert latent.is_accepted
    assert np.allclose(latent.graph.stiffness, 1e5, rtol=0.01)
    assert np.allclose(latent.graph.damping, 20.0, rtol=0.05)


def test_no_spring_without_effect_is_left() -> None:
    t = np.arange(0, 1.8, 1 / 15)
    _, observed = simulate_coordinates(*pendulum(300.0, 0.1), t, 0.0, 0)
    latent = infer_springs(record_points(t, observed))
    assert latent.is_accepted
    assert latent.graph.pairs.tolist() == [[0, 1], [1, 2]]
    assert np.allclose(latent.graph.stiffness, 300.0, rtol=1e-3)


def test_free_masses_with_missing_samples_are_recovered() -> None:
    """A triangle thrown up: unequal masses and springs, noise unknown, one sample in ten missing."""
    graph = build_springs(
        np.array([1.0, 2.0, 0.5]), [(0, 1), (0, 2), (1, 2)], np.array([200.0, 300.0, 500.0]),
        np.array([0.2, 0.4, 0.1]), np.array([60.0, 70.0, 50.0]), np.array([0.0, 300.0]),
    )  # fmt: skip
    start = np.array([[[0, 0], [65, 0], [20, 48]], [[100, -400], [40, -250], [60, -500]]], np.float64)
    t = np.arange(0, 2, 1 / 30)
    true, observed = simulate_coordinates(graph, start, t, NOISE, 3)
    observed[np.random.default_rng(4).random(observed.shape[:2]) < 0.1] = np.nan
    latent = infer_springs(record_points(t, observed))
    assert latent.is_accepted
    assert np.allclose(latent.graph.mass, graph.mass, rtol=0.02)
    assert np.allclose(latent.graph.stiffness, graph.stiffness, rtol=0.05)
    assert np.sqrt(np.mean((latent.states[:, 0] - true) ** 2)) < NOISE / 2


def discs(stiffness: float, radius: float = 20.0) -> tuple[SpringSystem, FloatArray]:
    """Two discs of unequal mass that collide a little off centre, while they fall."""
    mass, none = np.array([1.0, 1.5]), np.empty(0)
    graph = build_springs(mass, [], none, none, none, np.array([0.0, 100.0]), radius=radius, contact=(stiffness, 3.0))
    return graph, np.array([[[0, 0], [110, 8]], [[150, 0], [-105, 0]]], np.float64)


def test_the_radius_of_colliding_particles_is_recovered() -> None:
    graph, start = discs(4e3)
    t = np.arange(0, 1, 1 / 30)
    _, observed = simulate_coordinates(graph, start, t, 0.05, 2)
    latent = infer_springs(record_points(t, observed))
    assert latent.is_accepted
    result, sigma = values(latent), dict(zip(latent.names, latent.sigma.tolist(), strict=True))
    assert len(latent.graph.pairs) == 0
    assert abs(result["radius"] - 20) < min(4 * sigma["radius"], 1.0)
    assert abs(result["mass 1"] - 1.5) < 0.02
    middle = (t[1:] + t[:-1]) / 2
    off = latent.states_at(middle)[:, 0] - simulate_springs(graph, start, np.concatenate([t[:1], middle]))[1:, 0]
    assert np.sqrt(np.mean(off**2)) < 0.1


def test_only_a_distance_that_reverses_at_a_jolt_is_a_collision() -> None:
    graph, start = discs(4e3)
    t = np.arange(0, 1, 1 / 60)
    true, _ = simulate_coordinates(graph, start, t, 0.0, 0)
    near = find_nearest_jolt(record_points(t, true), graph)
    assert near == pytest.approx(np.linalg.norm(true[:, 0] - true[:, 1], axis=1).min())
    passing, _ = simulate_coordinates(replace(graph, radius=np.zeros(2)), start, t, 0.0, 0)
    assert find_nearest_jolt(record_points(t, passing), graph) == np.inf
    one = np.ones(1)
    joined = replace(graph, pairs=np.array([[0, 1]]), stiffness=one, damping=one, rest=one)
    assert find_nearest_jolt(record_points(t, true), joined) == np.inf


def test_properties_that_are_not_identifiable_are_reported() -> None:
    graph = replace(
        pendulum(1.0, 0.0)[0], stiffness=np.array([np.inf, 300.0]), damping=np.array([0.0, 0.1])
    )  # fmt: skip
    names = ("mass 2", "stiffness 1-2", "damping 1-2", "gravity x")
    sentences = format_not_identifiable(
        graph, names, np.array([1.0, 300.0, 0.1, 0.0]), np.array([1e140, 1.0, 0.2, 1.0]), np.array([5e4, np.nan]), 0.0
    )
    assert sentences[0] == "Masses are identifiable only as multiples of that of particle 1, where forces join them."
    assert "rod 0-1" in sentences[1]
    assert "exceeds 5e+04" in sentences[1]
    assert [sentence.split(" is ")[0] for sentence in sentences[2:]] == ["mass 2", "damping 1-2"]
    (_, brief) = format_not_identifiable(graph, (), np.empty(0), np.empty(0), np.full(2, np.nan), 3.0)[1:]
    assert "smaller by up to 1.5" in brief


@pytest.mark.slow
def test_a_motion_without_springs_is_rejected() -> None:
    t = np.arange(0, 4, 1 / 15)
    _, observed = simulate_coordinates(*pendulum(300.0, 0.1), t, NOISE, 5)
    observed[:, 2, 0] += 6 * np.sin(3.1 * t)
    points = record_points(t, observed)
    latent = infer_springs(replace(points, sigma=np.full(points.sigma.shape, NOISE)))
    assert not latent.is_accepted
    assert "springs do not explain" in latent.rejections[0]


def test_states_at_samples_are_those_of_the_motion(
    soft: tuple[LatentSprings, FloatArray, FloatArray, FloatArray],
) -> None:
    latent = soft[0]
    assert np.allclose(latent.states_at(latent.t), latent.states)
    again = simulate_springs(latent.graph, latent.states[0], latent.t[:15])
    assert np.allclose(again[:, 0], latent.states[:15, 0], atol=NOISE / 2)


def test_too_few_samples_are_an_error() -> None:
    with pytest.raises(ValueError, match="at least 8"):
        infer_springs(record_points(np.arange(5.0), np.zeros((5, 2, 2))))
