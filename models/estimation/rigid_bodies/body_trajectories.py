"""Bodies followed from sample to sample: the velocities with which a simulation arrives where they were seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.body_clusters import Bodies
from models.estimation.rigid_bodies.world_parameters import World
from models.physics.rigid_bodies.contact_impulses import march

CONTACTS_PER_BODY = 12
TRAVEL = 0.1
"""of a body's size that the fastest one may move in a step."""
FEWEST_STEPS, MOST_STEPS = 16, 400
"""between two samples."""
EAGERNESS = 0.7
"""of what a body misses its place by is put right by its next first velocity: contacts take some of it away."""


@dataclass(frozen=True, slots=True)
class Beginning:
    """From what a simulation begins."""

    place: FloatArray
    """(B, 3)"""
    start: FloatArray
    """(B, 3) velocities."""
    owners: IntArray
    """(C, 3) contacts as in `models.physics.rigid_bodies.collision_detection`, -1 where there is none."""
    pushed: FloatArray
    """(C, 2) what they pushed in the step before."""


def at_rest(place: FloatArray, start: FloatArray) -> Beginning:
    """Bodies at (B, 3) with velocities (B, 3) of whose contacts nothing is known."""
    most = CONTACTS_PER_BODY * len(place) + 8
    return Beginning(place, start, np.full((most, 3), -1), np.zeros((most, 2)))


@dataclass(frozen=True, slots=True)
class Course:
    """K samples of B bodies and the K - 1 simulations between them."""

    t: FloatArray
    """(K,)"""
    begins: tuple[Beginning, ...]
    """(K) from which the simulations begin, the last one that of the future."""
    misses: FloatArray
    """(K - 1, B, 3) from where they end to the next place."""
    surprise: FloatArray
    """(K - 1, B, 3) from where they would have ended with the velocities of the interval before to where the body was
    seen: what the world does not explain."""


@dataclass(frozen=True, slots=True)
class Follower:
    """Bodies in a world, with how finely it is simulated."""

    bodies: Bodies
    world: World
    steps: int
    """of a typical interval."""

    def run(self, begin: Beginning, span: float, samples: IntArray, steps: int) -> tuple[FloatArray, Beginning]:
        """Places (M, B, 3) after `samples` (M,) of `steps` steps of `span`, and the state after the last."""
        bodies, world = self.bodies, self.world
        q, v = begin.place.copy(), begin.start.copy()
        owners, pushed = begin.owners.copy(), begin.pushed.copy()
        found = np.empty((len(samples), *q.shape))
        reach = np.linalg.norm(bodies.corners, axis=2).max(axis=1) + world.radius
        march(
            q, v, bodies.corners, bodies.count, world.radius, reach, world.lightness(bodies), world.planes,
            world.laws(bodies), span / steps, samples, found, owners, pushed,
        )  # fmt: skip
        return found, Beginning(q, v, owners, pushed)


def steps_for(bodies: Bodies, world: World, t: FloatArray, places: FloatArray) -> int:
    """Steps of a typical interval."""
    size = bodies.size if np.isfinite(bodies.size) else float(np.median(world.radius))
    span = float(np.median(np.diff(t)))
    fastest = float(np.linalg.norm(np.diff(places[..., :2], axis=0), axis=2).max(initial=0.0))
    fall = float(np.linalg.norm(world.gravity)) * span**2
    return int(np.clip((fastest + fall) / (TRAVEL * size), FEWEST_STEPS, MOST_STEPS))


def turned_off(seen: FloatArray, found: FloatArray) -> FloatArray:
    """(B, 3) from where bodies are found to where they were seen; angles by the shorter way."""
    off = seen - found
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return off


def follow(follower: Follower, t: FloatArray, seen: FloatArray, sigma: float, passes: int) -> Course:
    """The course of bodies seen at (K, B, 3), with standard deviation sigma of the centres: each interval is simulated
    `passes` times, and velocities change only by what is more than noise."""
    lever = levers(follower.bodies)
    begin = at_rest(seen[0].copy(), Akima1DInterpolator(t, seen)(t[0], 1))
    begins, misses, surprises = [], [], []
    for k, span in enumerate(np.diff(t)):
        begin, end, miss, surprise = _arrive(follower, begin, seen[k + 1], float(span), lever, sigma, passes, k == 0)
        # where noise explains a miss, half of it: what was simulated is then as good as what was seen
        believed = np.maximum(_share(miss, lever, sigma), 0.5) if sigma > 0 else np.ones((len(miss), 1))
        begins.append(begin)
        misses.append(believed * miss)
        surprises.append(surprise)
        begin = replace(end, place=end.place + believed * miss, start=end.start + EAGERNESS * miss / span)
    return Course(t, (*begins, begin), np.array(misses), np.array(surprises))


def _arrive(
    follower: Follower, begin: Beginning, seen: FloatArray, span: float, lever: FloatArray, sigma: float, passes: int,
    settle: bool,
) -> tuple[Beginning, Beginning, FloatArray, FloatArray]:  # fmt: skip
    """The beginning whose velocities bring the bodies nearest to where they are seen, the end, what is still missed,
    and what was missed at first. To `settle`, each pass takes over what contacts pushed at the end of the last."""
    steps = np.array([follower.steps])
    best: tuple[float, Beginning, Beginning, FloatArray] | None = None
    surprise = np.zeros_like(begin.place)
    for number in range(passes):
        (last,), end = follower.run(begin, span, steps, follower.steps)
        miss = turned_off(seen, last)
        surprise = miss if number == 0 else surprise
        cost = float(np.abs(miss * lever).sum())
        if best is None or cost < best[0]:
            best = cost, begin, end, miss
        begin = replace(begin, start=begin.start + EAGERNESS * _share(miss, lever, sigma) * miss / span)
        if settle:
            begin = replace(begin, owners=end.owners, pushed=end.pushed)
    assert best is not None
    return best[1], best[2], best[3], surprise


def levers(bodies: Bodies) -> FloatArray:
    """(B, 3) that makes lengths of places: angles by the distance of the points."""
    lever = bodies.lever
    return np.stack([np.ones_like(lever), np.ones_like(lever), lever], axis=1)


def _share(miss: FloatArray, lever: FloatArray, sigma: float) -> FloatArray:
    """(B, 1) of a miss that is not noise: one less the noise's share of its square, not below 0 (James and Stein)."""
    if sigma <= 0:
        return np.ones((len(miss), 1))
    axes = np.where(lever[:, 2] > 0, 3, 2)
    square = ((miss * lever) ** 2).sum(axis=1) / axes
    return np.asarray(np.maximum(1 - 2 * sigma**2 / np.maximum(square, 1e-300), 0.0)[:, None], np.float64)
