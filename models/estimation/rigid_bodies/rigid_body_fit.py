"""The rigid-body world behind tracked points, and the motion between and after the samples.

What friction, restitution, gravity, drag and the discs' radius and density are is found by the least surprise: the mean
distance between where a simulation from the last sample says that bodies will be and where they are seen (prediction
errors: Ljung 1999, System Identification, chapter 7).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.body_clusters import Bodies, assembled, groups
from models.estimation.rigid_bodies.body_trajectories import Beginning, Course, Follower, follow, levers, steps_for
from models.estimation.rigid_bodies.world_parameters import World, bend_error, guessed

ROUNDS = 2
"""over all numbers, with steps that are halved each time."""
BUSY = 0.8
"""share of all bending of paths that the samples hold on which numbers are sought."""
KNOWN = 0.01
"""relative error of a gravity that is seen well enough not to be sought."""
SEARCH_PASSES, FINAL_PASSES = 1, 4
"""simulations of an interval while numbers are sought, and with those that were found."""
FINER = 2
"""times as many steps at the end."""
LEAST_SAMPLES = 6
EXPLAINED = 0.7
"""of the surprise of going straight on: a world that leaves more explains nothing."""


@dataclass(frozen=True, slots=True)
class BoxesMotion:
    """Rigid bodies followed through their samples."""

    bodies: Bodies
    world: World
    course: Course
    sigma: float
    """standard deviation of a coordinate; NaN where no body is followed by several points."""
    surprise: float
    """mean distance between prediction and sight, over bodies and intervals, per axis."""
    straight: float
    """the same where bodies are foretold to go straight on."""
    follower: Follower

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why this should not be believed; empty where it may be."""
        if self.surprise < EXPLAINED * self.straight:
            return ()
        return ("rigid bodies that collide foretell these points hardly better than going straight on",)

    def at(self, t: FloatArray) -> FloatArray:
        """Points (M, N, 2) at times (M,), between the samples and after the last one."""
        course = self.course
        interval = np.clip(np.searchsorted(course.t, t, side="right") - 1, 0, len(course.t) - 1)
        found = np.empty((len(t), len(self.bodies.count), 3))
        for k in np.unique(interval):
            mine = interval == k
            found[mine] = self._within(int(k), t[mine]) if k < len(course.t) - 1 else self._after(t[mine])
        return self.bodies.points(found)

    def _within(self, k: int, t: FloatArray) -> FloatArray:
        """Places (M, B, 3) in interval k; what its simulation misses is made up for evenly."""
        course, steps = self.course, self.follower.steps
        span = float(course.t[k + 1] - course.t[k])
        share = ((t - course.t[k]) / span).clip(0, 1)
        path = self._path(course.begins[k], span, share * steps, steps)
        return np.asarray(path + share[:, None, None] * course.misses[k], np.float64)

    def _after(self, t: FloatArray) -> FloatArray:
        """Places (M, B, 3) after the last sample."""
        last = self.course.t[-1]
        step = float(np.median(np.diff(self.course.t))) / self.follower.steps
        steps = max(int(np.ceil(float((t - last).max()) / step)), 1)
        return self._path(self.course.begins[-1], steps * step, (t - last) / step, steps)

    def _path(self, begin: Beginning, span: float, at: FloatArray, steps: int) -> FloatArray:
        """Places (M, B, 3) after fractional numbers of steps (M,) of a simulation."""
        before = np.floor(at.clip(0, steps)).astype(np.int64)
        wanted = np.unique(np.concatenate([before, np.minimum(before + 1, steps)]))
        path = np.concatenate([begin.place[None], self.follower.run(begin, span, wanted[wanted > 0], steps)[0]])
        index = np.searchsorted(np.concatenate([[0], wanted[wanted > 0]]), [before, np.minimum(before + 1, steps)])
        share = (at - before)[:, None, None]
        return np.asarray((1 - share) * path[index[0]] + share * path[index[1]], np.float64)


def fit_boxes(t: FloatArray, x: FloatArray, body: IntArray | None = None, sigma: float | None = None) -> BoxesMotion:
    """The motion behind points x (T, N, 2) at t (T,). `body` (N,) says which points are fixed to the same body, else
    that is found; `sigma` is the standard deviation of a coordinate, else what rigid bodies leave.

    Raises `ValueError` where there are too few samples.
    """
    if len(t) < LEAST_SAMPLES:
        raise ValueError(f"{len(t)} samples; bodies that collide need at least {LEAST_SAMPLES}")
    bodies, places, left = assembled(x, groups(x) if body is None else body)
    noise = left if sigma is None else sigma
    known = noise if np.isfinite(noise) else 0.0
    error = known / np.sqrt(np.bincount(bodies.body).max())
    world, _ = _least_surprise(bodies, t, places, error)
    follower = Follower(bodies, world, FINER * steps_for(bodies, world, t, places))
    course = follow(follower, t, places, error, FINAL_PASSES)
    straight = _mean_length(np.diff(places, 2, axis=0), bodies)
    return BoxesMotion(bodies, world, course, noise, _mean_length(course.surprise[1:], bodies), straight, follower)


def _least_surprise(bodies: Bodies, t: FloatArray, places: FloatArray, sigma: float) -> tuple[World, float]:
    """The world that surprises least, number after number: down a parabola through three tries."""
    worlds = guessed(bodies, t, places, sigma)
    busy = _busy(places, bodies)
    steps = steps_for(bodies, worlds[0], t[busy], places[busy])
    known: dict[tuple[float, ...], float] = {}

    def surprise(world: World, part: slice) -> float:
        course = follow(Follower(bodies, world, steps), t[part], places[part], sigma, SEARCH_PASSES)
        # the first interval has no velocities from before
        return _mean_length(course.surprise[1:], bodies)

    # over a short time drag looks like falling: which of them it is, all samples tell
    world = min(worlds, key=lambda one: surprise(one, slice(None))) if len(worlds) > 1 else worlds[0]
    part = busy if world.gravity.any() else slice(None)  # what slows bodies seen from above acts all the time

    def cost(world: World) -> float:
        if (key := world.key) not in known:
            known[key] = surprise(world, part)
        return known[key]

    least = cost(world)
    seen = float(np.linalg.norm(world.gravity)) * KNOWN > bend_error(t, sigma)
    for number in range(ROUNDS):
        for change in _changes(bodies, world, 0.5**number, seen):
            world, least = _better(world, least, change, cost)
    return world, least


def _busy(places: FloatArray, bodies: Bodies) -> slice:
    """The fewest samples on end that hold most of what bends the paths: there numbers show, at a part of the cost."""
    bent = np.abs(np.diff(places, 2, axis=0) * levers(bodies)).sum(axis=(1, 2))
    before = np.concatenate([[0.0], np.cumsum(bent)])
    ends = np.searchsorted(before, before + BUSY * before[-1] - 1e-9 * before[-1])
    widths = np.where(ends < len(before), ends - np.arange(len(before)), len(before))
    first = int(np.argmin(widths))
    # a bend lies between three samples, and a simulation wants some to settle
    last = max(first + int(widths[first]) + 1, first + LEAST_SAMPLES - 1)
    return slice(max(min(first, len(places) - LEAST_SAMPLES), 0), last + 1)


def _better(
    world: World, least: float, change: Callable[[World, float], World], cost: Callable[[World], float]
) -> tuple[World, float]:
    """The best of a step down, a step up, and the bottom of the parabola through them, or of two steps where one is
    better and still going down."""
    low, high = (cost(change(world, step)) for step in (-1.0, 1.0))
    bend = low + high - 2 * least
    bottom = float(np.clip(0.5 * (low - high) / bend, -1, 1)) if bend > 0 else 0.0
    tries = [(least, 0.0), (low, -1.0), (high, 1.0)]
    if 0.1 < abs(bottom) < 0.9:
        tries.append((cost(change(world, bottom)), bottom))
    elif abs(min(tries)[1]) == 1:
        farther = 2 * min(tries)[1]
        tries.append((cost(change(world, farther)), farther))
    found, step = min(tries)
    return (change(world, step) if step else world), found


def _changes(
    bodies: Bodies, world: World, share: float, gravity_known: bool
) -> Iterator[Callable[[World, float], World]]:
    """What can be changed about a world, each by steps of about the size in which it is uncertain at first."""
    yield lambda w, s: replace(w, friction=max(w.friction + 0.1 * share * s, 0.0))
    yield lambda w, s: replace(w, restitution=min(max(w.restitution + 0.15 * share * s, 0.0), 1.0))
    if bodies.discs.any():
        yield lambda w, s: replace(w, radius=w.radius * (1 + 0.1 * share * s))
        yield lambda w, s: replace(w, density=w.density * 4.0 ** (share * s))
    if world.gravity.any() and not gravity_known:
        yield lambda w, s: replace(w, gravity=w.gravity * (1 + 0.05 * share * s))
    yield lambda w, s: replace(w, drag=max(w.drag + 0.5 * share * s, 0.0))


def _mean_length(off: FloatArray, bodies: Bodies) -> float:
    """Mean over intervals, bodies and axes of (K, B, 3), angles by the distance of the points."""
    return float(np.mean(np.abs(off * levers(bodies))))
