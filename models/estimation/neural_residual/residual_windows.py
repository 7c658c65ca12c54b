"""Paths of a ball from cushion to cushion with network-corrected models, as windows of multiple shooting.

The weights are shared unknowns like any coefficient of friction, with priors: hidden weights lie near seeded random
values, and the outputs have the prior 0 plus or minus a strength. The network output is therefore zero without data,
and any fit or diagnosis of a `ShootingModel` can enable it. Without weights this is the physics alone, with the same
integrator.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, Window
from models.estimation.neural_residual.corrected_derivatives import linearize_motion, linearize_past_cushion
from models.estimation.neural_residual.corrected_motion import (
    CLOTH_HIDDEN,
    CLOTH_INPUTS,
    CLOTH_OUTPUTS,
    CUSHION_HIDDEN,
    CUSHION_INPUTS,
    CUSHION_OUTPUTS,
)
from models.estimation.segmentation.contact_classification import INWARD_NORMALS
from models.estimation.whole_shot.cushion_chains import REBOUND_SCATTER, ChainSegment, CushionChains, chain_priors
from models.physics.billiards.ball_cushion import mirror
from models.physics.billiards.ball_cushion.cushion_models import CUSHION_MODELS
from models.physics.billiards.parameter_vector import neutral_parameters
from models.physics.effect import Prior

HIDDEN_WEIGHT_SIGMA = 0.5
"""Prior standard deviation of a hidden weight about its seeded value, in units of its input's range."""
_WEIGHT_BOUND = 10.0


@dataclass(frozen=True, slots=True)
class ResidualChains:
    """Segments that share a cloth, a cushion model and a correction; states as in `cushion_chains`."""

    segments: tuple[ChainSegment, ...]
    table: Table
    law: str
    """One of `parameters.CUSHION_LAWS`."""
    weights: tuple[Prior, ...] = ()
    """Priors of the network weights, in their order; empty: physics alone."""
    priors: tuple[Prior, ...] = ()
    """Priors of friction, restitution and noses from other clips; default priors where empty."""
    scatter: float = REBOUND_SCATTER
    """Scatter of real cushions about every model, as a share of the speed."""
    windows: tuple[Window, ...] = field(init=False)
    """One window per segment."""

    def __post_init__(self) -> None:
        if self.law not in CUSHION_MODELS:
            raise ValueError(f"a cushion law is one of {', '.join(CUSHION_MODELS)}; got {self.law!r}")
        windows = CushionChains(self.segments, self.table, mirror.rebound, scatter=self.scatter).windows
        object.__setattr__(self, "windows", windows)

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of friction (2), cushion restitution and friction, one nose offset per cushion, then the weights."""
        return (self.priors or chain_priors()) + self.weights

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Predict the positions of a segment and the start of the next one, with Jacobians."""
        segment = self.segments[window]
        value, slope = self.predict_motion(start, segment.t - segment.begin, shared)
        end, end_slope = start, np.eye(7, 7 + len(shared))
        if (
            segment.bounce is not None
            and window + 1 < len(self.segments)
            and self.segments[window + 1].continues_previous
        ):
            end, end_slope = self._continue_from_last_sample(
                segment, start, value, slope, self.segments[window + 1].begin, shared
            )
        return LinearizedWindow(
            np.einsum("kij,kj->ki", segment.whitening, value[:, :2] - segment.xy),
            np.einsum("kij,kjp->kip", segment.whitening, slope[:, :2, :7]),
            np.einsum("kij,kjp->kip", segment.whitening, slope[:, :2, 7:]),
            end, end_slope[:, :7], end_slope[:, 7:],
        )  # fmt: skip

    def predict_motion(self, start: FloatArray, tau: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Predict states (K, 7) at tau (K,) s after a start (7,), with the Jacobian (K, 7, 7 + P)."""
        value, slope = np.empty((len(tau), 7)), np.empty((len(tau), 7, 7 + len(shared)))
        size = np.array([self.table.length, self.table.width])
        linearize_motion(start, tau, shared, neutral_parameters(), self.table.ball_radius, size, value, slope)
        return value, slope

    def predict_past_cushion(
        self, segment: ChainSegment, start: FloatArray, until: float, shared: FloatArray
    ) -> tuple[FloatArray, FloatArray, bool]:
        """Predict the state beyond the cushion that ends a segment.

        A ball that turns or stops before the cushion moves on without a contact.

        Args:
            segment: Segment that ends at a cushion.
            start: (7,) its start state.
            until: s, time of the predicted state.
            shared: (P,) shared parameters.

        Returns:
            State (7,), Jacobian (7, 7 + P), and whether the ball reached the cushion.

        Raises:
            ValueError: The segment does not end at a cushion.
        """
        if segment.bounce is None:
            raise ValueError("a segment that does not end at a cushion has no continuation")
        side = CUSHIONS.index(segment.bounce.cushion)
        nx, ny = -INWARD_NORMALS[side]
        wall = {"left": 0.0, "right": self.table.length, "top": 0.0, "bottom": self.table.width}[segment.bounce.cushion]
        size = np.array([self.table.length, self.table.width])
        value, slope = np.empty(7), np.empty((7, 7 + len(shared)))
        met = linearize_past_cushion(
            start, until - segment.begin, side, float(nx), float(ny), wall - self.table.ball_radius, shared,
            neutral_parameters(), CUSHION_MODELS.index(self.law), self.table.ball_radius, self.table.ball_mass, size,
            value, slope,
        )  # fmt: skip
        return value, slope, bool(met)

    def _continue_from_last_sample(
        self,
        segment: ChainSegment,
        start: FloatArray,
        value: FloatArray,
        slope: FloatArray,
        until: float,
        shared: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Predict state (7,) and Jacobian (7, 7 + P) at `until` s, from the last observation of a segment."""
        if len(segment.t) == 0:
            return self.predict_past_cushion(segment, start, until, shared)[:2]
        rest = replace(segment, begin=float(segment.t[-1]))
        end, by_last, _ = self.predict_past_cushion(rest, value[-1], until, shared)
        end_slope = by_last[:, :7] @ slope[-1]
        end_slope[:, 7:] += by_last[:, 7:]
        return end, end_slope

    def without_network(self) -> ResidualChains:
        """Return the physics alone."""
        return replace(self, weights=())


def residual_priors(strength: float, seed: int) -> tuple[Prior, ...]:
    """Build the priors of the network weights, with zero mean output.

    Args:
        strength: Standard deviation of the outputs, as a share: of friction, of the speed after a cushion, and of the
            normal speed for impulses along it.
        seed: Random seed of the hidden weights.

    Returns:
        Priors of the cloth weights, then of the cushion weights.
    """
    rng = np.random.default_rng(seed)
    cloth = _layer_priors("cloth", CLOTH_INPUTS, CLOTH_HIDDEN, CLOTH_OUTPUTS, strength, rng)
    return cloth + _layer_priors("cushion", CUSHION_INPUTS, CUSHION_HIDDEN, CUSHION_OUTPUTS, strength, rng)


def _layer_priors(
    where: str, inputs: int, hidden: int, outputs: int, strength: float, rng: np.random.Generator
) -> tuple[Prior, ...]:
    places = np.clip(rng.standard_normal((hidden, inputs + 1)), -3, 3)
    inner = tuple(
        Prior(f"residual.{where}_hidden_{k}_{i}", "1", float(places[k, i]), HIDDEN_WEIGHT_SIGMA, False,
              (-_WEIGHT_BOUND, _WEIGHT_BOUND))
        for k in range(hidden) for i in range(inputs + 1)
    )  # fmt: skip
    sigma = strength * np.sqrt(2.0 / hidden)  # about half of the hidden units are active at a time
    return inner + tuple(
        Prior(f"residual.{where}_out_{o}_{k}", "1", 0.0, float(sigma), False, (-_WEIGHT_BOUND, _WEIGHT_BOUND))
        for o in range(outputs) for k in range(hidden)
    )  # fmt: skip
