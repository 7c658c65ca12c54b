"""Tracking of bodies from sample to sample: velocities with which a simulation reaches the observed poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.body_clusters import Bodies
from models.estimation.rigid_bodies.world_parameters import RigidBodyWorld
from models.physics.rigid_bodies.contact_impulses import simulate_bodies

CONTACTS_PER_BODY = 12
TRAVEL = 0.1
"""Share of a body's size that the fastest one may move in a step."""
MIN_STEPS, MAX_STEPS = 16, 400
"""Least and largest number of steps between two samples."""
VELOCITY_GAIN = 0.7
"""Share of a pose error that the next initial velocity corrects: contacts absorb some of it."""


@dataclass(frozen=True, slots=True)
class BodyState:
    """Initial state of a simulation."""

    pose: FloatArray
    """(B, 3)"""
    velocity: FloatArray
    """(B, 3)"""
    contact_ids: IntArray
    """(C, 3) contacts as in `models.physics.rigid_bodies.collision_detection`, -1 where there is none."""
    contact_impulses: FloatArray
    """(C, 2) impulses of the contacts in the previous step."""


def start_without_contacts(pose: FloatArray, velocity: FloatArray) -> BodyState:
    """Create a state of poses (B, 3) and velocities (B, 3) without known contacts."""
    most = CONTACTS_PER_BODY * len(pose) + 8
    return BodyState(pose, velocity, np.full((most, 3), -1), np.zeros((most, 2)))


@dataclass(frozen=True, slots=True)
class BodyTrajectory:
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


def choose_steps(bodies: Bodies, world: RigidBodyWorld, t: FloatArray, places: FloatArray) -> int:
    """Choose the number of steps of a typical interval."""
    size = bodies.size if np.isfinite(bodies.size) else float(np.median(world.radius))
    span = float(np.median(np.diff(t)))
    fastest = float(np.linalg.norm(np.diff(places[..., :2], axis=0), axis=2).max(initial=0.0))
    fall = float(np.linalg.norm(world.gravity)) * span**2
    return int(np.clip((fastest + fall) / (TRAVEL * size), MIN_STEPS, MAX_STEPS))


def pose_difference(observed: FloatArray, predicted: FloatArray) -> FloatArray:
    """Compute (B, 3) from predicted to observed poses; angles by the shorter way."""
    off = observed - predicted
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return off


def track_bodies(
    simulator: BodySimulator, t: FloatArray, poses: FloatArray, sigma: float, passes: int
) -> BodyTrajectory:
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
    lever = pose_scales(simulator.bodies)
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
    return BodyTrajectory(t, (*begins, begin), np.array(misses), np.array(surprises))


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
        miss = pose_difference(observed, last)
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


def pose_scales(bodies: Bodies) -> FloatArray:
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
