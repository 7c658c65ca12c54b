"""Fit of particles with unknown physics: a physical model where one explains their coordinates, else a curve.

Springs and rods are used where their fit is accepted. Rigid bodies that collide, and curves, are compared on every
other sample, withheld from them for this purpose; the one with the least error is used, and this error is reported for
positions between samples. It belongs to twice the spacing of the samples, so that it is an upper bound.

The uncertainty of a prediction comes from predictions of the observed past.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.rigid_body_fit import fit_rigid_bodies
from models.estimation.rigid_bodies.rigid_world import group_rigid_points, has_fixed_distances
from models.estimation.springs.latent_inference import infer_springs
from models.neural.common.method_interface import fit_akima, fit_spline

# Function of times (M,) s that returns positions (M, N, D).
Motion = Callable[[FloatArray], FloatArray]

MIN_SAMPLES = 4
# Samples from which springs and collisions are fitted.
MIN_SAMPLES_FOR_PHYSICS = 12
# Particles among which springs are searched: every pair is a hypothesis.
MAX_SPRING_PARTICLES = 6
# Points that make a rigid body.
MIN_CORNERS = 3
MAX_BODIES = 200


@dataclass(frozen=True, slots=True)
class ParticleMotion:
    """A fitted motion of particles."""

    kind: str
    """springs, collisions, free flight, rigid bodies, or the name of a curve."""
    motion: Motion
    sigma: FloatArray
    """(N,) standard deviation of a coordinate between two samples."""
    parameters: dict[str, float]
    """Fitted parameters of the physics by name; empty for a curve."""
    parameter_sigma: dict[str, float] = field(default_factory=dict)
    """Standard deviations of the parameters, where they are known."""
    not_identifiable: tuple[str, ...] = ()
    """Sentences: which properties such coordinates cannot identify."""


ParticleFit = Callable[[Recording], tuple[Motion, dict[str, float]]]


def fit_particles(particles: Recording) -> ParticleMotion:
    """Fit the model of least error to the coordinates of particles.

    Args:
        particles: Observed particles.

    Returns:
        The motion, with its error between samples.
    """
    springs = fit_spring_motion(particles)
    if springs is not None:
        return springs
    fits = list_candidate_fits(particles)
    errors = {name: estimate_holdout_errors(particles, fit) for name, fit in fits.items()}
    kind = min(errors, key=lambda name: float(np.mean(errors[name] ** 2)))
    motion, numbers = fits[kind](particles)
    return ParticleMotion(kind, motion, errors[kind], numbers)


def fit_spring_motion(particles: Recording) -> ParticleMotion | None:
    """Fit springs, rods, collisions and gravity; None where they do not explain the observations."""
    count = len(particles.bodies)
    if (
        count > MAX_SPRING_PARTICLES
        or int(particles.is_observed.sum(axis=0).min()) < MIN_SAMPLES_FOR_PHYSICS
        or _has_coincident_particles(particles.positions)
    ):
        return None
    latent = infer_springs(particles)
    if not latent.is_accepted:
        return None
    numbers, errors = (dict(zip(latent.names, each.tolist(), strict=True)) for each in (latent.values, latent.sigma))
    kind = (
        "springs" if len(latent.graph.pairs) else "collisions" if len(latent.graph.colliding_pairs) else "free flight"
    )
    sigma = np.full(count, latent.noise)
    return ParticleMotion(kind, lambda t: latent.states_at(t)[:, 0], sigma, numbers, errors, latent.not_identifiable)


def _has_coincident_particles(x: FloatArray) -> bool:
    """Return whether two particles are ever observed at the same position, where a spring has no direction."""
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    return bool(np.any(np.triu(apart == 0, 1)))


def list_candidate_fits(particles: Recording) -> dict[str, ParticleFit]:
    """List the candidate fits: curves, and rigid bodies where several points belong to one."""
    fits: dict[str, ParticleFit] = {
        "linear": build_spline_fit(1),
        "cubic": build_spline_fit(3),
        "akima": build_spline_fit(None),
    }
    is_flat = particles.positions.shape[2] == 2
    if is_flat and len(particles.t) >= MIN_SAMPLES_FOR_PHYSICS and particles.is_observed.all():
        named = group_by_name(particles.bodies, particles.positions)
        labels = group_rigid_points(particles.positions) if named is None else named
        sizes = np.bincount(labels)
        if sizes.max() >= MIN_CORNERS and 1 < len(sizes) <= MAX_BODIES:
            fits["rigid bodies"] = lambda some: fit_rigid_motion(some, labels)
    return fits


def group_by_name(ids: tuple[str, ...], x: FloatArray) -> IntArray | None:
    """Group points into rigid bodies by their names.

    Points belong together if their names agree up to the last - . or _ (box1-a, box1-b, box1-c), and their distances
    are constant. A single point is a body of its own.

    Args:
        ids: N names.
        x: (T, N, D) coordinates, NaN where a point was not observed.

    Returns:
        (N,) body of each point; None where no name assigns points to a common body.
    """
    stems = [re.split(r"[-._](?=[^-._]*$)", name)[0] for name in ids]
    counts = Counter(stems)
    labels = np.arange(len(ids))
    has_group = False
    for stem, count in counts.items():
        mine = np.array([one == stem for one in stems])
        if count >= MIN_CORNERS and has_fixed_distances(x[:, mine]):
            labels[mine] = labels[mine][0]
            has_group = True
    return np.asarray(np.unique(labels, return_inverse=True)[1], np.int64) if has_group else None


def build_spline_fit(degree: int | None) -> ParticleFit:
    """Build the fit of a spline of a degree to each particle; of Akima's spline without a degree."""

    def fit(particles: Recording) -> tuple[Motion, dict[str, float]]:
        curves = [
            fit_spline(particles.t[there], particles.positions[there, k], degree) if degree else
            fit_akima(particles.t[there], particles.positions[there, k])
            for k, there in enumerate(particles.is_observed.T)
        ]  # fmt: skip
        return lambda t: np.stack([curve(t) for curve in curves], axis=1), {}

    return fit


def fit_rigid_motion(particles: Recording, labels: IntArray) -> tuple[Motion, dict[str, float]]:
    """Fit rigid bodies that collide."""
    motion = fit_rigid_bodies(particles.t, particles.positions, labels)
    world = motion.world
    numbers = {"friction": world.friction, "restitution": world.restitution, "drag": world.drag,
               "gravity x": float(world.gravity[0]), "gravity y": float(world.gravity[1])}  # fmt: skip
    return motion.positions_at, numbers


def estimate_holdout_errors(particles: Recording, fit: ParticleFit) -> FloatArray:
    """Measure the RMS error (N,) of a fit on every other sample, withheld from it; infinite with too few samples."""
    rows = np.arange(len(particles.t)) % 2 == 0
    hidden, is_observed = ~rows & (particles.t < particles.t[rows][-1]), particles.is_observed
    if int(is_observed[rows].sum(axis=0).min()) < MIN_SAMPLES or not is_observed[hidden].any(axis=0).all():
        return np.full(len(particles.bodies), np.inf)
    motion, _ = fit(particles.select_rows(0, len(rows), 2))
    off = motion(particles.t[hidden]) - particles.positions[hidden]
    return np.asarray(np.sqrt(np.nanmean(off**2, axis=(0, 2))), np.float64)


# Shares of the samples after which the rest is predicted and compared.
BACKTEST_SHARES = (0.5, 0.75)
# Last samples of a particle that a polynomial extrapolates.
EXTRAPOLATION_SAMPLES = 6
# Errors from which their growth is fitted.
MIN_ERRORS = 3
# Least (`MIN_GROWTH_POWER`) and largest power of time with which errors may grow.
MIN_GROWTH_POWER, MAX_GROWTH_POWER = 0.5, 3.0


@dataclass(frozen=True, slots=True)
class ParticlePrediction:
    """Predicted positions of N particles."""

    kind: str
    """springs, collisions, free flight, rigid bodies, falling or straight on."""
    t: FloatArray
    """(M,) s"""
    x: FloatArray
    """(M, N, D)"""
    sigma: FloatArray
    """(M,) standard deviation of a coordinate."""
    parameters: dict[str, float]
    """Fitted parameters of the physics by name."""
    parameter_sigma: dict[str, float] = field(default_factory=dict)
    """Standard deviations of the parameters, where they are known."""
    not_identifiable: tuple[str, ...] = ()
    """Sentences: which properties such coordinates cannot identify."""


@dataclass(frozen=True, slots=True)
class _ErrorGrowth:
    """A standard deviation that grows as `scale` times a power of the lead time."""

    floor: float
    scale: float
    power: float

    def sigma_at(self, lead: FloatArray) -> FloatArray:
        """Compute the standard deviation (M,) after lead times (M,) s."""
        return np.asarray(np.hypot(self.floor, self.scale * lead**self.power), np.float64)


def forecast_particles(particles: Recording, t: FloatArray) -> ParticlePrediction:
    """Predict the positions of particles after their last sample.

    Args:
        particles: Observed particles.
        t: (M,) s, after the last sample.

    Returns:
        The prediction by springs where they are accepted, else by the candidate of least error in the past.
    """
    fitted = fit_spring_motion(particles)
    if fitted is not None:
        errors = measure_backtest_errors(particles, _refit_springs)
    else:
        candidates: dict[str, ParticleFit] = {"straight on": build_extrapolation(1), "falling": build_extrapolation(2)}
        candidates |= {name: fit for name, fit in list_candidate_fits(particles).items() if name == "rigid bodies"}
        backtests = {name: measure_backtest_errors(particles, fit) for name, fit in candidates.items()}
        medians = {name: np.median(np.abs(off)) if len(off) else np.inf for name, (_, off) in backtests.items()}
        kind = min(medians, key=medians.__getitem__)
        errors, (motion, numbers) = backtests[kind], candidates[kind](particles)
        fitted = ParticleMotion(kind, motion, np.empty(0), numbers)
    sigma = fit_error_growth(*errors, particles).sigma_at(t - particles.t[-1])
    return ParticlePrediction(
        fitted.kind, t, fitted.motion(t), sigma, fitted.parameters, fitted.parameter_sigma, fitted.not_identifiable
    )


def _refit_springs(particles: Recording) -> tuple[Motion, dict[str, float]]:
    """Fit springs to fewer samples; extrapolate straight on where they are not accepted."""
    springs = fit_spring_motion(particles)
    return build_extrapolation(1)(particles) if springs is None else (springs.motion, springs.parameters)


def build_extrapolation(degree: int) -> ParticleFit:
    """Build the fit of a polynomial to the last samples of each particle.

    A line is fitted to half as many samples as a parabola.
    """

    def fit(past: Recording) -> tuple[Motion, dict[str, float]]:
        curves = []
        for k, there in enumerate(past.is_observed.T):
            recent = np.flatnonzero(there)[-(EXTRAPOLATION_SAMPLES * degree // 2) :]
            last = past.t[recent[-1]]
            curves.append((np.polyfit(past.t[recent] - last, past.positions[recent, k], degree), last))
        return lambda t: np.stack([np.polyval(curve, (t - last)[:, None]) for curve, last in curves], axis=1), {}

    return fit


def measure_backtest_errors(particles: Recording, fit: ParticleFit) -> tuple[FloatArray, FloatArray]:
    """Measure the errors of predictions from `BACKTEST_SHARES` of the past.

    Args:
        particles: Observed particles.
        fit: Fit whose predictions are compared.

    Returns:
        Lead times (L,) s and RMS errors (L,) over coordinates.
    """
    leads, errors = [], []
    for share in BACKTEST_SHARES:
        last = round(share * (len(particles.t) - 1))
        if int(particles.is_observed[: last + 1].sum(axis=0).min()) < EXTRAPOLATION_SAMPLES:
            continue
        motion, _ = fit(particles.select_rows(0, last + 1))
        later = slice(last + 1, None)
        off = motion(particles.t[later]) - particles.positions[later]
        there = np.isfinite(off).any(axis=(1, 2))
        leads.append((particles.t[later] - particles.t[last])[there])
        errors.append(np.sqrt(np.nanmean(off[there] ** 2, axis=(1, 2))))
    return (np.concatenate(leads), np.concatenate(errors)) if leads else (np.empty(0), np.empty(0))


def fit_error_growth(leads: FloatArray, errors: FloatArray, particles: Recording) -> _ErrorGrowth:
    """Fit a power law to errors (L,) at lead times (L,) s.

    With too few errors, the uncertainty is the extent of the motion.
    """
    there = (leads > 0) & (errors > 0)
    leads, errors = leads[there], errors[there]
    if len(leads) < MIN_ERRORS:
        return _ErrorGrowth(float(np.nanstd(particles.positions)), 0.0, 1.0)
    power = float(np.clip(np.polyfit(np.log(leads), np.log(errors), 1)[0], MIN_GROWTH_POWER, MAX_GROWTH_POWER))
    scale = float(np.sqrt(np.mean((errors / leads**power) ** 2)))
    return _ErrorGrowth(float(errors[np.argmin(leads)]), scale, power)
