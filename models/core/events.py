"""What happened: strikes, contacts, pockets and rests, each with a time between frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray

EVENT_KINDS = ("strike", "ball", "cushion", "pocket", "rest")


@dataclass(frozen=True, slots=True)
class Events:
    """E events in columns, sorted by time."""

    kind: tuple[str, ...]
    """(E,) one of `EVENT_KINDS`; rest is when a ball has a twentieth of its radius left to go, about a pixel: the last
    moment at which an eye tells it from its final place."""
    t: FloatArray
    """(E,) s."""
    t_sigma: FloatArray
    """(E,) s, > 0."""
    frame: FloatArray
    """(E,) the same moment in pictures, fractional."""
    a: tuple[str, ...]
    """(E,) id of the ball."""
    b: tuple[str, ...]
    """(E,) the other ball, the cushion or the pocket; empty for strike and rest."""
    xy: FloatArray
    """(E, 2) m, centre of ball a."""
    probability: FloatArray
    """(E,) that it happened."""
    gap: FloatArray
    """(E,) m, least distance of the two surfaces on their free paths, negative where they would overlap.

    NaN if not a contact, or unknown.
    """
    gap_sigma: FloatArray
    """(E,) m."""
    speed: FloatArray
    """(E,) m/s, closing speed along the normal; strike: speed after; NaN for rest."""

    def __post_init__(self) -> None:
        count = len(self.kind)
        if unknown := set(self.kind) - set(EVENT_KINDS):
            raise ValueError(f"events are of kinds {EVENT_KINDS}; got {sorted(unknown)}")
        for name in ("t", "t_sigma", "frame", "a", "b", "probability", "gap", "gap_sigma", "speed"):
            if len(getattr(self, name)) != count:
                raise ValueError(f"Events.{name} must have {count} entries; got {len(getattr(self, name))}")
        if self.xy.shape != (count, 2):
            raise ValueError(f"Events.xy must be ({count}, 2); got {self.xy.shape}")
        if count > 1 and np.any(np.diff(self.t) < 0):
            raise ValueError("Events must be sorted by time")

    def __len__(self) -> int:
        return len(self.kind)
