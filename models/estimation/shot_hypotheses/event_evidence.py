"""Evidence for and against an event: numbers that the fit of the shot yields, without any judgement."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from models.core.typing import FloatArray

GAIN_SCALE = 20.0
"""chi2: scale on which gains are compressed; a contact needs about as much to be fitted at all."""
GRAZE_GAP, SLOW_SPEED = 1e-3, 0.1
"""m of overlap and m/s of closing speed beyond which a contact leaves no doubt by itself."""
EDGE_FRAMES = 2.0
"""Frames from the start or the end of a clip within which the motion before or after is hardly observed."""


@dataclass(frozen=True, slots=True)
class EventEvidence:
    """Evidence on one event; every value is 0 where there is nothing against it, or nothing is known."""

    gain: float = 0.0
    """Logarithm of the chi2 that the event improves over nothing, in units of `GAIN_SCALE`, plus 1."""
    misfit: float = 0.0
    """Logarithm of the chi2 per degree of freedom of the motion around it, at least 0."""
    apart: float = 0.0
    """As `gain`, of separate velocity changes over the contact of two balls: where the laws of contacts do not fit."""
    rival: float = 0.0
    """0 to 1: how well a contact with another ball fits instead; 1 if as well."""
    fit: float = 0.0
    """0 to 1, of a rival itself: how well it fits; 1 if as well as the best explanation."""
    hidden: float = 0.0
    """Logarithm of the missed frames of a ball around the event, plus 1."""
    travel: float = 0.0
    """Logarithm of the way of the fastest ball between two frames in ball radii, plus 1."""
    short: float = 0.0
    """Reciprocal of the number of samples of the shortest motion before or after, plus 1."""
    edge: float = 0.0
    """1 at the start or the end of the clip."""
    driven: float = 0.0
    """1 where another ball moves when a ball starts: no cue strikes meanwhile."""
    graze: float = 0.0
    """0 to 1: 1 where free paths only just overlap."""
    slow: float = 0.0
    """0 to 1: 1 where the bodies hardly approach each other."""
    test: float = 0.0
    """Logarithm of the odds of a contact by the contact test, compressed."""

    @property
    def vector(self) -> FloatArray:
        """Values in the order of `EVIDENCE_NAMES`."""
        return np.array([getattr(self, name) for name in EVIDENCE_NAMES])


EVIDENCE_NAMES = tuple(field.name for field in fields(EventEvidence))


def compress_gain(chi2: float) -> float:
    """Compress a difference of chi2: errors of a model are not normal, so that its tails count less."""
    return float(np.sign(chi2) * np.log1p(abs(chi2) / GAIN_SCALE))


def compress_rival(cost: float) -> float:
    """Convert the chi2 that a rival costs beyond the best explanation to 0 ... 1."""
    return float(1 / (1 + max(cost, 0.0) / GAIN_SCALE))


def count_missed_frames(times: FloatArray, t: float, interval: float) -> float:
    """Count the frames without a sample around a time.

    Args:
        times: (K,) times of the samples of a ball, s.
        t: s.
        interval: Frame interval, s.

    Returns:
        Missed frames between the samples before and after; infinite time before the first one counts none.
    """
    row = int(np.searchsorted(times, t))
    if not 0 < row < len(times):
        return 0.0
    return max(float(times[row] - times[row - 1]) / interval - 1.0, 0.0)
