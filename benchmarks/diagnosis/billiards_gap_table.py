"""The tables of benchmarks/diagnosis/billiards_gap.py, made from its rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipeline.experiments.gapcheck.blind_case import PROBABILITY_BINS, Proportion

GOALS = (
    ("one", "one effect missing, natural strength: named", "goal 90 %"),
    ("one+", "or in its group", "goal 97 %"),
    ("weak+", "just above the noise: named or in its group", "goal 75 %"),
    ("none", "nothing missing: nothing named", "goal 95 to 97 %"),
    ("removed", "effect removed from the library: unknown", "goal 80 %"),
    ("foreign", "effect in no library: unknown", "goal 80 %"),
    ("pair", "two missing: both named", "goal 80 %"),
    ("form", "another functional form: its family named", "closes 0.8 of an oracle's share"),
    ("trap", "traps: group, or reported as not identifiable", "goal 100 %"),
    ("slow+", "half the frame rate: named or in its group", "no goal"),
    ("few+", "5 shots: named or in its group", "no goal"),
    ("noisy+", "1 px: named or in its group", "no goal"),
)


@dataclass(frozen=True)
class BilliardsGapRow:
    """Result of one case."""

    kind: str
    question: str
    """one, pair, none, removed, foreign, form, trap, weak, slow, few, noisy."""
    seed: int
    answer: str
    """Names, joined by +; those of a group joined by |; otherwise the verdict."""
    right: int
    grouped: int
    """1 where the first candidate's group contains a missing effect."""
    probability: float
    p_value: float
    """p-value of the hypothesis that the residual of the simulator is noise."""
    before: float
    """Prediction error on reporting shots, m, like the next two."""
    after: float
    floor: float
    closed: float
    """Closed share of the gap; NaN where it is not resolved."""
    low: float
    high: float
    phase: str
    """Phase with the largest share of the gap."""
    phase_right: int
    """1 where the missing effect acts there, 0 where not, -1 where nothing is missing."""
    cpu: float
    """CPU seconds of the diagnosing process."""
    wall: float
    """Wall-clock seconds."""
    truth: str
    fitted: str

    def format_line(self) -> str:
        closed = "" if np.isnan(self.closed) else f", closed {self.closed:.3f} ({self.low:.2f} to {self.high:.2f})"
        return (
            f"{'right' if self.right else 'WRONG'} {self.kind:36} {self.seed:4} {self.answer:32} {self.probability:.3f}"
            f" [{self.truth}] [{self.fitted}] {1e3 * self.before:.2f} to {1e3 * self.after:.2f} of"
            f" {1e3 * self.floor:.2f} mm{closed}, {self.cpu:.0f} CPU s, {self.wall:.0f} s"
        )


def format_report(rows: Sequence[BilliardsGapRow]) -> str:
    """Format goals, gap closure, calibration, and the answers to every kind."""
    return "\n".join(
        [*_goal_lines(rows), *_closing_lines(rows), "", *_calibration_lines(rows), "", *_confusion_lines(rows)]
    )


def _goal_lines(rows: Sequence[BilliardsGapRow]) -> Iterator[str]:
    for key, words, goal in GOALS:
        here = [row for row in rows if row.question == key.rstrip("+")]
        hits = sum(row.right or (key.endswith("+") and row.grouped and "|" in row.answer) for row in here)
        yield f"{words:48} {Proportion(int(hits), len(here))!s:32} {goal}"


def _closing_lines(rows: Sequence[BilliardsGapRow]) -> Iterator[str]:
    lacking = [row for row in rows if row.question in ("one", "pair")]
    resolved = [row for row in lacking if np.isfinite(row.closed)]
    yield f"gap resolved on three shots: {Proportion(len(resolved), len(lacking))}"
    if resolved:
        shares = [row.closed for row in resolved]
        yield f"closed there: median {np.median(shares):.3f}, 10th percentile {np.quantile(shares, 0.1):.3f}"
    placed = [row.phase_right for row in rows if row.phase_right >= 0 and row.question != "trap"]
    yield f"the missing effect acts in the phase with the largest gap: {Proportion(sum(placed), len(placed))} goal 90 %"
    for words, took in (("CPU s", [row.cpu for row in rows]), ("wall-clock s", [row.wall for row in rows])):
        if took:
            yield (
                f"{words} of 12 shots: median {np.median(took):.0f}, 90th percentile {np.quantile(took, 0.9):.0f},"
                f" largest {max(took):.0f}; goal 45 s on two cores"
            )


def _calibration_lines(rows: Sequence[BilliardsGapRow]) -> Iterator[str]:
    yield "probability of the answer -> share of right answers"
    plain = [row for row in rows if row.question in ("one", "none", "foreign", "pair")]
    for low, high in pairwise(PROBABILITY_BINS):
        here = [row for row in plain if low <= row.probability < high or (high == 1.0 == row.probability)]
        if here:
            yield f"  {low:.2f} to {high:.2f}: {Proportion(sum(row.right for row in here), len(here))}"


def _confusion_lines(rows: Sequence[BilliardsGapRow]) -> Iterator[str]:
    yield "missing -> answer, count; CPU s"
    order = list(dict.fromkeys(row.kind for row in rows))
    counts = Counter((row.kind, row.answer, row.right) for row in rows)
    for (kind, answer, good), times in sorted(counts.items(), key=lambda one: (order.index(one[0][0]), -one[1])):
        cpu = [row.cpu for row in rows if (row.kind, row.answer) == (kind, answer)]
        yield f"  {'' if good else 'WRONG':5} {kind:36} {answer:40} {times} {min(cpu):.0f} to {max(cpu):.0f}"
