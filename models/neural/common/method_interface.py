"""Interface of all methods that learn a motion from coordinates, networks and splines alike. Does not import torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from models.core.typing import BoolArray, FloatArray

# Fewest samples of a motion: two determine a velocity, two more its change.
MIN_SAMPLES = 4


# Interval between held-out samples, in samples.
HOLDOUT_STRIDE = 4
# Training stops after this many evaluations of the loss without a gain of `MIN_HOLDOUT_GAIN`. Where L-BFGS follows
# Adam, only L-BFGS stops.
HOLDOUT_PATIENCE = 300
# Relative decrease of the mean squared error on held-out samples that counts as a gain.
MIN_HOLDOUT_GAIN = 0.05


class MotionNotFoundError(ValueError):
    """A method found no motion that explains the samples."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutSamples:
    """Samples of a motion that are not trained on."""

    times: FloatArray
    """(V,) s."""
    states: FloatArray
    """(V, N, D)."""


@dataclass(frozen=True, slots=True)
class TrainingBudget:
    """Limits on the training of a method."""

    effort: float = 1.0
    """Share of the number of steps of the method, > 0; e.g. 0.1 for a preview. With `seconds` infinite, the result is
    reproducible."""
    seconds: float = float("inf")
    """CPU time in s after which training stops. If it is reached, the result depends on the machine."""
    holdout: HeldOutSamples | None = None
    """Training stops when the error on these samples no longer decreases, and the state of least error is kept. The
    loss curve then ends at that state."""
    evaluations: int | None = None
    """Number of evaluations of the loss instead of that of the schedule."""

    def __post_init__(self) -> None:
        if not (self.effort > 0 and self.seconds > 0):
            raise ValueError(f"a budget is above 0; got effort {self.effort} and {self.seconds} s")

    def scale_steps(self, whole: int) -> int:
        """Scale the number of steps of a schedule by the effort; at least one step."""
        return max(1, round(self.effort * whole))


@dataclass(frozen=True, slots=True)
class FittedMotion:
    """A learned motion of N points in D axes."""

    motion: Callable[[FloatArray], FloatArray]
    """Maps times (M,) in s to coordinates (M, N, D)."""
    loss_curve: FloatArray
    """Loss on the visible samples at each evaluation, in the unit of the method; empty for methods without training."""
    parameter_count: int
    """Number of learned parameters."""
    seconds: float
    """CPU time of the fit, s."""
    is_trained: bool = field(default=True, kw_only=True)
    """Whether the training ended by itself, not at the time limit."""

    def at(self, times: FloatArray) -> FloatArray:
        """Evaluate the motion, between the samples and after them.

        Args:
            times: Times (M,), s.

        Returns:
            Coordinates (M, N, D); not finite where the motion diverges.
        """
        return self.motion(np.asarray(times, np.float64))


class MotionMethod(Protocol):
    """A method that learns a motion: a frozen dataclass of its options."""

    @property
    def name(self) -> str:
        """Name in tables."""

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> FittedMotion:
        """Learn a motion from samples.

        Args:
            times: Times (T,), s, increasing.
            states: Coordinates (T, N, D), finite.
            seed: Random seed; equal seeds and efforts give equal motions.
            budget: Limits on the training.

        Returns:
            The learned motion.

        Raises:
            ValueError: The samples are not those of one motion.
            MotionNotFoundError: The method found no motion.
        """


def validate_samples(times: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Convert the samples of a motion to float64 and check them.

    Args:
        times: Times (T,), s.
        states: Coordinates (T, N, D).

    Returns:
        Times and coordinates.

    Raises:
        ValueError: Shapes do not match, samples are too few or not finite, or times do not increase.
    """
    t, x = np.asarray(times, np.float64), np.asarray(states, np.float64)
    if t.ndim != 1 or x.ndim != 3 or len(t) != len(x) or x.size == 0:
        raise ValueError(f"a motion is coordinates (T, N, D) at times (T,); got {x.shape} at {t.shape}")
    if len(t) < MIN_SAMPLES:
        raise ValueError(f"a motion of {len(t)} samples; learning needs at least {MIN_SAMPLES}")
    if not (np.isfinite(t).all() and np.isfinite(x).all() and (np.diff(t) > 0).all()):
        raise ValueError("times must rise and coordinates be finite: drop samples that are missing")
    return t, x


def select_holdout(count: int) -> BoolArray:
    """Select the samples to hold out: every fourth, without the first and the last.

    Args:
        count: Number of samples T.

    Returns:
        Mask (T,); empty where too few samples would remain.
    """
    is_held_out = np.asarray(np.arange(count) % HOLDOUT_STRIDE == HOLDOUT_STRIDE // 2)
    is_held_out[[0, -1]] = False
    return is_held_out if np.sum(~is_held_out) >= MIN_SAMPLES else np.zeros(count, np.bool_)
