"""Errors of a prediction, as the page of a run shows them; fast to import."""

from __future__ import annotations

from dataclasses import dataclass

from models.core.typing import FloatArray, IntArray


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
