"""Events of a shot: strikes, contacts, pocketed balls and rests, each with a time between frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.array_columns import concatenate_rows, take_rows
from models.core.typing import BoolArray, FloatArray, IntArray

EVENT_KINDS = ("strike", "ball", "cushion", "pocket", "rest")


@dataclass(frozen=True, slots=True, repr=False)
class Events:
    """E events in columns, sorted by time."""

    kind: tuple[str, ...]
    """(E,) one of `EVENT_KINDS`. At a rest, a ball is a fortieth of its radius, about half a pixel, away from its
    final position: the last moment at which a viewer can see the difference."""
    t: FloatArray
    """(E,) s, time of the event since the first frame."""
    t_sigma: FloatArray
    """(E,) s, standard deviation of `t`, > 0."""
    frame: FloatArray
    """(E,) the same time in frames, fractional."""
    a: tuple[str, ...]
    """(E,) id of the ball."""
    b: tuple[str, ...]
    """(E,) id of the other ball, name of the cushion or of the pocket; empty for strike and rest."""
    xy: FloatArray
    """(E, 2) m, centre of ball `a` in table coordinates."""
    probability: FloatArray
    """(E,) probability that the event happened."""
    gap: FloatArray
    """(E,) m, smallest distance of the two surfaces if the contact did not happen; negative if they would overlap.

    NaN if the event is no contact, or the gap is unknown.
    """
    gap_sigma: FloatArray
    """(E,) m, standard deviation of `gap`."""
    speed: FloatArray
    """(E,) m/s, closing speed along the contact normal; for a strike the speed of the ball afterwards; NaN for rest."""

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

    def __repr__(self) -> str:
        counts = [f"{self.kind.count(kind)} {kind}" for kind in EVENT_KINDS if kind in self.kind]
        return f"Events({', '.join(counts) or 'none'})"

    def select_rows(self, rows: IntArray | BoolArray) -> Events:
        """Return the events of a mask (E,) or of rows in their order."""
        return take_rows(self, rows)


def merge_events(one: Events, two: Events) -> Events:
    """Merge events by time; of events at the same time, those of `one` come first.

    Args:
        one: Events.
        two: Other events.

    Returns:
        All of them.
    """
    return concatenate_rows([one, two], np.argsort(np.concatenate([one.t, two.t]), kind="stable"))
