"""A series of coordinates with every other frame withheld: the input of all compared methods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.neural.common.method_interface import FittedMotion


@dataclass(frozen=True, slots=True)
class ExperimentCase:
    """One experiment."""

    scene: str
    """double-pendulum, real, boxes, pool."""
    variant: str
    """soft, medium, stiff; the speed of the ball; the start of a recording; a shot."""
    fps: float
    """Frame rate including withheld frames, Hz."""
    noise: float
    """px: standard deviation of the noise that is added to every visible coordinate."""
    seed: int
    """Seed of the noise, of the networks, and of the throw into the boxes."""


@dataclass(frozen=True, slots=True)
class WithheldSeries:
    """N points at T frames, px."""

    case: ExperimentCase
    t: FloatArray
    """(T,) s"""
    truth: FloatArray
    """(T, N, 2)"""
    observed: FloatArray
    """(T, N, 2) with noise; methods get every other row."""

    def __post_init__(self) -> None:
        if self.truth.shape != self.observed.shape or len(self.t) != len(self.truth) or len(self.t) % 2 == 0:
            raise ValueError(f"a series has an odd number of frames; got {self.truth.shape} at {self.t.shape}")

    @property
    def visible_samples(self) -> tuple[FloatArray, FloatArray]:
        """Times and coordinates that a method may use."""
        return self.t[::2], self.observed[::2]

    @property
    def withheld_samples(self) -> tuple[FloatArray, FloatArray]:
        """Times and true coordinates of the withheld midpoints."""
        return self.t[1::2], self.truth[1::2]


def build_series(case: ExperimentCase, t: FloatArray, truth: FloatArray) -> WithheldSeries:
    """Build the series of a case with its noise; of an even number of frames, the last is dropped."""
    count = len(t) - 1 + len(t) % 2
    noise = np.random.default_rng([case.seed, 1]).standard_normal(truth.shape)
    return WithheldSeries(case, t[:count], truth[:count], (truth + case.noise * noise)[:count])


def mean_squared_error(guess: FloatArray, truth: FloatArray) -> float:
    """Return the mean squared error.

    Args:
        guess: (H, N, 2) px.
        truth: (H, N, 2) px.

    Returns:
        px^2, mean over frames, points and coordinates.
    """
    return float(np.mean((guess - truth) ** 2))


@dataclass(frozen=True, slots=True)
class AssessedMotion(FittedMotion):
    """A fitted motion with warnings."""

    warnings: tuple[str, ...]
    """Reasons not to trust it; empty where there are none."""
