"""Springs, dampers, rods and collisions against exact solutions and conservation laws; slopes against differences."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.physics.springs.spring_kernels import integrate_segments
from models.physics.springs.spring_system import (
    SpringSystem,
    build_springs,
    evaluate_spring_rate,
    fastest_rate_bound,
    integrate_springs,
    simulate_springs,
)

NO_GRAVITY = np.zeros(2)
DOWN = np.array([0.0, 981.0])


def resting(*places: tuple[float, ...]) -> FloatArray:
    x = np.array(places, np.float64)
    return np.stack([x, np.zeros_like(x)])


def pendulum(stiffness: float = 3000.0, damping: float = 1.0) -> tuple[SpringSystem, FloatArray]:
    """Scene I of the thesis: three balls in a row, the first one held."""
    graph = build_springs(np.ones(3), [(0, 1), (1, 2)], stiffness, damping, 80.0, DOWN, fixed=(0,))
    return graph, resting((200, 190), (280, 190), (360, 190))


def tumbling() -> tuple[SpringSystem, FloatArray]:
    """A triangle of springs with one rod, masses unequal, thrown and turning, with a fourth ball that collides."""
    graph = build_springs(
        np.array([1.0, 2.0, 0.5, 1.5]), [(0, 1), (1, 2), (2, 0)], np.array([900.0, np.inf, 400.0]),
        np.array([0.3, 0.0, 0.8]), np.array([50.0, 40.0, 60.0]), np.array([20.0, 300.0]), radius=20.0,
        contact=(5000.0, 0.0),
    )  # fmt: skip
    state = resting((0, 0), (50, 0), (50, 40), (94, 22))
    state[1] = [[30, 10], [30, 40], [30, 40], [-120, 5]]
    return graph, state


def swing(stiffness: float, damping: float, mass: float, t: FloatArray) -> FloatArray:
    """Exact: how a damped spring of rest length 0, drawn out by 1 and let go, swings."""
    decay, omega = damping / (2 * mass), np.sqrt(stiffness / mass - (damping / (2 * mass)) ** 2)
    return np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))


def spring_energy(graph: SpringSystem, x: FloatArray, v: FloatArray) -> float:
    """Return the kinetic, elastic and gravitational energy of particles at x with velocities v (N, D)."""
    free = ~graph.fixed
    moving = 0.5 * graph.mass[free] @ (v[free] ** 2).sum(axis=1)
    falling = -(graph.mass[free] @ (x[free] @ graph.gravity))
    length = np.linalg.norm(x[graph.pairs[:, 1]] - x[graph.pairs[:, 0]], axis=1)
    elongation = np.where(np.isinf(graph.stiffness), 0.0, length - graph.rest)
    stored = 0.5 * np.where(np.isinf(graph.stiffness), 0.0, graph.stiffness) @ elongation**2
    i, j = graph.colliding_pairs.T
    overlap = np.maximum(graph.radius[i] + graph.radius[j] - np.linalg.norm(x[j] - x[i], axis=1), 0.0)
    return float(moving + falling + stored + 0.5 * graph.contact[0] * (overlap**2).sum())


def oscillator(damping: float = 1.0) -> tuple[SpringSystem, FloatArray]:
    graph = build_springs(np.array([1.0, 2.0]), [(0, 1)], 50.0, damping, 10.0, NO_GRAVITY, fixed=(0,))
    return graph, resting((0, 0), (11, 0))


def test_steps_converge_with_order_8() -> None:
    graph, start = oscillator()
    exact, span, none = swing(50.0, 1.0, 2.0, np.array([1.0]))[0], np.array([1.0]), np.empty(0, np.int64)
    ends = [integrate_springs(graph, start[None], span, none, np.array([count])).ends[0] for count in (3, 6)]
    errors = [abs(end[0, 1, 0] - 10 - exact) for end in ends]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(8, abs=0.45)


def test_a_damped_spring_swings_as_its_formula_says() -> None:
    graph, start = oscillator()
    t = np.linspace(0, 5, 41)
    assert np.allclose(simulate_springs(graph, start, t)[:, 0, 1, 0] - 10, swing(50.0, 1.0, 2.0, t), atol=1e-7)


def test_a_rod_pendulum_has_the_period_of_the_elliptic_integral() -> None:
    """From rest at 90 degrees it is at the bottom after sqrt(L/g) K(m = 1/2) (Landau, Mechanics, section 11)."""
    graph = build_springs(np.ones(2), [(0, 1)], np.inf, 0.0, 80.0, DOWN, fixed=(0,))
    quarter = 1.8540746773013719 * np.sqrt(80 / 981)
    lowest = simulate_springs(graph, resting((0, 0), (80, 0)), np.linspace(0, quarter, 9))[-1]
    assert np.allclose(lowest[0, 1], (0, 80), atol=1e-4)


def test_undamped_springs_and_rods_keep_energy() -> None:
    graph, start = pendulum(3000.0, 0.0)
    path = simulate_springs(graph, start, np.linspace(0, 5, 76))
    spread = [spring_energy(graph, *state) for state in path]
    assert np.ptp(spread) < 1e-6 * 981 * 240
    rods, start = pendulum(np.inf, 0.0)
    spread = [spring_energy(rods, *state) for state in simulate_springs(rods, start, np.linspace(0, 5, 76))]
    assert np.ptp(spread) < 1e-6 * 981 * 240


def test_dampers_never_add_energy() -> None:
    graph, start = pendulum()
    energies = [spring_energy(graph, *state) for state in simulate_springs(graph, start, np.linspace(0, 5, 151))]
    assert np.all(np.diff(energies) < 1e-6)
    assert energies[-1] < energies[0] - 1.0


def test_momentum_follows_gravity_alone() -> None:
    graph, start = tumbling()
    t = np.linspace(0, 1, 11)
    path = simulate_springs(graph, start, t)
    momentum = np.einsum("i,tid->td", graph.mass, path[:, 1])
    assert np.allclose(momentum - momentum[0], graph.mass.sum() * np.outer(t, graph.gravity), atol=1e-8)


def test_rods_keep_their_length() -> None:
    graph, start = tumbling()
    path = simulate_springs(graph, start, np.linspace(0, 2, 21))
    assert np.allclose(np.linalg.norm(path[:, 0, 2] - path[:, 0, 1], axis=1), 40.0, atol=1e-4)


def test_balls_that_meet_exchange_their_velocities() -> None:
    graph = build_springs(np.ones(2), [], 0.0, 0.0, 0.0, NO_GRAVITY, radius=10.0, contact=(1e4, 0.0))
    start = resting((0, 0), (40, 0))
    start[1, 0, 0] = 100.0
    end = simulate_springs(graph, start, np.linspace(0, 1, 31))[-1]
    assert np.allclose(end[1], [[0, 0], [100, 0]], atol=0.3)


def test_turned_scenes_turn_their_motion() -> None:
    graph, start = tumbling()
    angle = 0.7
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    rotated = SpringSystem(
        *(getattr(graph, name) for name in SpringSystem.__slots__[:6]),
        graph.gravity @ turn,
        graph.radius,
        graph.contact,
    )
    t = np.linspace(0, 0.2, 7)
    assert np.allclose(simulate_springs(rotated, start @ turn, t), simulate_springs(graph, start, t) @ turn, atol=1e-6)


def test_an_axis_more_changes_nothing() -> None:
    graph, start = pendulum()
    deep = build_springs(np.ones(3), [(0, 1), (1, 2)], 3000.0, 1.0, 80.0, np.array([0.0, 981.0, 0.0]), fixed=(0,))
    t = np.linspace(0, 1, 16)
    path = simulate_springs(deep, np.concatenate([start, np.zeros((2, 3, 1))], axis=2), t)
    assert np.allclose(path[..., :2], simulate_springs(graph, start, t), atol=1e-8)


@pytest.mark.parametrize("scene", [pendulum, tumbling], ids=["pendulum", "tumbling"])
def test_slopes_are_finite_differences(scene: object) -> None:
    graph, start = pendulum() if scene is pendulum else tumbling()
    count = start.size + len(graph.parameters)
    spans = np.array([0.1])
    steps = np.array([60])
    slopes = integrate_springs(graph, start[None], spans, np.arange(count), steps).slopes[0]

    def end(inputs: FloatArray) -> FloatArray:
        ends, none = np.empty((1, *start.shape)), np.empty(0, np.int64)
        integrate_segments(
            inputs[: start.size].reshape(1, *start.shape).copy(), spans, steps, none, inputs[start.size :], graph.fixed,
            graph.pairs, graph.rods, graph.colliding_pairs, ends, np.empty((1, start.size, 0)),
        )  # fmt: skip
        return ends.ravel()

    inputs = np.concatenate([start.ravel(), graph.parameters])
    for k in range(count):
        if k < start.size and np.tile(np.repeat(graph.fixed, 2), 2)[k]:
            continue
        step = np.zeros(count)
        step[k] = 1e-5 * max(1.0, abs(inputs[k]))
        difference = (end(inputs + step) - end(inputs - step)) / (2 * step[k])
        assert np.allclose(slopes[:, k], difference, rtol=2e-4, atol=2e-4 * (1 + np.abs(difference).max())), k


@pytest.mark.parametrize("scene", [pendulum, tumbling], ids=["pendulum", "tumbling"])
def test_tangents_of_a_short_step_are_finite_differences_of_the_rate(scene: object) -> None:
    """To first order in dt a state moves on by dt times the slope of its rate."""
    graph, start = pendulum() if scene is pendulum else tumbling()
    dt, free = 1e-7, ~np.tile(np.repeat(graph.fixed, 2), 2)
    slopes = integrate_springs(graph, start[None], np.array([dt]), np.arange(start.size), np.array([1])).slopes[0]
    rates = (slopes - np.eye(start.size))[:, free] / dt
    shifts = 1e-5 * np.eye(start.size).reshape(-1, *start.shape)[free]
    differences = [evaluate_spring_rate(graph, start + s) - evaluate_spring_rate(graph, start - s) for s in shifts]
    assert np.allclose(rates, np.array(differences).reshape(len(shifts), -1).T / 2e-5, rtol=1e-3, atol=1e-2)


def test_no_swing_is_faster_than_its_bound() -> None:
    graph, _ = pendulum(1e5, 0.0)
    assert fastest_rate_bound(graph) == pytest.approx(np.sqrt(1e5 * (3 + np.sqrt(5)) / 2))


def test_graphs_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="two different particles"):
        build_springs(np.ones(2), [(0, 2)], 1.0, 0.0, 1.0, NO_GRAVITY)
    with pytest.raises(ValueError, match="above 0"):
        build_springs(np.array([1.0, 0.0]), [(0, 1)], 1.0, 0.0, 1.0, NO_GRAVITY)
