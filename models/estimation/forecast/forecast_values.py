"""Fans to be drawn over a shot: what was to be expected at a few of its moments."""

from __future__ import annotations

from dataclasses import dataclass

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class Foresight:
    """N balls, M courses, K moments."""

    t: float
    """s, from when one looks ahead."""
    ids: tuple[str, ...]
    times: FloatArray
    """(K,) s"""
    courses: FloatArray
    """(M, K, N, 2) m; NaN once a ball is potted."""


@dataclass(frozen=True, slots=True)
class Foresights:
    """In the order of time."""

    fans: tuple[Foresight, ...]
