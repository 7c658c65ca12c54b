"""Which shots estimate, which confirm, and which only report: chosen by their order, never by what they hold."""

from __future__ import annotations

from dataclasses import dataclass

from models.estimation.gap_scenes.gap_scene import Recording

FEW = 6
"""shots below which none can be spared to confirm alone."""


@dataclass(frozen=True, slots=True)
class Split:
    """Recordings by their use; `report` must not be looked at before the verdict stands."""

    fit: tuple[Recording, ...]
    select: tuple[Recording, ...]
    report: tuple[Recording, ...]


def split_shots(recordings: tuple[Recording, ...]) -> Split:
    """Half of the shots estimate, a quarter confirms, a quarter reports; of few shots all but the last estimate."""
    ordered = tuple(sorted(recordings, key=lambda one: one.shot))
    if len(ordered) < FEW:
        kept = len(ordered) if len(ordered) == 1 else len(ordered) - max(1, len(ordered) // 4)
        return Split(ordered[:kept], (), ordered[kept:])
    by_use: dict[str, list[Recording]] = {"fit": [], "select": [], "report": []}
    for place, one in enumerate(ordered):
        by_use[("fit", "select", "fit", "report")[place % 4]].append(one)
    return Split(*(tuple(by_use[use]) for use in ("fit", "select", "report")))
