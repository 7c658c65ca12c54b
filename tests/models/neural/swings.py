"""Motions with exact solutions, for the tests of networks."""

from __future__ import annotations

import numpy as np

from models.neural.common.method_interface import Floats


def circle(t: Floats, turns: float = 1.0) -> Floats:
    """(T, 1, 2): a point that goes round evenly, px."""
    angle = 2 * np.pi * turns * t
    return 100 * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]


def mse(guess: Floats, truth: Floats) -> float:
    return float(np.mean((guess - truth) ** 2))
