"""Fans of predicted paths, to be drawn over a shot."""

from __future__ import annotations

from dataclasses import dataclass

from models.core.typing import FloatArray, IntArray


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
class ForecastErrors:
    """K observed positions of predicted balls, compared with one prediction of the rest of the shot."""

    t: float
    """s, time of the prediction, which uses no later observation."""
    ball: tuple[str, ...]
    """(K,) ids, by ball, then by time."""
    seconds: FloatArray
    """(K,) s since `t`."""
    cushions: IntArray
    """(K,) cushion contacts of the ball since `t`."""
    error: FloatArray
    """(K,) m between predicted and observed position."""


@dataclass(frozen=True, slots=True)
class ForecastFans:
    """Fans of a shot, in the order of time."""

    fans: tuple[ForecastFan, ...]
    errors: ForecastErrors | None = None
    """Comparison of the rest of the shot with its prediction; None if there is none."""
