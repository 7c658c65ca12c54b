"""Latent inference: masses, springs, dampers, gravity and who is joined to whom, from coordinates alone.

Chen 2022 names it in the abstract; here the mass-spring-damper model itself (eqs 1 to 9) is fitted. How stiff springs
are is searched on a ladder from soft to rods; springs that are too stiff to be seen stretching become rods, with a
bound on their stiffness; particles that turn round at a jolt are tried as surfaces that collide. A fit that leaves more
than noise is refused, and says so; so is what the coordinates cannot tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.springs.colliding_particles import colliding
from models.estimation.springs.coordinate_series import Coordinates, held, noise
from models.estimation.springs.fit_quality import doubts, least_stiffness
from models.estimation.springs.graph_search import searched
from models.estimation.springs.identifiability import hidden_depth, sentences
from models.estimation.springs.model_reduction import simplified
from models.estimation.springs.spring_fit import SpringFit, covariance
from models.physics.springs.spring_system import Springs, flow, motion, steps_for


@dataclass(frozen=True, slots=True)
class Latent:
    """What coordinates say of the springs behind them."""

    t: FloatArray
    """(T,) s, of the samples."""
    states: FloatArray
    """(T, 2, N, D) places and velocities at the samples."""
    graph: Springs
    """Masses are relative to the first free particle of every group that hangs together."""
    names: tuple[str, ...]
    """(P,) of the numbers that were fitted."""
    values: FloatArray
    """(P,)"""
    sigma: FloatArray
    """(P,)"""
    least_stiffness: FloatArray
    """(E,) what the stiffness of a rod exceeds, at two standard deviations; NaN for springs."""
    noise: float
    """standard deviation of a coordinate."""
    simplifications: tuple[str, ...]
    """what was taken to be simpler than it could be, because the data do not contradict it."""
    untold: tuple[str, ...]
    """what such coordinates cannot tell."""
    doubts: tuple[str, ...]
    """why the fit is refused; empty where it is accepted."""

    @property
    def accepted(self) -> bool:
        return not self.doubts

    def at(self, t: FloatArray) -> FloatArray:
        """States (M, 2, N, D) at any times (M,): between samples, before the first and after the last one."""
        after = np.flatnonzero(t > self.t[-1])
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        spans = np.where(t > self.t[-1], 0.0, t - self.t[k])
        speed = 2 * float(np.abs(self.states[:, 1]).max())
        steps = steps_for(self.graph, spans, speed)
        found = flow(self.graph, self.states[k], spans, np.empty(0, np.int64), steps).ends
        if len(after):
            later = np.unique(t[after])
            path = motion(self.graph, self.states[-1], np.concatenate([self.t[-1:], later]))[1:]
            found[after] = path[np.searchsorted(later, t[after])]
        return found


def infer(t: FloatArray, x: FloatArray, sigma: float | None = None) -> Latent:
    """The springs behind coordinates x (T, N, D) at times t (T,) s, NaN where a particle was not seen.

    `sigma` is the standard deviation of a coordinate where it is known; otherwise held particles or the residuals of
    the fit tell it. Raises `ValueError` where there are too few samples; a fit that fails is returned with its doubts.
    """
    seen = Coordinates(np.asarray(t, np.float64), np.asarray(x, np.float64), sigma)
    still = held(seen)
    told = noise(seen, still)
    fit = searched(seen, still, told)
    if doubts(fit, told is not None):
        fit = colliding(seen, fit, told)
    found = doubts(fit, told is not None)
    fit, simpler = simplified(seen, fit) if not found else (fit, ())
    return _latent(seen, fit, simpler, doubts(fit, told is not None))


def _latent(seen: Coordinates, fit: SpringFit, simpler: tuple[str, ...], found: tuple[str, ...]) -> Latent:
    sought = fit.model.layout
    names, values = sought.names, sought.values(fit.chain.shared)
    sigma = np.sqrt(np.diag(covariance(fit)).clip(0)) * sought.slope(fit.chain.shared)
    least, depth = least_stiffness(seen, fit), hidden_depth(fit)
    sigma = np.hypot(sigma, np.where(np.array(names) == "radius", depth / 2, 0.0))
    return Latent(
        seen.t, fit.states, fit.graph, names, values, sigma, least, fit.noise, simpler,
        sentences(fit.graph, names, values, sigma, least, depth), found,
    )  # fmt: skip
