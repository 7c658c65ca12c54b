"""Motions with exact solutions, for the tests of networks."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray


def circle(t: FloatArray, turns: float = 1.0) -> FloatArray:
    """(T, 1, 2): a point that goes round evenly, px."""
    angle = 2 * np.pi * turns * t
    return 100 * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]


def mse(guess: FloatArray, truth: FloatArray) -> float:
    return float(np.mean((guess - truth) ** 2))
