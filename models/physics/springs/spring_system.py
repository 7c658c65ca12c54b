"""Particles that springs, dampers and rods join: the mass-spring-damper model of Chen 2022, eqs 1 to 9.

Any graph in any number of axes: particles held in place, gravity in any direction, springs with dampers, rods (springs
of infinite stiffness), and collisions as stiff springs between surfaces. Units are the caller's own, such as px, s and
the mass of the first particle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.numerics.integrators import DOP853, Tableau
from models.physics.springs.spring_kernels import accelerate
from models.physics.springs.spring_tangents import flows

RADIANS_PER_STEP = 0.9
"""of the fastest swing: DOP853 is then off by about 1e-6 of its amplitude per step."""
SHARPNESS = 0.2
"""share of `RADIANS_PER_STEP` for collisions: their force has a kink, at which steps of high order lose it."""
MOST_STEPS = 10_000
"""of a stretch: a search that has gone astray shall not take for ever."""
TURN_PER_STEP = 0.3
"""rad that a pair may turn about its middle during one step."""


@dataclass(frozen=True, slots=True)
class Springs:
    """N particles in D axes, E pairs of them joined."""

    mass: FloatArray
    """(N,)"""
    held: BoolArray
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
            ("mass", (count,)), ("held", (count,)), ("pairs", (edges, 2)), ("stiffness", (edges,)),
            ("damping", (edges,)), ("rest", (edges,)), ("radius", (count,)), ("contact", (2,)),
        ):  # fmt: skip
            if getattr(self, name).shape != shape:
                raise ValueError(f"Springs.{name} must be {shape}; got {getattr(self, name).shape}")
        if np.any(self.mass <= 0) or np.any(self.rest[self.rods] <= 0):
            raise ValueError("masses and the lengths of rods must be above 0")
        if edges and (
            self.pairs.min() < 0 or self.pairs.max() >= count or np.any(self.pairs[:, 0] == self.pairs[:, 1])
        ):
            raise ValueError(f"a pair joins two different particles of {count}; got {self.pairs.tolist()}")

    @property
    def rods(self) -> IntArray:
        """(R,) numbers of the pairs that keep their length."""
        return np.flatnonzero(np.isinf(self.stiffness))

    @property
    def touching(self) -> IntArray:
        """(C, 2) pairs that collide: those with a radius that nothing joins."""
        joined = {frozenset(pair) for pair in self.pairs.tolist()}
        found = [
            pair for pair in combinations(range(len(self.mass)), 2)
            if frozenset(pair) not in joined and self.radius[list(pair)].sum() > 0
        ]  # fmt: skip
        return np.array(found, np.int64).reshape(-1, 2)

    @property
    def numbers(self) -> FloatArray:
        """(M,) all numbers: mass, stiffness (0 for rods), damping, rest, gravity, radius, contact."""
        stiffness = np.where(np.isinf(self.stiffness), 0.0, self.stiffness)
        parts = (self.mass, stiffness, self.damping, self.rest, self.gravity, self.radius, self.contact)
        return np.concatenate(parts).astype(np.float64)


def springs(
    mass: FloatArray,
    pairs: list[tuple[int, int]],
    stiffness: FloatArray | float,
    damping: FloatArray | float,
    rest: FloatArray | float,
    gravity: FloatArray,
    held: tuple[int, ...] = (),
    radius: FloatArray | float = 0.0,
    contact: tuple[float, float] = (0.0, 0.0),
) -> Springs:
    """A graph from plain numbers: one number stands for all springs, `held` counts particles."""
    masses = np.asarray(mass, np.float64)

    def each(given: FloatArray | float, size: int = len(pairs)) -> FloatArray:
        return np.broadcast_to(np.asarray(given, np.float64), size).copy()

    return Springs(
        masses, np.isin(np.arange(len(masses)), held), np.array(pairs, np.int64).reshape(-1, 2), each(stiffness),
        each(damping), each(rest), np.asarray(gravity, np.float64), each(radius, len(masses)), np.array(contact),
    )  # fmt: skip


def acceleration(graph: Springs, x: FloatArray, v: FloatArray) -> FloatArray:
    """(N, D) of particles at x with velocities v (N, D)."""
    found = np.empty_like(x)
    accelerate(
        x, v, graph.held, graph.mass, np.where(np.isinf(graph.stiffness), 0.0, graph.stiffness), graph.damping,
        graph.rest, graph.gravity, graph.radius, graph.contact, graph.pairs, graph.rods, graph.touching, found,
    )  # fmt: skip
    return found


def rate(graph: Springs, state: FloatArray) -> FloatArray:
    """Derivative of a state (2, N, D) by time, for `models.numerics.integrators`."""
    v = np.where(graph.held[:, None], 0.0, state[1])
    return np.stack([v, acceleration(graph, state[0], v)])


def slope(graph: Springs, state: FloatArray) -> FloatArray:
    """Jacobian (2 N D, 2 N D) of `rate`, by the complex step."""
    columns, step = [], 1e-30
    numbers = np.where(np.isinf(graph.stiffness), 0.0, graph.stiffness)
    given = [value.astype(np.complex128) for value in (graph.mass, numbers, graph.damping, graph.rest, graph.gravity)]
    surfaces = graph.radius.astype(np.complex128), graph.contact.astype(np.complex128)
    for k in range(state.size):
        shifted = state.astype(np.complex128)
        shifted.ravel()[k] += 1j * step
        shifted[1, graph.held] = 0.0
        pushed = np.empty_like(shifted[0])
        accelerate(
            shifted[0], shifted[1], graph.held, *given, *surfaces, graph.pairs, graph.rods, graph.touching, pushed
        )
        columns.append(np.stack([shifted[1], pushed]).imag.ravel() / step)
    return np.array(columns).T


def energy(graph: Springs, x: FloatArray, v: FloatArray) -> float:
    """Kinetic, elastic and gravitational energy of particles at x with velocities v (N, D)."""
    free = ~graph.held
    moving = 0.5 * graph.mass[free] @ (v[free] ** 2).sum(axis=1)
    falling = -(graph.mass[free] @ (x[free] @ graph.gravity))
    length = np.linalg.norm(x[graph.pairs[:, 1]] - x[graph.pairs[:, 0]], axis=1)
    stretch = np.where(np.isinf(graph.stiffness), 0.0, length - graph.rest)
    stored = 0.5 * np.where(np.isinf(graph.stiffness), 0.0, graph.stiffness) @ stretch**2
    i, j = graph.touching.T
    overlap = np.maximum(graph.radius[i] + graph.radius[j] - np.linalg.norm(x[j] - x[i], axis=1), 0.0)
    return float(moving + falling + stored + 0.5 * graph.contact[0] * (overlap**2).sum())


def fastest(graph: Springs, speed: float = 0.0) -> float:
    """rad/s: a bound on the fastest swing of the springs, and rate at which pairs turn where particles move at `speed`
    against each other."""
    lightness = np.where(graph.held, 0.0, 1 / graph.mass)
    pulls = np.zeros((len(graph.mass), len(graph.mass)))
    finite = np.isfinite(graph.stiffness)
    for (i, j), k, c in zip(graph.pairs[finite], graph.stiffness[finite], graph.damping[finite], strict=True):
        # strong dampers are as stiff as springs
        pulls[i, j] = pulls[j, i] = pulls[i, j] + max(k, c**2 * (lightness[i] + lightness[j]))
    # springs pull no harder than if all lay in one line: the graph's Laplacian bounds their stiffness in any pose
    laplacian = (np.diag(pulls.sum(axis=0)) - pulls) * np.sqrt(lightness * lightness[:, None])
    swing = float(np.linalg.eigvalsh(laplacian)[-1]) if np.isfinite(laplacian).all() else np.inf
    if len(graph.touching):
        swing += 2 * graph.contact[0] * float((lightness * (graph.radius > 0)).max()) / SHARPNESS**2
    turning = speed / float(graph.rest[graph.rest > 0].min()) if np.any(graph.rest > 0) else 0.0
    return max(float(np.sqrt(max(swing, 0.0))), turning * RADIANS_PER_STEP / TURN_PER_STEP)


@dataclass(frozen=True, slots=True)
class Flows:
    """Where K stretches of motion end, and how that hangs on where they begin and on the graph's numbers."""

    ends: FloatArray
    """(K, 2, N, D) places and velocities."""
    slopes: FloatArray
    """(K, 2 N D, M) by the M inputs that were asked for."""


def steps_for(graph: Springs, spans: FloatArray, speed: float = 0.0) -> IntArray:
    """(K,) how many steps of DOP853 stretches of `spans` (K,) s take, where particles move at `speed` at most."""
    asked = np.ceil(np.abs(spans) * fastest(graph, speed) / RADIANS_PER_STEP)
    return np.asarray(np.clip(np.nan_to_num(asked, nan=1.0), 1, MOST_STEPS), np.int64)


def flow(
    graph: Springs, starts: FloatArray, spans: FloatArray, inputs: IntArray, steps: IntArray, tableau: Tableau = DOP853
) -> Flows:
    """Move K states `starts` (K, 2, N, D) on by `spans` (K,) s in `steps` (K,), with exact slopes by `inputs` (M,).

    Inputs count the 2 N D numbers of a start first, then `Springs.numbers`. The slopes are those of the steps taken,
    exact to rounding.
    """
    count = len(starts)
    ends, slopes = np.empty_like(starts), np.empty((count, starts[0].size, len(inputs)))
    flows(
        np.ascontiguousarray(starts), spans, steps, tableau.a, tableau.b, graph.held, graph.numbers, graph.pairs,
        graph.rods, graph.touching, inputs, ends, slopes,
    )  # fmt: skip
    return Flows(ends, slopes)


def motion(graph: Springs, start: FloatArray, t: FloatArray) -> FloatArray:
    """States (T, 2, N, D) at times t (T,) s, growing, from `start` (2, N, D) at t[0]."""
    states, none = [start], np.empty(0, np.int64)
    for span in np.diff(t):
        steps = steps_for(graph, np.array([span]), 2 * float(np.abs(states[-1][1]).max()))
        states.append(flow(graph, states[-1][None], np.array([span]), none, steps).ends[0])
    return np.array(states)
