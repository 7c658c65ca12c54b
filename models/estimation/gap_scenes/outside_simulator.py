"""A simulator from outside, and its motion under effects that it does not have.

Several runs are simulated side by side, such as those that differences need. Effects act between the steps of a
simulator: as forces, as changed inputs, or in the simulator itself, where it has the quantity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.mechanism_inputs import EffectValues, InputHistory, transform_all_inputs
from models.physics.mechanisms.mechanism_catalogue import MECHANISM_EFFECTS
from models.physics.mechanisms.mechanism_effect import Scale


@dataclass(frozen=True, slots=True)
class Joint:
    """A degree of freedom of a mechanism."""

    name: str
    unit: str
    """rad or m."""
    inertia: float = 1.0
    """kg m2 or kg about the joint alone; 1 where the simulator takes accelerations instead of forces."""
    limit: float = float("inf")
    """Largest position that it can have, in size."""
    body: str = ""
    """Of the three coordinates of a free body's place, or of the turn of one or of a ball joint: what they have in
    common, such as `ball` or `ball_turn`. Brakes that are no effects of the simulator act against the velocity."""
    tree: int = 0
    """Number that is the same for joints whose motions depend on each other: not so for the legs of a robot that is
    held, unless they touch."""


def group_joints(joints: Sequence[Joint]) -> tuple[tuple[str, ...], IntArray]:
    """Group the coordinates of free bodies; any other joint is a group of its own.

    Returns:
        Names of the groups, and the group (N,) of every joint.
    """
    keys = [(joint.body, "" if joint.body else joint.name) for joint in joints]
    groups = list(dict.fromkeys(keys))
    bodies = {body for body, _ in groups}
    # a joint may be called like a free body
    names = tuple(body or (f"{name}_joint" if name in bodies else name) for body, name in groups)
    return names, np.array([groups.index(key) for key in keys], np.int64)


@dataclass(frozen=True, slots=True)
class Drive:
    """What an input does on a joint."""

    joint: int
    """-1 where it acts on none, or on several."""
    gain: float
    """N, or N m, per unit of the input."""
    limit: float = float("inf")
    """Largest force, N or N m."""


class OutsideSimulator(Protocol):
    """A simulator of N joints with I inputs; its state is N positions, then N velocities."""

    @property
    def joints(self) -> tuple[Joint, ...]:
        """N joints."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the I inputs."""

    @property
    def servo_joints(self) -> tuple[int, ...]:
        """(I,) index of the joint whose position an input asks for; -1 for other inputs."""

    @property
    def drives(self) -> tuple[Drive, ...]:
        """What each of the I inputs does; empty where it is not known."""

    @property
    def time_step(self) -> float:
        """Length of a step, s."""

    @property
    def velocity_lag(self) -> float:
        """Time by which the velocities of its states lag behind the positions, s.

        Half a step of Euler's method that moves positions by the new velocities, else 0.
        """

    @property
    def takes_forces(self) -> bool:
        """Whether `advance` takes forces and torques; accelerations otherwise."""

    @property
    def is_free_beside_others(self) -> bool:
        """Whether a run costs next to nothing where others are simulated beside it."""

    @property
    def failure(self) -> str:
        """Why runs fail, as far as it says so; empty where it does not."""

    @property
    def last_mass(self) -> float:
        """Mass of the last body that moves, kg."""

    @property
    def rest(self) -> FloatArray:
        """(2N,) state as its file states it."""

    @property
    def own_effects(self) -> Mapping[str, tuple[float, ...]]:
        """Effects that it has itself, with the values of all their parameters.

        Absent ones have neutral values, and strengths that would change nothing NaN everywhere.
        """

    def begin(
        self, starts: FloatArray, values: Sequence[EffectValues], powered: BoolArray, shots: IntArray, t: FloatArray
    ) -> SimulatorRuns:
        """Begin runs side by side.

        Args:
            starts: (C, 2N) states.
            values: C values of its own effects; the others are as its file states.
            powered: (C, I) whether an actuator has power.
            shots: (C,) index of the shot.
            t: (C,) s, time in it.

        Returns:
            The runs.
        """


class SimulatorRuns(Protocol):
    """C runs of a simulator, side by side."""

    def advance(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Let the runs go on by M steps.

        Args:
            inputs: (C, M, I)
            force: (C, N) forces or accelerations on the joints during all steps.

        Returns:
            (C, M, 2N) states after each step; NaN from where a run fails.
        """


@dataclass(frozen=True, slots=True)
class Motions:
    """Simulated motions of one window: C columns, M steps, N joints."""

    edges: FloatArray
    """(M + 1,) s, ends of the steps."""
    states: FloatArray
    """(C, M + 1, 2N); NaN from where a simulation failed."""

    def at(self, t: FloatArray) -> FloatArray:
        """Interpolate states (C, T, 2N) at times (T,) s by positions and velocities (cubic Hermite)."""
        count = self.states.shape[2] // 2
        k = np.clip(np.searchsorted(self.edges, t, "right") - 1, 0, len(self.edges) - 2)
        h = (self.edges[k + 1] - self.edges[k])[:, None]
        s = ((t - self.edges[k]) / h[:, 0])[:, None]
        (q0, v0), (q1, v1) = (np.split(self.states[:, one], [count], axis=2) for one in (k, k + 1))
        with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
            slope = (q1 - q0) / h
            a, b = 3 * slope - 2 * v0 - v1, v0 + v1 - 2 * slope
            q = q0 + h * s * (v0 + s * (a + s * b))
            return np.concatenate([q, v0 + s * (2 * a + 3 * s * b)], axis=2)


# s for which a force that depends on the motion is held; a brake is exact for constant friction and inertia.
_FORCE_INTERVAL = 5e-3


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of a shot that is simulated from C starts, or under C strengths of effects."""

    shot: int
    span: tuple[float, float]
    """First and last time, s."""
    history: InputHistory
    """Inputs of the shot."""
    starts: FloatArray
    """(C, 2N) states at the first time."""
    values: Sequence[EffectValues]
    """C values of the effects that act."""

    def count_steps(self, time_step: float) -> int:
        """Count the steps (s) that it takes."""
        return max(int(np.ceil((self.span[1] - self.span[0]) / time_step - 1e-6)), 1)


# Ratio of the numbers of steps of stretches that are simulated side by side: the shorter ones go on in vain.
_MAX_STEP_RATIO = 1.2
# Numbers that the states of runs side by side may have, 80 MB.
_MAX_NUMBERS = 1e7


def simulate_motions(
    simulator: OutsideSimulator, stretches: Sequence[Stretch], scales: tuple[Scale, ...]
) -> list[Motions]:
    """Simulate a mechanism over several stretches, all of them side by side where their lengths are alike.

    A step costs a multiple where few runs take it together.

    Args:
        simulator: That of the mechanism, from outside.
        stretches: What to simulate.
        scales: N typical sizes of the joints.

    Returns:
        The motions of each stretch.
    """
    counts = [one.count_steps(simulator.time_step) for one in stretches]
    motions = dict[int, Motions]()
    rest = sorted(range(len(stretches)), key=lambda k: counts[k], reverse=True)
    while rest:
        most, runs = counts[rest[0]], np.cumsum([len(stretches[k].starts) for k in rest])
        fitting = (np.array([counts[k] for k in rest]) * _MAX_STEP_RATIO >= most) & (
            runs * most * 2 * len(scales) <= _MAX_NUMBERS
        )
        together = rest[: max(int(np.argmin([*fitting, False])), 1)]
        rest = rest[len(together) :]
        own = _simulate_together(simulator, [stretches[k] for k in together], most, scales)
        motions |= zip(together, own, strict=True)
    return [Motions(motions[k].edges[: count + 1], motions[k].states[:, : count + 1]) for k, count in enumerate(counts)]


def _simulate_together(
    simulator: OutsideSimulator, stretches: Sequence[Stretch], count: int, scales: tuple[Scale, ...]
) -> list[Motions]:
    """Simulate stretches side by side by a number of steps, also beyond the ends of some."""
    h, own, foreign, inputs, edges = simulator.time_step, [], list[EffectValues](), [], []
    for one in stretches:
        edges.append(np.asarray(one.span[0] + h * np.arange(count + 1), np.float64))
        outside = [_select_effects(acting, simulator, is_own=False) for acting in one.values]
        inputs.append(transform_all_inputs(one.history, edges[-1], outside))
        foreign += outside
        own += [_select_effects(acting, simulator, is_own=True) for acting in one.values]
    sizes = [len(one.starts) for one in stretches]
    given = np.concatenate(inputs)
    laws = _JointLaws(simulator, foreign, scales)
    hold = max(int(_FORCE_INTERVAL / h), 1) if laws.depend_on_motion else count
    states = np.full((len(foreign), count + 1, 2 * len(scales)), np.nan)
    states[:, 0] = starts = np.concatenate([one.starts for one in stretches])
    powered = np.repeat([one.history.is_powered(one.span[0]) for one in stretches], sizes, axis=0)
    runs = simulator.begin(
        starts, own, powered,
        np.repeat([one.shot for one in stretches], sizes), np.repeat([one.span[0] for one in stretches], sizes),
    )  # fmt: skip
    acceleration = total = np.zeros((len(foreign), len(scales)))
    for k in range(0, count, hold):
        q, v = states[:, k, : len(scales)], states[:, k, len(scales) :]
        now = laws.apply_dead_band(given[:, k : k + hold], q)
        dt = h * now.shape[1]
        force, brake = laws.evaluate(q, v, acceleration, total, dt)
        states[:, k + 1 : k + 1 + hold] = runs.advance(now, force + brake)
        total = (states[:, k + now.shape[1], len(scales) :] - v) / dt
        # what acts without the brakes, for the next interval
        acceleration = total - brake / laws.inertia
    parts = np.split(states, np.cumsum(sizes)[:-1])
    return [Motions(own_edges, part) for own_edges, part in zip(edges, parts, strict=True)]


def _select_effects(values: EffectValues, simulator: OutsideSimulator, is_own: bool) -> EffectValues:
    """Select the effects that a simulator has itself, or the others."""
    return {name: one for name, one in values.items() if (name in simulator.own_effects) == is_own}


class _JointLaws:
    """Effects that depend on the motion, where the simulator does not have them itself, for C runs."""

    def __init__(self, simulator: OutsideSimulator, values: Sequence[EffectValues], scales: tuple[Scale, ...]) -> None:
        names = sorted({name for acting in values for name in acting})
        laws = [(MECHANISM_EFFECTS[name], _stack_values(name, values, scales)) for name in names]
        self.laws = [(one, own) for one, own in laws if (one.brake, one.dry, one.force) != (None, None, None)]
        self.inertia = np.array([joint.inertia for joint in simulator.joints])
        self.speed, self.strength = np.array([s.speed for s in scales]), np.array([s.force for s in scales])
        self.middle, self.reach = np.array([s.middle for s in scales]), np.array([s.reach for s in scales])
        self.band = _stack_values("dead_band", values, scales)[0] if "dead_band" in names else None
        self.servo = np.array(simulator.servo_joints, np.int64)
        self.velocity_lag = simulator.velocity_lag
        groups = group_joints(simulator.joints)[1]
        self.is_alike = (groups[:, None] == groups).astype(np.float64)
        self.depend_on_motion = bool(self.laws) or self.band is not None

    def evaluate(
        self, q: FloatArray, v: FloatArray, acceleration: FloatArray, total: FloatArray, dt: float
    ) -> tuple[FloatArray, FloatArray]:
        """Evaluate forces and brakes (C, N) of the next dt (s), given accelerations without and with the brakes.

        Laws are taken at the middle of the interval: at its start they would lag by half of it, and a spring would then
        drive the motion. Where velocities lag behind the positions, that middle is as much earlier: a spring would
        brake the motion by as much. A brake is the mean force of v' = acceleration - rate v; dry friction stops a joint
        at most, and holds it. What brakes a free body depends on the size of its velocity, and acts against it.
        """
        force, rate, dry = np.zeros_like(q), np.zeros_like(q), np.zeros_like(q)
        ahead = dt / 2 - self.velocity_lag
        q, middle = q + (v + total * (self.velocity_lag + ahead / 2)) * ahead, v + total * dt / 2
        for effect, own in self.laws:
            # a generic law is one of the share of the reach and of the typical speed
            is_generic = effect.kind == "probe"
            place, speed, strength = q, middle, np.ones(1)
            if is_generic:
                place, speed, strength = (q - self.middle) / self.reach, middle / self.speed, self.strength
            if effect.force is not None:
                force += effect.force(place, speed, own)
            speed = self._measure_sizes(speed)
            if effect.brake is not None:
                rate += effect.brake(place, speed, own) * (strength / self.speed if is_generic else 1.0)
            if effect.dry is not None:
                dry += effect.dry(place, speed, own) * strength
        x = rate * dt / self.inertia
        with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
            decay = np.expm1(-x)
            lasting = -np.divide(decay, x, out=-np.ones_like(x), where=x != 0) - 1
            brake = self.inertia * (v * decay / dt + acceleration * lasting)
            end = v + (acceleration + brake / self.inertia) * dt
            size = self._measure_sizes(end)
            direction = np.divide(end, size, out=np.zeros_like(end), where=size > 0)
        return force, brake - direction * np.minimum(dry, size * self.inertia / dt)

    def _measure_sizes(self, v: FloatArray) -> FloatArray:
        """Return the size (C, N) of the velocity of the body that each joint belongs to."""
        with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
            return np.asarray(np.sqrt(np.square(v) @ self.is_alike))

    def apply_dead_band(self, inputs: FloatArray, q: FloatArray) -> FloatArray:
        """Reduce inputs (C, M, I), or errors of asked places, by the width of a band in which nothing happens."""
        if self.band is None:
            return inputs
        place = np.where(self.servo >= 0, q[:, self.servo], 0.0)[:, None]
        off = inputs - place
        return np.asarray(place + np.sign(off) * np.maximum(np.abs(off) - self.band[:, None], 0.0))


def _stack_values(name: str, values: Sequence[EffectValues], scales: tuple[Scale, ...]) -> tuple[FloatArray, ...]:
    """Stack the values (C, n) of each parameter of an effect, neutral ones where it is absent."""
    effect = MECHANISM_EFFECTS[name]
    present = next(acting[name] for acting in values if name in acting)
    absent = [
        np.array([strength.neutral(scale) for scale in scales]) if effect.site == "joint" else np.zeros_like(one)
        for strength, one in zip(effect.list_strengths(is_own=False), present, strict=True)
    ]
    return tuple(np.array([acting.get(name, absent)[k] for acting in values]) for k in range(len(present)))
