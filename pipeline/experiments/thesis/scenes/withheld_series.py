"""A series of coordinates of which every other frame is withheld: what all methods are compared on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class Case:
    """One experiment."""

    scene: str
    """double-pendulum, real, boxes, pool."""
    variant: str
    """soft, medium, stiff; the speed of the ball; the start of a recording; a shot."""
    fps: float
    """Frames per second, those that are withheld counted."""
    noise: float
    """px: standard deviation of what is added to every visible coordinate."""
    seed: int
    """Of the noise, of the networks, and of the throw into the boxes."""


@dataclass(frozen=True, slots=True)
class Series:
    """N points at T frames, px."""

    case: Case
    t: FloatArray
    """(T,) s"""
    truth: FloatArray
    """(T, N, 2)"""
    seen: FloatArray
    """(T, N, 2) with noise; a method is shown every other row of it."""

    def __post_init__(self) -> None:
        if self.truth.shape != self.seen.shape or len(self.t) != len(self.truth) or len(self.t) % 2 == 0:
            raise ValueError(f"a series has an odd number of frames; got {self.truth.shape} at {self.t.shape}")

    @property
    def shown(self) -> tuple[FloatArray, FloatArray]:
        """Times and coordinates that a method may learn from."""
        return self.t[::2], self.seen[::2]

    @property
    def hidden(self) -> tuple[FloatArray, FloatArray]:
        """Times and true coordinates of the withheld midpoints."""
        return self.t[1::2], self.truth[1::2]


def filmed(case: Case, t: FloatArray, truth: FloatArray) -> Series:
    """The series of a case with its noise; an even number of frames loses the last one."""
    kept = len(t) - 1 + len(t) % 2
    noise = np.random.default_rng([case.seed, 1]).standard_normal(truth.shape)
    return Series(case, t[:kept], truth[:kept], (truth + case.noise * noise)[:kept])


def mean_square(guess: FloatArray, truth: FloatArray) -> float:
    """px^2: mean over frames, points and coordinates."""
    return float(np.mean((guess - truth) ** 2))
