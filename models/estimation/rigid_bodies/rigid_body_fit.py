"""Fit of the rigid-body world behind tracked points, and the motion between and after the samples.

Friction, restitution, gravity, drag and the discs' radius and density minimize the mean distance between predictions
from the last sample and observations (prediction error method: Ljung 1999, System Identification, chapter 7).

Bodies are tracked from sample to sample by the velocities with which a simulation reaches the observed poses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.rigid_world import (
    Bodies,
    RigidBodyWorld,
    acceleration_error,
    assemble_bodies,
    group_rigid_points,
    guess_worlds,
)
from models.physics.rigid_bodies.contact_impulses import simulate_bodies

# Rounds over all parameters, with steps that are halved each time.
ROUNDS = 2
# Share of the total curvature of the paths in the samples to which the parameters are fitted.
BUSY_SHARE = 0.8
# Relative error of an observed gravity that needs no fit.
KNOWN_GRAVITY = 0.01
# Simulations of an interval during the search (`SEARCH_PASSES`), and with the final parameters.
SEARCH_PASSES, FINAL_PASSES = 1, 4
# Factor on the number of steps of the final simulation.
STEP_REFINEMENT = 2
MIN_SAMPLES = 6
# Prediction error over that of a straight line: a world with a larger ratio explains nothing.
MAX_ERROR_RATIO = 0.7


@dataclass(frozen=True, slots=True)
class RigidBodyMotion:
    """Rigid bodies followed through their samples."""

    bodies: Bodies
    world: RigidBodyWorld
    trajectory: _BodyTrajectory
    sigma: float
    """Standard deviation of a coordinate; NaN where every body has one point."""
    prediction_error: float
    """Mean distance between prediction and observation, over bodies and intervals, per axis."""
    straight_line_error: float
    """The same for straight lines."""
    simulator: BodySimulator

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons against using this motion; empty where there are none."""
        if self.prediction_error < MAX_ERROR_RATIO * self.straight_line_error:
            return ()
        return ("colliding rigid bodies predict these points hardly better than straight lines",)

    def positions_at(self, t: FloatArray) -> FloatArray:
        """Compute the positions (M, N, 2) of the points at times (M,), between the samples and after the last one."""
        course = self.trajectory
        interval = np.clip(np.searchsorted(course.t, t, side="right") - 1, 0, len(course.t) - 1)
        poses = np.empty((len(t), len(self.bodies.count), 3))
        for k in np.unique(interval):
            mine = interval == k
            poses[mine] = (
                self._interpolate_poses(int(k), t[mine]) if k < len(course.t) - 1 else self._extrapolate_poses(t[mine])
            )
        return self.bodies.point_positions(poses)

    def _interpolate_poses(self, k: int, t: FloatArray) -> FloatArray:
        """Compute the poses (M, B, 3) in interval k; the error at its end is distributed evenly."""
        course, steps = self.trajectory, self.simulator.steps
        span = float(course.t[k + 1] - course.t[k])
        share = ((t - course.t[k]) / span).clip(0, 1)
        path = self._simulate_fractional_steps(course.states[k], span, share * steps, steps)
        return np.asarray(path + share[:, None, None] * course.end_errors[k], np.float64)

    def _extrapolate_poses(self, t: FloatArray) -> FloatArray:
        """Compute the poses (M, B, 3) after the last sample."""
        last = self.trajectory.t[-1]
        step = float(np.median(np.diff(self.trajectory.t))) / self.simulator.steps
        steps = max(int(np.ceil(float((t - last).max()) / step)), 1)
        return self._simulate_fractional_steps(self.trajectory.states[-1], steps * step, (t - last) / step, steps)

    def _simulate_fractional_steps(self, begin: BodyState, span: float, at: FloatArray, steps: int) -> FloatArray:
        """Compute the poses (M, B, 3) after fractional numbers of steps (M,) of a simulation."""
        before = np.floor(at.clip(0, steps)).astype(np.int64)
        wanted = np.unique(np.concatenate([before, np.minimum(before + 1, steps)]))
        path = np.concatenate(
            [begin.pose[None], self.simulator.simulate_interval(begin, span, wanted[wanted > 0], steps)[0]]
        )
        index = np.searchsorted(np.concatenate([[0], wanted[wanted > 0]]), [before, np.minimum(before + 1, steps)])
        share = (at - before)[:, None, None]
        return np.asarray((1 - share) * path[index[0]] + share * path[index[1]], np.float64)


def fit_rigid_bodies(
    t: FloatArray, x: FloatArray, body: IntArray | None = None, sigma: float | None = None
) -> RigidBodyMotion:
    """Fit rigid bodies that collide to the positions of their points.

    Args:
        t: (T,) s, increasing.
        x: (T, N, 2) positions.
        body: (N,) body of each point; found from constant distances where not given.
        sigma: Standard deviation of a coordinate; the deviation from rigid bodies where not given.

    Returns:
        The motion.

    Raises:
        ValueError: There are too few samples.
    """
    if len(t) < MIN_SAMPLES:
        raise ValueError(f"{len(t)} samples; bodies that collide need at least {MIN_SAMPLES}")
    bodies, places, left = assemble_bodies(x, group_rigid_points(x) if body is None else body)
    noise = left if sigma is None else sigma
    finite_noise = noise if np.isfinite(noise) else 0.0
    error = finite_noise / np.sqrt(np.bincount(bodies.body).max())
    world, _ = _estimate_world(bodies, t, places, error)
    follower = BodySimulator(bodies, world, STEP_REFINEMENT * _choose_steps(bodies, world, t, places))
    course = _track_bodies(follower, t, places, error, FINAL_PASSES)
    straight = _mean_distance(np.diff(places, 2, axis=0), bodies)
    return RigidBodyMotion(
        bodies, world, course, noise, _mean_distance(course.prediction_errors[1:], bodies), straight, follower
    )


def _estimate_world(bodies: Bodies, t: FloatArray, places: FloatArray, sigma: float) -> tuple[RigidBodyWorld, float]:
    """Find the world of least prediction error, parameter after parameter, by parabolas through three trials."""
    worlds = guess_worlds(bodies, t, places, sigma)
    busy = _find_busiest_rows(places, bodies)
    steps = _choose_steps(bodies, worlds[0], t[busy], places[busy])
    costs: dict[tuple[float, ...], float] = {}

    def surprise(world: RigidBodyWorld, part: slice) -> float:
        course = _track_bodies(BodySimulator(bodies, world, steps), t[part], places[part], sigma, SEARCH_PASSES)
        # the first interval has no previous velocities
        return _mean_distance(course.prediction_errors[1:], bodies)

    # over a short time drag looks like gravity: only all samples together distinguish them
    world = min(worlds, key=lambda one: surprise(one, slice(None))) if len(worlds) > 1 else worlds[0]
    part = busy if world.gravity.any() else slice(None)  # without gravity, drag acts all the time

    def cost(world: RigidBodyWorld) -> float:
        if (key := world.search_key) not in costs:
            costs[key] = surprise(world, part)
        return costs[key]

    least = cost(world)
    gravity_known = float(np.linalg.norm(world.gravity)) * KNOWN_GRAVITY > acceleration_error(t, sigma)
    for number in range(ROUNDS):
        for change in _list_changes(bodies, world, 0.5**number, gravity_known):
            world, least = _search_along_change(world, least, change, cost)
    return world, least


def _find_busiest_rows(places: FloatArray, bodies: Bodies) -> slice:
    """Find the shortest run of samples with most of the curvature: it constrains the parameters best."""
    bent = np.abs(np.diff(places, 2, axis=0) * _pose_scales(bodies)).sum(axis=(1, 2))
    before = np.concatenate([[0.0], np.cumsum(bent)])
    ends = np.searchsorted(before, before + BUSY_SHARE * before[-1] - 1e-9 * before[-1])
    widths = np.where(ends < len(before), ends - np.arange(len(before)), len(before))
    first = int(np.argmin(widths))
    # a bend takes three samples, and a simulation needs some to settle
    last = max(first + int(widths[first]) + 1, first + MIN_SAMPLES - 1)
    return slice(max(min(first, len(places) - MIN_SAMPLES), 0), last + 1)


def _search_along_change(
    world: RigidBodyWorld,
    least: float,
    change: Callable[[RigidBodyWorld, float], RigidBodyWorld],
    cost: Callable[[RigidBodyWorld], float],
) -> tuple[RigidBodyWorld, float]:
    """Find the best of a step down, a step up, and the minimum of the parabola through them.

    Where one of the steps is better and the cost still falls, a double step is tried instead of the minimum.
    """
    low, high = (cost(change(world, step)) for step in (-1.0, 1.0))
    bend = low + high - 2 * least
    bottom = float(np.clip(0.5 * (low - high) / bend, -1, 1)) if bend > 0 else 0.0
    tries = [(least, 0.0), (low, -1.0), (high, 1.0)]
    if 0.1 < abs(bottom) < 0.9:
        tries.append((cost(change(world, bottom)), bottom))
    elif abs(min(tries)[1]) == 1:
        farther = 2 * min(tries)[1]
        tries.append((cost(change(world, farther)), farther))
    best_cost, step = min(tries)
    return (change(world, step) if step else world), best_cost


def _list_changes(
    bodies: Bodies, world: RigidBodyWorld, share: float, gravity_known: bool
) -> Iterator[Callable[[RigidBodyWorld, float], RigidBodyWorld]]:
    """List possible changes of a world, each in steps of about the initial uncertainty."""
    yield lambda w, s: replace(w, friction=max(w.friction + 0.1 * share * s, 0.0))
    yield lambda w, s: replace(w, restitution=min(max(w.restitution + 0.15 * share * s, 0.0), 1.0))
    if bodies.discs.any():
        yield lambda w, s: replace(w, radius=w.radius * (1 + 0.1 * share * s))
        yield lambda w, s: replace(w, density=w.density * 4.0 ** (share * s))
    if world.gravity.any() and not gravity_known:
        yield lambda w, s: replace(w, gravity=w.gravity * (1 + 0.05 * share * s))
    yield lambda w, s: replace(w, drag=max(w.drag + 0.5 * share * s, 0.0))


def _mean_distance(off: FloatArray, bodies: Bodies) -> float:
    """Compute the mean over intervals, bodies and axes of (K, B, 3), angles by the distance of the points."""
    return float(np.mean(np.abs(off * _pose_scales(bodies))))


CONTACTS_PER_BODY = 12
# Share of a body's size that the fastest one may move in a step.
TRAVEL = 0.1
# Least and largest number of steps between two samples.
MIN_STEPS, MAX_STEPS = 16, 400
# Share of a pose error that the next initial velocity corrects: contacts absorb some of it.
VELOCITY_GAIN = 0.7


@dataclass(frozen=True, slots=True)
class BodyState:
    """Initial state of a simulation."""

    pose: FloatArray
    """(B, 3)"""
    velocity: FloatArray
    """(B, 3)"""
    contact_ids: IntArray
    """(C, 3) contacts as in `models.physics.rigid_bodies.contact_impulses`, -1 where there is none."""
    contact_impulses: FloatArray
    """(C, 2) impulses of the contacts in the previous step."""


def start_without_contacts(pose: FloatArray, velocity: FloatArray) -> BodyState:
    """Create a state of poses (B, 3) and velocities (B, 3) without known contacts."""
    most = CONTACTS_PER_BODY * len(pose) + 8
    return BodyState(pose, velocity, np.full((most, 3), -1), np.zeros((most, 2)))


@dataclass(frozen=True, slots=True)
class _BodyTrajectory:
    """K samples of B bodies and the K - 1 simulations between them."""

    t: FloatArray
    """(K,)"""
    states: tuple[BodyState, ...]
    """(K) initial states of the simulations, the last one for the future."""
    end_errors: FloatArray
    """(K - 1, B, 3) from their ends to the next pose."""
    prediction_errors: FloatArray
    """(K - 1, B, 3) from predictions with the velocities of the previous interval to the observed poses."""


@dataclass(frozen=True, slots=True)
class BodySimulator:
    """Bodies in a world, and the step of their simulation."""

    bodies: Bodies
    world: RigidBodyWorld
    steps: int
    """Steps of a typical interval."""

    def simulate_interval(
        self, state: BodyState, span: float, samples: IntArray, steps: int
    ) -> tuple[FloatArray, BodyState]:
        """Simulate an interval.

        Args:
            state: Initial state.
            span: s, duration of the interval.
            samples: (M,) step numbers to record.
            steps: Number of steps.

        Returns:
            Poses (M, B, 3), and the state after the last step.
        """
        bodies, world = self.bodies, self.world
        q, v = state.pose.copy(), state.velocity.copy()
        contact_ids, contact_impulses = state.contact_ids.copy(), state.contact_impulses.copy()
        poses = np.empty((len(samples), *q.shape))
        reach = np.linalg.norm(bodies.corners, axis=2).max(axis=1) + world.radius
        simulate_bodies(
            q, v, bodies.corners, bodies.count, world.radius, reach, world.inverse_masses(bodies), world.planes,
            world.kernel_parameters(bodies), span / steps, samples, poses, contact_ids, contact_impulses,
        )  # fmt: skip
        return poses, BodyState(q, v, contact_ids, contact_impulses)


def _choose_steps(bodies: Bodies, world: RigidBodyWorld, t: FloatArray, places: FloatArray) -> int:
    """Choose the number of steps of a typical interval."""
    size = bodies.size if np.isfinite(bodies.size) else float(np.median(world.radius))
    span = float(np.median(np.diff(t)))
    fastest = float(np.linalg.norm(np.diff(places[..., :2], axis=0), axis=2).max(initial=0.0))
    fall = float(np.linalg.norm(world.gravity)) * span**2
    return int(np.clip((fastest + fall) / (TRAVEL * size), MIN_STEPS, MAX_STEPS))


def _pose_difference(observed: FloatArray, predicted: FloatArray) -> FloatArray:
    """Compute (B, 3) from predicted to observed poses; angles by the shorter way."""
    off = observed - predicted
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return off


def _track_bodies(
    simulator: BodySimulator, t: FloatArray, poses: FloatArray, sigma: float, passes: int
) -> _BodyTrajectory:
    """Follow observed bodies by simulations; velocities change only by what exceeds the noise.

    Args:
        simulator: Bodies, world and step.
        t: (K,) s.
        poses: (K, B, 3) observed poses.
        sigma: Standard deviation of the centres.
        passes: Simulations of each interval.

    Returns:
        The trajectory.
    """
    lever = _pose_scales(simulator.bodies)
    begin = start_without_contacts(poses[0].copy(), Akima1DInterpolator(t, poses)(t[0], 1))
    begins, misses, surprises = [], [], []
    for k, span in enumerate(np.diff(t)):
        begin, end, miss, surprise = _match_next_sample(
            simulator, begin, poses[k + 1], float(span), lever, sigma, passes, k == 0
        )
        # if noise explains an error, correct half of it: the simulation is then as good as the observation
        believed = np.maximum(_signal_share(miss, lever, sigma), 0.5) if sigma > 0 else np.ones((len(miss), 1))
        begins.append(begin)
        misses.append(believed * miss)
        surprises.append(surprise)
        begin = replace(end, pose=end.pose + believed * miss, velocity=end.velocity + VELOCITY_GAIN * miss / span)
    return _BodyTrajectory(t, (*begins, begin), np.array(misses), np.array(surprises))


def _match_next_sample(
    simulator: BodySimulator, begin: BodyState, observed: FloatArray, span: float, lever: FloatArray, sigma: float,
    passes: int, settle: bool,
) -> tuple[BodyState, BodyState, FloatArray, FloatArray]:  # fmt: skip
    """Find the velocities that bring the bodies nearest to the next sample.

    To `settle`, each pass continues with the contact impulses at the end of the previous one. Return the initial state,
    the end state, the remaining pose error, and the first one.
    """
    steps = np.array([simulator.steps])
    best: tuple[float, BodyState, BodyState, FloatArray] | None = None
    surprise = np.zeros_like(begin.pose)
    for number in range(passes):
        (last,), end = simulator.simulate_interval(begin, span, steps, simulator.steps)
        miss = _pose_difference(observed, last)
        surprise = miss if number == 0 else surprise
        cost = float(np.abs(miss * lever).sum())
        if best is None or cost < best[0]:
            best = cost, begin, end, miss
        begin = replace(
            begin, velocity=begin.velocity + VELOCITY_GAIN * _signal_share(miss, lever, sigma) * miss / span
        )
        if settle:
            begin = replace(begin, contact_ids=end.contact_ids, contact_impulses=end.contact_impulses)
    assert best is not None
    return best[1], best[2], best[3], surprise


def _pose_scales(bodies: Bodies) -> FloatArray:
    """Compute factors (B, 3) that convert poses into lengths: angles by the distance of the points."""
    lever = bodies.lever
    return np.stack([np.ones_like(lever), np.ones_like(lever), lever], axis=1)


def _signal_share(miss: FloatArray, lever: FloatArray, sigma: float) -> FloatArray:
    """Compute the share (B, 1) of a pose error that is not noise.

    It is one minus the noise's share of its square, at least 0 (James and Stein).
    """
    if sigma <= 0:
        return np.ones((len(miss), 1))
    axes = np.where(lever[:, 2] > 0, 3, 2)
    square = ((miss * lever) ** 2).sum(axis=1) / axes
    return np.asarray(np.maximum(1 - 2 * sigma**2 / np.maximum(square, 1e-300), 0.0)[:, None], np.float64)
