"""Interface of all methods that learn a motion from coordinates, networks and splines alike. Does not import torch.

With early stopping, held-out visible samples decide how long a network trains, then it trains as long on all of them
(Goodfellow, Bengio and Courville 2016, "Deep Learning", algorithm 7.2). The samples on which methods are compared are
not used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.interpolate import Akima1DInterpolator, make_interp_spline

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


@dataclass(frozen=True, slots=True)
class Scaling:
    """Scales of the motion of N points in D axes, flattened to C = N D coordinates.

    All coordinates share one length, so that angles are preserved.
    """

    centre: FloatArray
    """(C,) middle of the range of each coordinate."""
    length: float
    """Half the widest range of a coordinate, in the unit of the coordinates."""
    start: float
    """s, time of the first sample."""
    step: float
    """s, median sample interval: the unit of time of Chen 2022."""
    speed: FloatArray
    """(C,) root mean square change of each scaled coordinate per step; 0 for a coordinate that never changes."""
    shape: tuple[int, int]
    """N and D."""

    def scale_states(self, states: FloatArray) -> FloatArray:
        """Convert states (T, N, D) to scaled coordinates (T, C)."""
        flat: FloatArray = (states.reshape(len(states), -1) - self.centre) / self.length
        return flat

    def restore_states(self, coordinates: FloatArray) -> FloatArray:
        """Convert scaled coordinates (T, C) back to states (T, N, D)."""
        return (coordinates * self.length + self.centre).reshape(-1, *self.shape)

    def count_steps(self, times: FloatArray) -> FloatArray:
        """Convert times in s to steps since the first sample."""
        return (times - self.start) / self.step


def estimate_scaling(times: FloatArray, states: FloatArray) -> Scaling:
    """Estimate the scales of a motion.

    Args:
        times: Times (T,), s.
        states: Coordinates (T, N, D).

    Returns:
        The scales; the length of a motion without any change is 1.
    """
    flat = states.reshape(len(states), -1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    length = float((high - low).max()) / 2 or 1.0
    step = float(np.median(np.diff(times)))
    change = np.diff(flat, axis=0) / np.diff(times)[:, None] * step / length
    speed = np.sqrt(np.mean(change**2, axis=0))
    return Scaling((low + high) / 2, length, float(times[0]), step, speed, (states.shape[1], states.shape[2]))


Curve = Callable[[FloatArray], FloatArray]


def fit_spline(times: FloatArray, states: FloatArray, degree: int) -> Curve:
    """Fit a not-a-knot spline through all samples.

    Args:
        times: Times (T,), s, increasing.
        states: Values (T, ...).
        degree: Odd degree; reduced if there are too few samples.

    Returns:
        Curve that maps times (M,) to values (M, ...). Outside the samples the first and last piece continue.
    """
    return make_interp_spline(times, states, k=min(degree, len(times) - 1))  # type: ignore[no-any-return]


def fit_akima(times: FloatArray, states: FloatArray) -> Curve:
    """Fit an Akima spline, whose cubic pieces are robust to single outliers.

    Akima 1970, doi:10.1145/321607.321609.

    Args:
        times: Times (T,), s, increasing.
        states: Values (T, ...).

    Returns:
        Curve that maps times (M,) to values (M, ...).
    """
    return Akima1DInterpolator(times, states, extrapolate=True)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class SplineMethod:
    """Spline as a method; seed and budget have no effect."""

    name: str
    degree: int

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Fit the curve through all samples; arguments as in `MotionMethod.fit`."""
        return _fit_curve(lambda t, x: fit_spline(t, x, self.degree), times, states)


@dataclass(frozen=True, slots=True)
class AkimaMethod:
    """Akima spline as a method; seed and budget have no effect."""

    name: str = "akima"

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Fit the curve through all samples; arguments as in `MotionMethod.fit`."""
        return _fit_curve(fit_akima, times, states)


def _fit_curve(
    through: Callable[[FloatArray, FloatArray], Curve], times: FloatArray, states: FloatArray
) -> FittedMotion:
    began = time.process_time()
    curve = through(*validate_samples(times, states))
    return FittedMotion(curve, np.empty(0), 0, time.process_time() - began)


LINEAR, CUBIC, QUINTIC, AKIMA = (
    SplineMethod("linear", 1),
    SplineMethod("cubic", 3),
    SplineMethod("quintic", 5),
    AkimaMethod(),
)
# All splines. Linear interpolation is the bilateral method of Chen 2022, eq. 22.
CURVES = (LINEAR, CUBIC, QUINTIC, AKIMA)


@dataclass(frozen=True, slots=True)
class EarlyStopping:
    """A network whose length of training is that of the least error on held-out samples."""

    network: MotionMethod

    @property
    def name(self) -> str:
        """Name in tables: that of the network."""
        return self.network.name

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Train on a part of the samples until the error on the others settles, then as long on all samples.

        The motion is not trained (`FittedMotion.is_trained`) if the time limit ends one of both trainings, or if there
        are too few samples to hold any out. Arguments as in `MotionMethod.fit`.
        """
        t, x = validate_samples(times, states)
        whole = budget or TrainingBudget()
        is_held_out = select_holdout(len(t))
        if not is_held_out.any():
            return replace(self.network.fit(t, x, seed, whole), is_trained=False)
        holdout = HeldOutSamples(t[is_held_out], x[is_held_out])
        part = self.network.fit(t[~is_held_out], x[~is_held_out], seed, replace(whole, holdout=holdout))
        remaining = whole.seconds - part.seconds
        if not part.is_trained or remaining <= 0:
            return replace(part, is_trained=False)
        final = self.network.fit(t, x, seed, replace(whole, seconds=remaining, evaluations=len(part.loss_curve)))
        return replace(final, seconds=part.seconds + final.seconds)
