"""What every method that learns a motion from coordinates offers, networks and splines alike. Without torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from models.core.typing import FloatArray

LEAST_SAMPLES = 4
"""A motion needs them: two to have a velocity, two more to learn how it changes."""


class LostMotion(ValueError):
    """A method found no motion behind the samples."""


@dataclass(frozen=True, slots=True)
class Budget:
    """How long a method may learn."""

    effort: float = 1.0
    """share of the method's own number of steps: 0.1 for a quick look. The result depends on nothing else."""
    seconds: float = float("inf")
    """CPU seconds after which training stops where it is: the result then depends on the machine."""

    def __post_init__(self) -> None:
        if not (self.effort > 0 and self.seconds > 0):
            raise ValueError(f"a budget is above 0; got effort {self.effort} and {self.seconds} s")

    def steps(self, whole: int) -> int:
        """The share of a schedule of so many steps, at least one."""
        return max(1, round(self.effort * whole))


@dataclass(frozen=True, slots=True)
class Fitted:
    """A learnt motion of N points in D axes."""

    motion: Callable[[FloatArray], FloatArray]
    """times (M,) s to coordinates (M, N, D)."""
    loss_curve: FloatArray
    """(L,) loss on the visible samples after each step, in the method's own unit; empty where nothing is trained."""
    parameters: int
    """numbers that were learnt."""
    seconds: float
    """CPU s."""

    def at(self, times: FloatArray) -> FloatArray:
        """Coordinates (M, N, D) at times (M,) s, between samples and after; not finite where a motion is lost."""
        return self.motion(np.asarray(times, np.float64))


class Method(Protocol):
    """A way to learn a motion: a frozen dataclass of its options."""

    @property
    def name(self) -> str:
        """In tables."""

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: Budget) -> Fitted:
        """Learn from coordinates (T, N, D) at rising times (T,) s; the same seed and effort give the same motion.

        Raises `ValueError` for samples that are not a motion, `LostMotion` where nothing was found.
        """


def checked(times: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both as float64; raises `ValueError` where they are not the samples of one motion."""
    t, x = np.asarray(times, np.float64), np.asarray(states, np.float64)
    if t.ndim != 1 or x.ndim != 3 or len(t) != len(x) or x.size == 0:
        raise ValueError(f"a motion is coordinates (T, N, D) at times (T,); got {x.shape} at {t.shape}")
    if len(t) < LEAST_SAMPLES:
        raise ValueError(f"a motion of {len(t)} samples; learning needs at least {LEAST_SAMPLES}")
    if not (np.isfinite(t).all() and np.isfinite(x).all() and (np.diff(t) > 0).all()):
        raise ValueError("times must rise and coordinates be finite: drop samples that are missing")
    return t, x
