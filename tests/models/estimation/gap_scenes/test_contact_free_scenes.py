"""Scenes without contacts: exact solutions, conserved energy, and derivatives against finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.gap_scene import Recording, neutral_values
from models.estimation.gap_scenes.pendulum_scene import build_pendulum_scene
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene

BRAKE = [0.2, 0.1, 0.05, 0.01]
"""Parameters of the probe, the last ones in every scene."""
SCENES = {
    "slide": (build_sliding_scene(), 2, [0.1, -0.2, 1.2, 0.7], [0.1, 0.2, 0.1, 3.0, -2.0]),
    "flight": (build_flight_scene(2), 2, [0.0, 1.0, 8.0, 6.0], [0.1, 0.2, 0.3, 1.0]),
    "flight in space": (build_flight_scene(3), 3, [0.0, 0.0, 1.0, 8.0, 1.0, 6.0], [0.1, 0.2, 0.3, 1.0, -0.5]),
    "drop": (build_flight_scene(1), 1, [20.0, -1.0], [0.05, 0.1]),
    "pendulum": (build_pendulum_scene(1), 1, [1.0, 0.5], [40.0, 0.1, 0.2, 0.02, 0.01]),
    "double pendulum": (
        build_pendulum_scene(2), 2, [1.0, -0.5, 0.3, 1.0], [50.0, 0.3, 0.3, 20.0, 0.1, 0.1, 0.05, 0.05, 0.01],
    ),
}  # fmt: skip


def recording(coordinates: int, rows: int = 30) -> Recording:
    t = np.arange(rows) / 60
    places = np.random.default_rng(1).normal(size=(rows, 1, coordinates))
    return Recording(0, np.arange(rows), t, ("body",), places, np.full((rows, 1), 0.1))


@pytest.mark.parametrize("name", SCENES)
def test_jacobians_equal_finite_differences(name: str) -> None:
    scene, coordinates, start, effects = SCENES[name]
    shared = [*effects, *BRAKE]
    model = scene.build_model((recording(coordinates),), ())
    numbers = np.array([*start, *shared])
    flow = model.linearize(0, np.array(start), np.array(shared))
    slopes = np.concatenate([flow.start_jacobian, flow.shared_jacobian], axis=2)
    for k in range(len(numbers)):
        step = 1e-5 * max(1.0, abs(numbers[k])) * np.eye(len(numbers))[k]
        ends = [np.split(numbers + sign * step, [len(start)]) for sign in (1, -1)]
        ahead, behind = (model.linearize(0, *end).residual for end in ends)
        assert np.allclose((ahead - behind) / (2 * step[k]), slopes[..., k], rtol=1e-4, atol=1e-5)


def simulate_path(
    scene: ContactFreeScene, coordinates: int, start: list[float], **strengths: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and positions (T, D) with the named effects only."""
    names = [prior.name for effect in scene.effects for prior in effect.parameters]
    shared = neutral_values(scene)
    for name, value in strengths.items():
        shared[names.index(name)] = value
    piece = recording(coordinates, 60)
    return piece.t, scene.predict_positions(piece, np.array(start), shared, ())[:, 0]


def test_the_brake_probe_equals_the_named_drags_of_its_powers() -> None:
    start = [0.0, 1.0, 3.0, 4.0]
    for power, name in ((1, "viscous_drag"), (2, "air_drag")):
        scene = build_flight_scene(2)
        names = [f"{effect.name}.{prior.name}" for effect in scene.effects for prior in effect.parameters]
        paths = []
        for called in (f"{name}.k", f"brake_over_speed.c{power}"):
            shared = neutral_values(scene)
            shared[names.index(called)] = 0.2
            paths.append(scene.predict_positions(recording(2, 60), np.array(start), shared, ()))
        assert np.allclose(*paths, atol=1e-5)
        assert not np.allclose(
            paths[0], scene.predict_positions(recording(2, 60), np.array(start), neutral_values(scene), ())
        )


def test_wind_accelerates_a_body_by_its_drag() -> None:
    """With a = -k (v - w) along x: x = w t + (v - w) (1 - exp(-k t)) / k."""
    scene, k, wind, piece = build_flight_scene(2), 0.5, -2.0, recording(2, 60)
    names = [f"{effect.name}.{prior.name}" for effect in scene.effects for prior in effect.parameters]
    shared = neutral_values(scene)
    shared[[names.index("viscous_drag.k"), names.index("wind.wind_x")]] = k, wind
    result = scene.predict_positions(piece, np.array([0.0, 1.0, 3.0, 4.0]), shared, ())[:, 0, 0]
    assert np.allclose(result, wind * piece.t + (3.0 - wind) * (1 - np.exp(-k * piece.t)) / k, atol=1e-6)


def test_a_throw_is_a_parabola() -> None:
    t, places = simulate_path(build_flight_scene(2), 2, [0.0, 1.0, 3.0, 4.0])
    assert np.allclose(places, np.stack([3 * t, 1 + 4 * t - 9.81 / 2 * t**2], axis=1), atol=1e-9)


def test_a_fall_with_drag_equals_the_exact_solution() -> None:
    """From rest with a = -g + k v v: v = -w tanh(g t / w), w = sqrt(g / k)."""
    result, k = build_flight_scene(1), 0.2
    t = recording(1, 60).t
    shared = neutral_values(result)
    shared[0] = k
    height = result.predict_positions(recording(1, 60), np.array([10.0, 0.0]), shared, ())[:, 0, 0]
    terminal = np.sqrt(9.81 / k)
    exact = 10.0 - terminal**2 / 9.81 * np.log(np.cosh(9.81 * t / terminal))
    assert np.allclose(height, exact, atol=2e-4)  # drag vanishes below 1 mm/s


def test_friction_decelerates_uniformly_until_rest() -> None:
    t, places = simulate_path(build_sliding_scene(), 2, [0.0, 0.0, 1.0, 0.0], mu=0.2)
    moving = t < 0.9 / (0.2 * 9.81)
    exact = t - 0.2 * 9.81 / 2 * t**2
    assert np.allclose(places[moving, 0], exact[moving], atol=2e-4)
    assert abs(places[-1, 0] - 1 / (2 * 0.2 * 9.81)) < 2e-4


def test_rods_without_friction_conserve_energy() -> None:
    scene = build_pendulum_scene(2)
    pull, second, coupling, second_pull = 50.0, 0.3, 0.3, 20.0
    starts, shared = np.array([[1.0], [-0.5], [0.3], [1.0]]), neutral_values(scene)[:, None]
    a, b, u, v = scene.integrate(starts, shared, np.arange(60) / 60, 1 / 200)[:, :, 0].T
    energy = (
        u**2 / 2 + second * v**2 / 2 + coupling * u * v * np.cos(a - b) - pull * np.cos(a) - second_pull * np.cos(b)
    )
    assert np.ptp(energy) < 1e-4


def test_a_body_that_moves_with_the_wind_has_no_drag() -> None:
    """Quadratic drag has no effect on a resting body, and no wind replaces it."""
    t, result = simulate_path(build_flight_scene(2), 2, [0.0, 1.0, -2.0, 0.3], k=0.03, wind_x=-2.0)
    assert np.allclose(result[:12], np.stack([-2.0 * t, 1.0 + 0.3 * t - 0.5 * 9.81 * t**2], axis=1)[:12], atol=5e-4)


@pytest.mark.parametrize("start", [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.1, -0.05]])
def test_a_body_stopped_by_friction_on_a_slope_does_not_creep(start: list[float]) -> None:
    _, result = simulate_path(build_sliding_scene(), 2, start, mu=0.2, slope_x=20.0, slope_y=-60.0)
    assert np.abs(np.diff(result[30:], axis=0)).max() < 1e-9


def test_a_body_on_a_slope_steeper_than_friction_slides_down() -> None:
    """From rest: g (slope - mu) t^2 / 2, plus the gain before friction reaches its full value at 1 cm/s."""
    t, result = simulate_path(build_sliding_scene(), 2, [0.0, 0.0, 0.0, 0.0], mu=0.1, slope_x=150.0)
    assert result[-1, 0] == pytest.approx(0.5 * 9.81 * 0.05 * t[-1] ** 2, abs=0.012)
