"""Fans of predicted paths, to be drawn over a shot."""

from __future__ import annotations

from dataclasses import dataclass

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class ForecastFan:
    """Predicted paths of N balls with M members at K times."""

    t: float
    """s, start of the fan."""
    ids: tuple[str, ...]
    times: FloatArray
    """(K,) s."""
    members: FloatArray
    """(M, K, N, 2) m; NaN once a ball is potted."""


@dataclass(frozen=True, slots=True)
class ForecastFans:
    """Fans of a shot, in the order of time."""

    fans: tuple[ForecastFan, ...]
