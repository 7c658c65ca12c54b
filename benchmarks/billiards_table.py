"""The table of benchmarks/billiards_gap.py, from its rows alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipeline.experiments.gapcheck.case_scores import BINS, Rate

GOALS = (
    ("one", "one effect missing, natural strength: named", "asked 90 %"),
    ("one+", "or in its group", "asked 97 %"),
    ("weak+", "just above the noise: named or in its group", "asked 75 %"),
    ("none", "nothing missing: nothing named", "asked 95 to 97 %"),
    ("taken out", "effect taken out of the library: unknown", "asked 80 %"),
    ("foreign", "in no library: unknown", "asked 80 %"),
    ("pair", "two missing: both named", "asked 80 %"),
    ("form", "a law of another form: its family named", "closed 0.8 of an oracle's"),
    ("trap", "traps: group, or called unidentifiable", "asked 100 %"),
    ("slow+", "half as many pictures a second: named or in its group", "to be shown"),
    ("few+", "5 shots: named or in its group", "to be shown"),
    ("noisy+", "1 px: named or in its group", "to be shown"),
)


@dataclass(frozen=True)
class Row:
    """What one case gave."""

    kind: str
    asked: str
    """one, pair, none, taken out, foreign, form, trap, weak, slow, few, noisy."""
    seed: int
    said: str
    """names, joined by +; of a group by |; else the verdict."""
    right: int
    grouped: int
    """1 where the first candidate's group holds what is missing."""
    probability: float
    p_value: float
    """chance that what the simulator leaves is noise."""
    before: float
    """m, of predictions on shots that chose nothing; so the next two."""
    after: float
    floor: float
    closed: float
    """NaN where it is not resolved."""
    low: float
    high: float
    phase: str
    """that holds most of the gap."""
    phase_right: int
    """1 where what is missing acts there, 0 where not, -1 where nothing is missing."""
    cpu: float
    """s, of the process that diagnoses."""
    wall: float
    """s, by the clock."""
    truth: str
    found: str

    def line(self) -> str:
        closed = "" if np.isnan(self.closed) else f", closed {self.closed:.3f} ({self.low:.2f} to {self.high:.2f})"
        return (
            f"{'right' if self.right else 'WRONG'} {self.kind:36} {self.seed:4} {self.said:32} {self.probability:.3f}"
            f" [{self.truth}] [{self.found}] {1e3 * self.before:.2f} to {1e3 * self.after:.2f} of"
            f" {1e3 * self.floor:.2f} mm{closed}, {self.cpu:.0f} CPU s, {self.wall:.0f} s"
        )


def told(rows: Sequence[Row]) -> str:
    """Goals, what closed, calibration, and what was said of every kind."""
    return "\n".join([*_goals(rows), *_closing(rows), "", *_calibration(rows), "", *_confusion(rows)])


def _goals(rows: Sequence[Row]) -> Iterator[str]:
    for key, words, goal in GOALS:
        here = [row for row in rows if row.asked == key.rstrip("+")]
        hits = sum(row.right or (key.endswith("+") and row.grouped and "|" in row.said) for row in here)
        yield f"{words:48} {Rate(int(hits), len(here))!s:32} {goal}"


def _closing(rows: Sequence[Row]) -> Iterator[str]:
    lacking = [row for row in rows if row.asked in ("one", "pair")]
    resolved = [row for row in lacking if np.isfinite(row.closed)]
    yield f"gap resolved on three shots: {Rate(len(resolved), len(lacking))}"
    if resolved:
        shares = [row.closed for row in resolved]
        yield f"closed there: median {np.median(shares):.3f}, 10th percentile {np.quantile(shares, 0.1):.3f}"
    placed = [row.phase_right for row in rows if row.phase_right >= 0 and row.asked != "trap"]
    yield f"largest phase is one in which what is missing acts: {Rate(sum(placed), len(placed))} asked 90 %"
    for words, took in (("CPU s", [row.cpu for row in rows]), ("s by the clock", [row.wall for row in rows])):
        if took:
            yield (
                f"{words} of 12 shots: median {np.median(took):.0f}, 90th percentile {np.quantile(took, 0.9):.0f},"
                f" largest {max(took):.0f}; asked 45 s on two cores"
            )


def _calibration(rows: Sequence[Row]) -> Iterator[str]:
    yield "probability of the answer -> how often it is right"
    plain = [row for row in rows if row.asked in ("one", "none", "foreign", "pair")]
    for low, high in pairwise(BINS):
        here = [row for row in plain if low <= row.probability < high or (high == 1.0 == row.probability)]
        if here:
            yield f"  {low:.2f} to {high:.2f}: {Rate(sum(row.right for row in here), len(here))}"


def _confusion(rows: Sequence[Row]) -> Iterator[str]:
    yield "what was missing -> what was said, times; CPU s"
    order = list(dict.fromkeys(row.kind for row in rows))
    counts = Counter((row.kind, row.said, row.right) for row in rows)
    for (kind, said, good), times in sorted(counts.items(), key=lambda one: (order.index(one[0][0]), -one[1])):
        cpu = [row.cpu for row in rows if (row.kind, row.said) == (kind, said)]
        yield f"  {'' if good else 'WRONG':5} {kind:36} {said:40} {times} {min(cpu):.0f} to {max(cpu):.0f}"
