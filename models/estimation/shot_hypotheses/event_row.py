"""One event of a shot before its probability is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class EventRow:
    """One event, see `models.core.events.Events`."""

    kind: str
    t: float
    t_sigma: float
    a: str
    b: str
    xy: FloatArray
    category: str
    """What it is concluded from, see `models.estimation.shot_hypotheses.event_probability`; empty for the contacts of
    a simulated break, whose probability is known."""
    contact: int = -1
    """Contact of the graph that it belongs to; -1 for none."""
    probability: float = np.nan
    """NaN until the evidence is weighed."""
    gap: float = np.nan
    gap_sigma: float = np.nan
    speed: float = np.nan
