"""Particles that springs, dampers and rods join: the mass-spring-damper model of Chen 2022, equations 1 to 9.

Any graph in any number of axes: particles at fixed places, gravity in any direction, springs with dampers, rods
(springs of infinite stiffness), and collisions as stiff springs between surfaces. Units are the caller's own, such as
px, s and the mass of the first particle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.physics.springs.spring_kernels import fill_accelerations, integrate_segments

# rad of the fastest oscillation; the error of DOP853 is then about 1e-6 of its amplitude per step.
RADIANS_PER_STEP = 0.9
# Part of `RADIANS_PER_STEP` for collisions: at the kink of their force, methods of high order lose it.
COLLISION_STEP_SHARE = 0.2
# Most steps of a segment, so that a fit that diverges ends.
MOST_STEPS = 10_000
# rad that a pair may turn about its middle during one step.
TURN_PER_STEP = 0.3


@dataclass(frozen=True, slots=True)
class SpringSystem:
    """N particles in D axes, E pairs of which are joined."""

    mass: FloatArray
    """(N,)"""
    fixed: BoolArray
    """(N,) True where a particle never moves."""
    pairs: IntArray
    """(E, 2) which particles are joined."""
    stiffness: FloatArray
    """(E,) mass/s^2; infinite for a rod."""
    damping: FloatArray
    """(E,) mass/s."""
    rest: FloatArray
    """(E,) length at which a spring does not pull."""
    gravity: FloatArray
    """(D,) length/s^2."""
    radius: FloatArray
    """(N,) of the surfaces that collide; 0 where nothing does."""
    contact: FloatArray
    """(2,) stiffness and damping of collisions."""

    def __post_init__(self) -> None:
        count, edges = len(self.mass), len(self.pairs)
        for name, shape in (
            ("mass", (count,)), ("fixed", (count,)), ("pairs", (edges, 2)), ("stiffness", (edges,)),
            ("damping", (edges,)), ("rest", (edges,)), ("radius", (count,)), ("contact", (2,)),
        ):  # fmt: skip
            if getattr(self, name).shape != shape:
                raise ValueError(f"SpringSystem.{name} must be {shape}; got {getattr(self, name).shape}")
        if np.any(self.mass <= 0) or np.any(self.rest[self.rods] <= 0):
            raise ValueError("masses and the lengths of rods must be above 0")
        if edges and (
            self.pairs.min() < 0 or self.pairs.max() >= count or np.any(self.pairs[:, 0] == self.pairs[:, 1])
        ):
            raise ValueError(f"a pair joins two different particles of {count}; got {self.pairs.tolist()}")

    @property
    def rods(self) -> IntArray:
        """(R,) rows of the pairs that keep their length."""
        return np.flatnonzero(np.isinf(self.stiffness))

    @property
    def colliding_pairs(self) -> IntArray:
        """(C, 2) pairs that collide: those with a radius that nothing joins."""
        joined = {frozenset(pair) for pair in self.pairs.tolist()}
        pairs = [
            pair for pair in combinations(range(len(self.mass)), 2)
            if frozenset(pair) not in joined and self.radius[list(pair)].sum() > 0
        ]  # fmt: skip
        return np.array(pairs, np.int64).reshape(-1, 2)

    @property
    def parameters(self) -> FloatArray:
        """(M,) all parameters: mass, stiffness (0 for rods), damping, rest, gravity, radius, contact."""
        stiffness = np.where(np.isinf(self.stiffness), 0.0, self.stiffness)
        parts = (self.mass, stiffness, self.damping, self.rest, self.gravity, self.radius, self.contact)
        return np.concatenate(parts).astype(np.float64)


def build_springs(
    mass: FloatArray,
    pairs: list[tuple[int, int]],
    stiffness: FloatArray | float,
    damping: FloatArray | float,
    rest: FloatArray | float,
    gravity: FloatArray,
    fixed: tuple[int, ...] = (),
    radius: FloatArray | float = 0.0,
    contact: tuple[float, float] = (0.0, 0.0),
) -> SpringSystem:
    """Build a system from plain numbers; one number stands for all springs.

    Args:
        mass: (N,) masses.
        pairs: E pairs of particles.
        stiffness: (E,) mass/s^2; infinite for a rod.
        damping: (E,) mass/s.
        rest: (E,) length without tension.
        gravity: (D,) length/s^2.
        fixed: Particles that never move.
        radius: (N,) of the surfaces that collide; 0 for none.
        contact: Stiffness and damping of collisions.

    Returns:
        The system.
    """
    masses = np.asarray(mass, np.float64)

    def each(given: FloatArray | float, size: int = len(pairs)) -> FloatArray:
        return np.broadcast_to(np.asarray(given, np.float64), size).copy()

    return SpringSystem(
        masses, np.isin(np.arange(len(masses)), fixed), np.array(pairs, np.int64).reshape(-1, 2), each(stiffness),
        each(damping), each(rest), np.asarray(gravity, np.float64), each(radius, len(masses)), np.array(contact),
    )  # fmt: skip


def evaluate_acceleration(graph: SpringSystem, x: FloatArray, v: FloatArray) -> FloatArray:
    """Evaluate the accelerations of the particles.

    Args:
        graph: The system.
        x: (N, D) places.
        v: (N, D) velocities.

    Returns:
        (N, D) accelerations.
    """
    result, parameters = np.empty((*x.shape, 1)), graph.parameters
    fill_accelerations(
        np.stack([x, v])[..., None], parameters, np.zeros(len(parameters), np.int64), graph.fixed, graph.pairs,
        graph.rods, graph.colliding_pairs, result,
    )  # fmt: skip
    return result[..., 0]


def evaluate_spring_rate(graph: SpringSystem, state: FloatArray) -> FloatArray:
    """Evaluate the time derivative of a state.

    Args:
        graph: The system.
        state: (2, N, D) places and velocities.

    Returns:
        (2, N, D) derivative.
    """
    v = np.where(graph.fixed[:, None], 0.0, state[1])
    return np.stack([v, evaluate_acceleration(graph, state[0], v)])


def fastest_rate_bound(graph: SpringSystem, speed: float = 0.0) -> float:
    """Bound the fastest oscillation of the springs and rotation of pairs, rad/s.

    `speed` is the greatest speed of particles relative to each other.
    """
    lightness = np.where(graph.fixed, 0.0, 1 / graph.mass)
    pulls = np.zeros((len(graph.mass), len(graph.mass)))
    finite = np.isfinite(graph.stiffness)
    for (i, j), k, c in zip(graph.pairs[finite], graph.stiffness[finite], graph.damping[finite], strict=True):
        # strong dampers are as stiff as springs
        pulls[i, j] = pulls[j, i] = pulls[i, j] + max(k, c**2 * (lightness[i] + lightness[j]))
    # springs pull no harder than if all lay in one line: the graph's Laplacian bounds their stiffness in any pose
    laplacian = (np.diag(pulls.sum(axis=0)) - pulls) * np.sqrt(lightness * lightness[:, None])
    swing = float(np.linalg.eigvalsh(laplacian)[-1]) if np.isfinite(laplacian).all() else np.inf
    if len(graph.colliding_pairs):
        swing += 2 * graph.contact[0] * float((lightness * (graph.radius > 0)).max()) / COLLISION_STEP_SHARE**2
    turning = speed / float(graph.rest[graph.rest > 0].min()) if np.any(graph.rest > 0) else 0.0
    return max(float(np.sqrt(max(swing, 0.0))), turning * RADIANS_PER_STEP / TURN_PER_STEP)


@dataclass(frozen=True, slots=True)
class SpringMotion:
    """Ends of K segments of motion, and their derivatives by initial states and parameters."""

    ends: FloatArray
    """(K, 2, N, D) places and velocities."""
    slopes: FloatArray
    """(K, 2 N D, M) by the M inputs that were asked for."""


def count_steps(graph: SpringSystem, spans: FloatArray, speed: float = 0.0) -> IntArray:
    """Count the steps of DOP853 that segments need.

    Args:
        graph: The system.
        spans: (K,) s.
        speed: Greatest speed of particles relative to each other, length/s.

    Returns:
        (K,) numbers of steps.
    """
    counts = np.ceil(np.abs(spans) * fastest_rate_bound(graph, speed) / RADIANS_PER_STEP)
    return np.asarray(np.clip(np.nan_to_num(counts, nan=1.0), 1, MOST_STEPS), np.int64)


def integrate_springs(
    graph: SpringSystem, starts: FloatArray, spans: FloatArray, inputs: IntArray, steps: IntArray
) -> SpringMotion:
    """Integrate states over time, with derivatives that are those of the steps, exact to rounding.

    Args:
        graph: The system.
        starts: (K, 2, N, D) states.
        spans: (K,) s.
        inputs: (M,) inputs to differentiate by: the 2 N D numbers of a start, then those of `SpringSystem.parameters`.
        steps: (K,) numbers of steps.

    Returns:
        Ends and derivatives.
    """
    count = len(starts)
    ends, slopes = np.empty_like(starts), np.empty((count, starts[0].size, len(inputs)))
    integrate_segments(
        np.ascontiguousarray(starts), spans, steps, inputs, graph.parameters, graph.fixed, graph.pairs, graph.rods,
        graph.colliding_pairs, ends, slopes,
    )  # fmt: skip
    return SpringMotion(ends, slopes)


def simulate_springs(graph: SpringSystem, start: FloatArray, t: FloatArray) -> FloatArray:
    """Simulate a system from a state.

    Args:
        graph: The system.
        start: (2, N, D) state at t[0].
        t: (T,) s, ascending.

    Returns:
        (T, 2, N, D) states.
    """
    states, none = [start], np.empty(0, np.int64)
    for span in np.diff(t):
        steps = count_steps(graph, np.array([span]), 2 * float(np.abs(states[-1][1]).max()))
        states.append(integrate_springs(graph, states[-1][None], np.array([span]), none, steps).ends[0])
    return np.array(states)
