"""Scenes of bodies that do not touch each other: exact solutions, energy, derivatives by finite differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.reference_frames import FRAMES

from models.core.recording import Recording
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.gap_scene import neutral_values
from models.estimation.gap_scenes.pendulum_scene import build_pendulum_scene
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene

WALLS = ((-0.2, 0.3), (-0.25, 0.4))
BRAKE = [0.2, 0.1, 0.05, 0.01]
"""Parameters of the probe, the last ones in every scene."""
SCENES = {
    "slide between walls": (
        build_sliding_scene((), WALLS), 2, [0.1, -0.2, 1.2, 0.7], [0.1, 0.2, 0.1, 3.0, -2.0, 0.7, 0.1],
    ),
    "slide on a spring": (
        build_sliding_scene(), 2, [0.1, -0.2, 1.2, 0.7], [0.1, 0.2, 0.1, 3.0, -2.0, 9.0, 0.9, -1.8],
    ),
    "flight": (build_flight_scene(2), 2, [0.0, 1.0, 8.0, 6.0], [0.1, 0.2, 0.3, 1.0]),
    "flight with a spin axis": (
        build_flight_scene(3, has_spin_axis=True), 3, [0.0, 0.0, 1.0, 8.0, 1.0, 6.0], [0.1, 0.2, 0.3, 1.0, -0.5],
    ),
    "drop": (build_flight_scene(1), 1, [20.0, -1.0], [0.05, 0.1]),
    "pendulum": (build_pendulum_scene(1), 1, [1.0, 0.5], [40.0, 0.1, 0.2, 0.02, 0.01]),
    "double pendulum": (
        build_pendulum_scene(2), 2, [1.0, -0.5, 0.3, 1.0], [50.0, 0.3, 0.3, 20.0, 0.1, 0.1, 0.05, 0.05, 0.01],
    ),
}  # fmt: skip
"""Every process compiles every scene again: only those whose accelerations contain code of their own."""


def recording(coordinates: int, rows: int = 30, inputs: np.ndarray | None = None) -> Recording:
    t = np.arange(rows) / 60
    places = np.random.default_rng(1).normal(size=(rows, 1, coordinates))
    return Recording(
        0, np.arange(rows), t, ("body",), places, np.full((rows, 1), 0.1), FRAMES[coordinates - 1], inputs=inputs
    )


@pytest.mark.parametrize("is_driven", [False, True])
@pytest.mark.parametrize("name", SCENES)
def test_jacobians_equal_finite_differences(name: str, is_driven: bool) -> None:
    scene, coordinates, start, effects = SCENES[name]
    shared = [*effects, *BRAKE]
    inputs = np.random.default_rng(2).normal(size=(30, 1, scene.input_count, 2)) if is_driven else None
    model = scene.build_model((recording(coordinates, inputs=inputs),), ())
    numbers = np.array([*start, *shared])
    flow = model.linearize(0, np.array(start), np.array(shared))
    slopes = np.concatenate([flow.start_jacobian, flow.shared_jacobian], axis=2)
    for k in range(len(numbers)):
        step = 1e-5 * max(1.0, abs(numbers[k])) * np.eye(len(numbers))[k]
        ends = [np.split(numbers + sign * step, [len(start)]) for sign in (1, -1)]
        ahead, behind = (model.linearize(0, *end).residual for end in ends)
        assert np.allclose((ahead - behind) / (2 * step[k]), slopes[..., k], rtol=1e-4, atol=1e-5)


def simulate_path(
    scene: ContactFreeScene, coordinates: int, start: list[float], rows: int = 60, **strengths: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and positions (T, D) with the named effects only; `mu_wall` is that of the walls."""
    names = [
        f"{prior.name}_wall" if effect.name == "wall_friction" else prior.name
        for effect in scene.effects
        for prior in effect.parameters
    ]
    shared = neutral_values(scene)
    for name, value in strengths.items():
        shared[names.index(name)] = value
    piece = recording(coordinates, rows)
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
    states, _ = scene.integrate_segment(recording(2, 60), starts, shared)
    a, b, u, v = states[:, :, 0].T
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


def simulate_bounces(start: list[float], rows: int = 90, **strengths: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and positions (T, 2) between `WALLS`."""
    return simulate_path(build_sliding_scene((), WALLS), 2, start, rows, **strengths)


def test_an_elastic_smooth_wall_mirrors_the_path() -> None:
    t, places = simulate_bounces([0.0, 0.1, 1.3, -0.8])
    for axis, (low, high) in enumerate(WALLS):
        free = ([0.0, 0.1][axis] + [1.3, -0.8][axis] * t - low) / (high - low)
        assert np.allclose(places[:, axis], low + (high - low) * (1 - np.abs(1 - free % 2)), atol=1e-9)


def test_a_wall_takes_speed_by_restitution_and_friction() -> None:
    """Closing speed 1, along the wall 0.5: afterwards -e and 0.5 - mu (1 + e)."""
    t, places = simulate_bounces([0.0, 0.0, 1.0, 0.5], e=0.6, mu_wall=0.1)
    later = (t > 0.3) & (t < 0.6)
    assert np.allclose(places[later, 0], 0.3 - 0.6 * (t[later] - 0.3), atol=1e-9)
    assert np.allclose(places[later, 1], 0.15 + (0.5 - 0.1 * 1.6) * (t[later] - 0.3), atol=1e-9)


def test_friction_of_a_wall_stops_a_slow_slip_and_never_reverses_it() -> None:
    t, places = simulate_bounces([0.0, 0.0, 1.0, 0.1], e=0.5, mu_wall=0.2)
    assert np.allclose(places[t > 0.3, 1], 0.03, atol=1e-9)


def test_a_body_that_a_slope_presses_against_a_wall_rests_there() -> None:
    _, places = simulate_bounces([0.1, 0.0, 0.5, 0.0], 240, e=0.5, slope_x=50.0)
    assert places.max() <= 0.3 + 1e-12
    assert np.allclose(places[-30:, 0], 0.3, atol=1e-5)


def test_a_body_in_a_corner_leaves_both_walls() -> None:
    _, places = simulate_bounces([0.2, 0.3, 1.0, 1.0], 10, e=0.8)
    assert np.allclose(places[-1], [0.3 - 0.8 * 0.05, 0.4 - 0.8 * 0.05], atol=1e-9)


def test_observations_soon_after_a_wall_are_a_contact() -> None:
    scene, piece = build_sliding_scene((), WALLS), recording(2, 60)
    covariates = scene.observation_covariates(piece, np.array([0.0, 0.0, 1.0, 0.0]), neutral_values(scene), ())
    assert np.isnan(covariates.since_contact[piece.t < 0.299]).all()
    assert np.allclose(covariates.since_contact[(piece.t > 0.301) & (piece.t < 0.79)], piece.t[19:48] - 0.3)
    assert covariates.phase[17] == "slide"
    assert covariates.phase[20] == "wall_contact"
    assert covariates.phase[40] == "slide"


def test_walls_that_no_body_meets_are_not_tested() -> None:
    far = build_sliding_scene((), ((-9.0, 9.0), (-9.0, 9.0)), (recording(2),))
    near = build_sliding_scene((), ((-9.0, 0.2), (-9.0, 9.0)), (recording(2),))
    assert "wall_restitution: no body meets a wall" in far.not_tested
    assert "wall_friction" not in [effect.name for effect in far.effects]
    assert "wall_restitution" in [effect.name for effect in near.effects]
    assert far.walls == ((-9.0, 9.0), (-9.0, 9.0))


def test_a_spring_swings_a_body_about_its_place_of_rest() -> None:
    scene = build_sliding_scene()
    shared = neutral_values(scene)
    shared[5:8] = 9.0, 0.9, -1.8
    piece = recording(2, 60)
    places = scene.predict_positions(piece, np.array([0.3, 0.0, 0.0, 0.3]), shared, ())[:, 0]
    exact = [0.1 + 0.2 * np.cos(3 * piece.t), -0.2 + 0.2 * np.cos(3 * piece.t) + 0.1 * np.sin(3 * piece.t)]
    assert np.allclose(places, np.stack(exact, axis=1), atol=1e-7)


@pytest.mark.parametrize(
    ("path", "is_offered"),
    [
        pytest.param(lambda t: 0.3 * np.cos(9 * t), True, id="turns back twice"),
        pytest.param(lambda t: 0.3 * np.cos(np.pi * t / t[-1]), True, id="half a swing"),
        pytest.param(lambda t: 3 * t - t**2, False, id="brakes"),
        pytest.param(lambda t: t - 3 * t**2, False, id="turns on a slope"),
        pytest.param(lambda t: 0.3 * np.cos(9 * t) * 0.01, False, id="noise"),
    ],
)
def test_a_spring_is_offered_where_a_body_swings_between_no_walls(
    path: Callable[..., np.ndarray], is_offered: bool
) -> None:
    piece = recording(2, 60)
    places = np.stack([path(piece.t), np.zeros(60)], axis=1)[:, None]
    seen = replace(piece, positions=places, sigma=np.full((60, 1), 1e-3))
    names = [effect.name for effect in build_sliding_scene((), (), (seen,)).effects]
    assert ("spring" in names) is is_offered
    assert "spring" not in [effect.name for effect in build_sliding_scene((), WALLS, (seen,)).effects]
    assert any("spring" in one for one in build_sliding_scene((), WALLS, (seen,)).not_tested)


def test_a_known_force_accelerates() -> None:
    scene, inputs = build_sliding_scene(), np.zeros((60, 1, 2, 2))
    inputs[:, 0, 0, 0], inputs[:, 0, 0, 1] = 6 * np.arange(60) / 60, 6.0
    piece = recording(2, 60, inputs)
    places = scene.predict_positions(piece, np.array([0.0, 0.0, 0.0, 1.0]), neutral_values(scene), ())[:, 0]
    assert np.allclose(places, np.stack([piece.t**3, piece.t], axis=1), atol=1e-9)


def test_a_pivot_in_free_fall_takes_the_weight_from_both_rods() -> None:
    scene, inputs = build_pendulum_scene(2), np.zeros((60, 1, 3, 2))
    inputs[:, 0, 2, 0] = -9.81
    piece = recording(2, 60, inputs)
    angles = scene.predict_positions(piece, np.array([1.0, 1.0, 0.5, 0.5]), neutral_values(scene), ())[:, 0]
    assert np.allclose(angles, (1.0 + 0.5 * piece.t)[:, None], atol=1e-9)


def test_a_pivot_that_accelerates_to_the_right_leaves_the_rod_behind() -> None:
    """With an acceleration of g, a rod rests at -45 degrees; a torque of minus its pull holds it at -90 degrees."""
    scene, inputs = build_pendulum_scene(1), np.zeros((60, 1, 3, 2))
    inputs[:, 0, 1, 0] = 9.81
    angles = scene.predict_positions(recording(1, 60, inputs), np.array([-np.pi / 4, 0.0]), neutral_values(scene), ())
    assert np.allclose(angles, -np.pi / 4, atol=1e-9)
    inputs[:, 0, :2, 0] = [-neutral_values(scene)[0], 0.0]
    angles = scene.predict_positions(recording(1, 60, inputs), np.array([-np.pi / 2, 0.0]), neutral_values(scene), ())
    assert np.allclose(angles, -np.pi / 2, atol=1e-9)


def test_lift_turns_about_the_stated_axis() -> None:
    """About the vertical, the level velocity turns by s t; about -y, a flight in space is one without a stated axis."""
    start, rows = np.array([0.0, 0.0, 1.0, 3.0, 0.0, 4.0]), 60
    plain, stated = build_flight_scene(3), build_flight_scene(3, has_spin_axis=True)
    shared = neutral_values(plain)
    shared[2] = 0.7
    inputs = np.zeros((rows, 1, 3, 2))
    inputs[:, 0, 2, 0] = 1.0
    t = recording(3, rows).t
    places = stated.predict_positions(recording(3, rows, inputs), start, shared, ())[:, 0]
    circle = 3.0 / 0.7 * np.stack([np.sin(0.7 * t), 1 - np.cos(0.7 * t)], axis=1)
    assert np.allclose(places, np.column_stack([circle, 1 + 4 * t - 9.81 / 2 * t**2]), atol=1e-8)
    inputs[:, 0, :, 0] = [0.0, -1.0, 0.0]
    same = [scene.predict_positions(recording(3, rows, given), start, shared, ()) for scene, given in
            ((plain, None), (stated, inputs))]  # fmt: skip
    assert np.allclose(*same, atol=1e-12)


def test_selected_rows_keep_their_inputs() -> None:
    whole = recording(2, 60, np.random.default_rng(0).normal(size=(60, 1, 2, 2)))
    part = whole.select_rows(10, 20)
    assert part.inputs is not None
    assert whole.inputs is not None
    assert np.array_equal(part.inputs, whole.inputs[10:20])
