"""Where particles will be, with how wrong the same way of telling was about what has been seen already."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from models.core.typing import FloatArray
from models.estimation.particles.particle_fit import Explained, Fit, Motion, Particles, fits, sprung

MOMENTS = (0.5, 0.75)
"""of the samples: from there what follows is foretold, and compared."""
RECENT = 6
"""samples that say where a particle goes if nothing else does."""
LEAST_ERRORS = 3
"""that say how errors grow."""
SLOWEST, FASTEST = 0.5, 3.0
"""powers of time with which errors may be taken to grow."""


@dataclass(frozen=True, slots=True)
class Foretold:
    """Places of N particles at times to come."""

    kind: str
    """springs, collisions, free flight, rigid bodies, falling or straight on."""
    t: FloatArray
    """(M,) s"""
    x: FloatArray
    """(M, N, D)"""
    sigma: FloatArray
    """(M,) standard deviation of a coordinate."""
    numbers: dict[str, float]
    """What was found of the physics, by name."""
    errors: dict[str, float] = field(default_factory=dict)
    """Their standard deviations, where these are known."""
    untold: tuple[str, ...] = ()
    """What such coordinates cannot tell of the physics."""


@dataclass(frozen=True, slots=True)
class Growth:
    """A standard deviation that grows as `scale` times lead to a power."""

    floor: float
    scale: float
    power: float

    def at(self, lead: FloatArray) -> FloatArray:
        """(M,) after leads (M,) s."""
        return np.asarray(np.hypot(self.floor, self.scale * lead**self.power), np.float64)


def foretell(past: Particles, t: FloatArray) -> Foretold:
    """Places at times t (M,) after the last sample."""
    springs = sprung(past)
    if springs is not None:
        growth = growth_of(*misses(past, _again), past)
        sigma = growth.at(t - past.t[-1])
        return Foretold(springs.kind, t, springs.motion(t), sigma, springs.numbers, springs.errors, springs.untold)
    ways: dict[str, Fit] = {"straight on": going_on(1), "falling": going_on(2)}
    ways |= {name: fit for name, fit in fits(past).items() if name == "rigid bodies"}
    wrong = {name: misses(past, fit) for name, fit in ways.items()}
    kind = min(wrong, key=lambda name: float(np.median(np.abs(wrong[name][1]))) if len(wrong[name][1]) else np.inf)
    motion, numbers = ways[kind](past)
    return Foretold(kind, t, motion(t), growth_of(*wrong[kind], past).at(t - past.t[-1]), numbers)


def _again(past: Particles) -> tuple[Motion, dict[str, float]]:
    """Springs, from fewer samples; where those do not suffice, straight on."""
    found: Explained | None = sprung(past)
    return going_on(1)(past) if found is None else (found.motion, found.numbers)


def going_on(degree: int) -> Fit:
    """The polynomial through the last samples of each particle, of degree 1 with half as many samples as of 2."""

    def fit(past: Particles) -> tuple[Motion, dict[str, float]]:
        curves: list[Callable[[FloatArray], FloatArray]] = []
        for k, there in enumerate(past.seen.T):
            recent = np.flatnonzero(there)[-(RECENT * degree // 2) :]
            last = past.t[recent[-1]]
            curves.append(_polynomial(np.polyfit(past.t[recent] - last, past.x[recent, k], degree), last))
        return lambda t: np.stack([curve(t) for curve in curves], axis=1), {}

    return fit


def _polynomial(coefficients: FloatArray, begin: float) -> Callable[[FloatArray], FloatArray]:
    def curve(t: FloatArray) -> FloatArray:
        powers = (t - begin)[:, None] ** np.arange(len(coefficients) - 1, -1, -1)
        return np.asarray(powers @ coefficients, np.float64)

    return curve


def misses(past: Particles, fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Leads (L,) s and root mean square errors (L,) over coordinates, foretold from `MOMENTS` of the past."""
    leads, errors = [], []
    for share in MOMENTS:
        last = round(share * (len(past.t) - 1))
        if int(past.seen[: last + 1].sum(axis=0).min()) < RECENT:
            continue
        motion, _ = fit(Particles(past.t[: last + 1], past.x[: last + 1], past.body))
        later = slice(last + 1, None)
        off = motion(past.t[later]) - past.x[later]
        there = np.isfinite(off).any(axis=(1, 2))
        leads.append((past.t[later] - past.t[last])[there])
        errors.append(np.sqrt(np.nanmean(off[there] ** 2, axis=(1, 2))))
    return (np.concatenate(leads), np.concatenate(errors)) if leads else (np.empty(0), np.empty(0))


def growth_of(leads: FloatArray, errors: FloatArray, past: Particles) -> Growth:
    """How errors (L,) grow with the lead (L,) s: a power law through them. Where there are none, everything is
    uncertain by the extent of the motion."""
    there = (leads > 0) & (errors > 0)
    leads, errors = leads[there], errors[there]
    if len(leads) < LEAST_ERRORS:
        return Growth(float(np.nanstd(past.x)), 0.0, 1.0)
    power = float(np.clip(np.polyfit(np.log(leads), np.log(errors), 1)[0], SLOWEST, FASTEST))
    scale = float(np.sqrt(np.mean((errors / leads**power) ** 2)))
    return Growth(float(errors[np.argmin(leads)]), scale, power)
