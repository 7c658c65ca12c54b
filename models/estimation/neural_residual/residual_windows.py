"""Paths of a ball from cushion to cushion whose laws a small network corrects, as a model of the fit by shooting.

The weights are shared unknowns like any coefficient of friction, with priors: hidden units lie near places drawn from a
seed, and what comes out is 0 give or take a strength. So the network is silent until the data speak, and any fit or
diagnosis that takes a `Model` can switch it on. Without weights this is the physics alone, by the same integrator.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import Flow, Window
from models.estimation.neural_residual.corrected_derivatives import glides, hops
from models.estimation.neural_residual.corrected_motion import (
    CLOTH_HIDDEN,
    CLOTH_INPUTS,
    CLOTH_OUTPUTS,
    CUSHION_HIDDEN,
    CUSHION_INPUTS,
    CUSHION_OUTPUTS,
)
from models.estimation.segmentation.contact_classification import INWARD
from models.estimation.whole_shot.cushion_chains import SCATTER, CushionChains, Leg, chain_priors
from models.physics.billiards.ball_cushion import mirror
from models.physics.billiards.parameters import CUSHION_LAWS, neutral
from models.physics.effect import Prior

WANDERING = 0.5
"""Prior standard deviation of a hidden weight about its seeded place, in units of its input's range."""
_BOUND = 10.0


@dataclass(frozen=True, slots=True)
class ResidualChains:
    """Legs that share a cloth, a cushion law and a correction; states as in `cushion_chains`."""

    legs: tuple[Leg, ...]
    table: Table
    law: str
    """One of `parameters.CUSHION_LAWS`."""
    weights: tuple[Prior, ...] = ()
    """Of the network, in its order; none: physics alone."""
    known: tuple[Prior, ...] = ()
    """Of friction, restitution and noses, where other clips have told them."""
    scatter: float = SCATTER
    """Of the speed: what a cushion adds to every law."""
    windows: tuple[Window, ...] = field(init=False)

    def __post_init__(self) -> None:
        if self.law not in CUSHION_LAWS:
            raise ValueError(f"a cushion law is one of {', '.join(CUSHION_LAWS)}; got {self.law!r}")
        windows = CushionChains(self.legs, self.table, mirror.rebound, scatter=self.scatter).windows
        object.__setattr__(self, "windows", windows)

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Sliding mu, rolling mu, cushion e, cushion mu, one nose per cushion, then the weights."""
        return (self.known or chain_priors()) + self.weights

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        """Positions of a leg, and where the next one begins."""
        leg = self.legs[window]
        value, slope = self.glide(start, leg.t - leg.begin, shared)
        end, end_slope = start, np.eye(7, 7 + len(shared))
        if leg.bounce is not None and window + 1 < len(self.legs) and self.legs[window + 1].tied:
            end, end_slope = self._beyond(leg, start, value, slope, self.legs[window + 1].begin, shared)
        return Flow(
            np.einsum("kij,kj->ki", leg.whiten, value[:, :2] - leg.xy),
            np.einsum("kij,kjp->kip", leg.whiten, slope[:, :2, :7]),
            np.einsum("kij,kjp->kip", leg.whiten, slope[:, :2, 7:]),
            end, end_slope[:, :7], end_slope[:, 7:],
        )  # fmt: skip

    def glide(self, start: FloatArray, tau: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States (K, 7) at tau (K,) s after a start (7,), with slopes (K, 7, 7 + P) by start and shared numbers."""
        value, slope = np.empty((len(tau), 7)), np.empty((len(tau), 7, 7 + len(shared)))
        size = np.array([self.table.length, self.table.width])
        glides(start, tau, shared, neutral(), self.table.ball_radius, size, value, slope)
        return value, slope

    def hop(self, leg: Leg, start: FloatArray, until: float, shared: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
        """State (7,) at `until` s beyond the cushion that ends a leg, slopes (7, 7 + P), whether the ball came there.

        A ball that turns or stops before the cushion goes on as if there were none.
        """
        if leg.bounce is None:
            raise ValueError("a leg that ends at no cushion does not go on")
        side = CUSHIONS.index(leg.bounce.cushion)
        nx, ny = -INWARD[side]
        wall = {"left": 0.0, "right": self.table.length, "top": 0.0, "bottom": self.table.width}[leg.bounce.cushion]
        size = np.array([self.table.length, self.table.width])
        value, slope = np.empty(7), np.empty((7, 7 + len(shared)))
        met = hops(
            start, until - leg.begin, side, float(nx), float(ny), wall - self.table.ball_radius, shared, neutral(),
            CUSHION_LAWS.index(self.law), self.table.ball_radius, self.table.ball_mass, size, value, slope,
        )  # fmt: skip
        return value, slope, bool(met)

    def _beyond(
        self, leg: Leg, start: FloatArray, value: FloatArray, slope: FloatArray, until: float, shared: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """State (7,) at `until` s and slopes (7, 7 + P), from where the ball was seen last."""
        if len(leg.t) == 0:
            return self.hop(leg, start, until, shared)[:2]
        rest = replace(leg, begin=float(leg.t[-1]))
        end, by_last, _ = self.hop(rest, value[-1], until, shared)
        end_slope = by_last[:, :7] @ slope[-1]
        end_slope[:, 7:] += by_last[:, 7:]
        return end, end_slope

    def without(self) -> ResidualChains:
        """Physics alone."""
        return replace(self, weights=())


def residual_priors(strength: float, seed: int) -> tuple[Prior, ...]:
    """Weights of the network before anything is seen: silent, give or take `strength` at its outputs.

    `strength` is a share: of friction, of the speed after a cushion, of the normal speed for impulses along it.
    """
    rng = np.random.default_rng(seed)
    cloth = _layer("cloth", CLOTH_INPUTS, CLOTH_HIDDEN, CLOTH_OUTPUTS, strength, rng)
    return cloth + _layer("cushion", CUSHION_INPUTS, CUSHION_HIDDEN, CUSHION_OUTPUTS, strength, rng)


def _layer(
    where: str, inputs: int, hidden: int, outputs: int, strength: float, rng: np.random.Generator
) -> tuple[Prior, ...]:
    places = np.clip(rng.standard_normal((hidden, inputs + 1)), -3, 3)
    inner = tuple(
        Prior(f"residual.{where}_hidden_{k}_{i}", "1", float(places[k, i]), WANDERING, False, (-_BOUND, _BOUND))
        for k in range(hidden) for i in range(inputs + 1)
    )  # fmt: skip
    sigma = strength * np.sqrt(2.0 / hidden)  # about half of the units are awake at a time
    return inner + tuple(
        Prior(f"residual.{where}_out_{o}_{k}", "1", 0.0, float(sigma), False, (-_BOUND, _BOUND))
        for o in range(outputs) for k in range(hidden)
    )  # fmt: skip
