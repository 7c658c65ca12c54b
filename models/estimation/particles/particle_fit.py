"""Particles of which only coordinates are known: the physics that explains them where there is one, else a curve.

Springs and rods are taken where their fit is accepted. Rigid bodies that collide, and curves, are compared on every
other sample, hidden from them for the purpose; what comes nearest is taken, and its error there is promised for the
places between samples. It is what is left at twice the spacing, so that it is an upper bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.body_clusters import groups
from models.estimation.rigid_bodies.rigid_body_fit import fit_boxes
from models.estimation.springs.latent_inference import infer
from models.neural.common.spline_methods import akima, spline

Motion = Callable[[FloatArray], FloatArray]
"""times (M,) s to places (M, N, D)."""

LEAST_SAMPLES = 4
LEAST_FOR_PHYSICS = 12
"""samples, from which springs and collisions are looked for."""
MOST_SPRUNG = 6
"""particles among which springs are looked for: every pair is a question."""
LEAST_CORNERS = 3
"""points that make a rigid body."""
MOST_BODIES = 200


@dataclass(frozen=True, slots=True)
class Particles:
    """N particles at T times in D axes; NaN where one was not seen."""

    t: FloatArray
    """(T,) s, growing."""
    x: FloatArray
    """(T, N, D)"""
    body: IntArray | None = None
    """(N,) which particles are fixed to the same rigid body, where that is known."""

    def __post_init__(self) -> None:
        if self.x.ndim != 3 or len(self.t) != len(self.x) or np.any(np.diff(self.t) <= 0):
            raise ValueError(f"particles are (T, N, D) at growing t (T,); got {self.x.shape} at {self.t.shape}")
        least = int(self.seen.sum(axis=0).min(initial=LEAST_SAMPLES))
        if least < LEAST_SAMPLES or not self.x.size:
            raise ValueError(f"every particle must be seen at least {LEAST_SAMPLES} times; one is seen {least} times")

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(T, N)"""
        return np.asarray(np.isfinite(self.x).all(axis=2), np.bool_)


@dataclass(frozen=True, slots=True)
class Explained:
    """A motion of particles, and what it is taken to be."""

    kind: str
    """springs, collisions, free flight, rigid bodies, or the name of a curve."""
    motion: Motion
    sigma: FloatArray
    """(N,) standard deviation of a coordinate between two samples."""
    numbers: dict[str, float]
    """What was found of the physics, by name; empty for a curve."""
    errors: dict[str, float] = field(default_factory=dict)
    """Their standard deviations, where these are known."""
    untold: tuple[str, ...] = ()
    """What such coordinates cannot tell of the physics."""


Fit = Callable[[Particles], tuple[Motion, dict[str, float]]]


def explain(particles: Particles) -> Explained:
    """The motion behind particles."""
    found = sprung(particles)
    if found is not None:
        return found
    errors = {name: between(particles, fit) for name, fit in fits(particles).items()}
    kind = min(errors, key=lambda name: float(np.mean(errors[name] ** 2)))
    motion, numbers = fits(particles)[kind](particles)
    return Explained(kind, motion, errors[kind], numbers)


def sprung(particles: Particles) -> Explained | None:
    """Springs, rods and gravity; None where they do not explain what was seen."""
    count = particles.x.shape[1]
    if count > MOST_SPRUNG or int(particles.seen.sum(axis=0).min()) < LEAST_FOR_PHYSICS or _meet(particles.x):
        return None
    latent = infer(particles.t, particles.x)
    if not latent.accepted:
        return None
    numbers, errors = (dict(zip(latent.names, each.tolist(), strict=True)) for each in (latent.values, latent.sigma))
    kind = "springs" if len(latent.graph.pairs) else "collisions" if len(latent.graph.touching) else "free flight"
    sigma = np.full(count, latent.noise)
    return Explained(kind, lambda t: latent.at(t)[:, 0], sigma, numbers, errors, latent.untold)


def _meet(x: FloatArray) -> bool:
    """Whether two particles (T, N, D) are ever seen at the same place, where no spring has a direction."""
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    return bool(np.any(np.triu(apart == 0, 1)))


def fits(particles: Particles) -> dict[str, Fit]:
    """What can be tried: curves, and rigid bodies where several points are fixed to one."""
    found: dict[str, Fit] = {"linear": curve_through(1), "cubic": curve_through(3), "akima": curve_through(None)}
    if particles.x.shape[2] == 2 and len(particles.t) >= LEAST_FOR_PHYSICS and particles.seen.all():
        labels = groups(particles.x) if particles.body is None else particles.body
        sizes = np.bincount(labels)
        if sizes.max() >= LEAST_CORNERS and 1 < len(sizes) <= MOST_BODIES:
            found["rigid bodies"] = lambda some: collided(some, labels)
    return found


def curve_through(degree: int | None) -> Fit:
    """A spline of a degree through each particle's own samples; Akima's where there is none."""

    def fit(particles: Particles) -> tuple[Motion, dict[str, float]]:
        curves = [
            spline(particles.t[there], particles.x[there, k], degree) if degree else
            akima(particles.t[there], particles.x[there, k])
            for k, there in enumerate(particles.seen.T)
        ]  # fmt: skip
        return lambda t: np.stack([curve(t) for curve in curves], axis=1), {}

    return fit


def collided(particles: Particles, labels: IntArray) -> tuple[Motion, dict[str, float]]:
    """Rigid bodies that push each other (`models.boxes`)."""
    found = fit_boxes(particles.t, particles.x, labels)
    world = found.world
    numbers = {"friction": world.friction, "restitution": world.restitution, "drag": world.drag,
               "gravity x": float(world.gravity[0]), "gravity y": float(world.gravity[1])}  # fmt: skip
    return found.at, numbers


def between(particles: Particles, fit: Fit) -> FloatArray:
    """(N,) root mean square error of a fit at every other sample, hidden from it; infinite where too few are left."""
    rows = np.arange(len(particles.t)) % 2 == 0
    hidden, seen = ~rows & (particles.t < particles.t[rows][-1]), particles.seen
    if int(seen[rows].sum(axis=0).min()) < LEAST_SAMPLES or not seen[hidden].any(axis=0).all():
        return np.full(particles.x.shape[1], np.inf)
    motion, _ = fit(Particles(particles.t[rows], particles.x[rows], particles.body))
    off = motion(particles.t[hidden]) - particles.x[hidden]
    return np.asarray(np.sqrt(np.nanmean(off**2, axis=(0, 2))), np.float64)
