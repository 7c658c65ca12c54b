"""The table of benchmarks/gap.py, from its rows alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from gap_trial import Row

from pipeline.experiments.gapcheck.case_scores import BINS, Rate

GOALS = (
    ("natural", "natural strength: named", 0.90), ("natural+", "or in a group that an oracle cannot split", 0.97),
    ("near+", "just above the noise: named or in its group", 0.75),
    ("none white", "false alarms: white noise", 0.03), ("none correlated", "false alarms: correlated noise", 0.05),
    ("none outliers", "false alarms: outliers and gaps", 0.05),
    ("withheld+", "taken out of the library: unknown, or a twin", 0.80), ("foreign", "in no library: unknown", 0.80),
    ("pair", "two missing: both named", 0.80), ("form", "another functional form: the family named", None),
    ("trap", "traps: group or unidentifiable", 1.0), ("garbage", "held-out garbage changes nothing", 1.0),
    ("30 fps+", "30 fps: named or grouped", None), ("5 shots+", "5 shots: named or grouped", None),
    ("1 px+", "1 px: named or grouped", None),
)  # fmt: skip


def told(rows: Sequence[Row]) -> str:
    """The table of goals, what closed, calibration, confusion, and every answer that was not right."""
    parts = [*_goals(rows), *_closing(rows), "", *_calibration(rows), "", *_confusion(rows), "", *_wrong(rows)]
    return "\n".join(parts)


def _goals(rows: Sequence[Row]) -> Iterator[str]:
    for key, words, goal in GOALS:
        asked = key.rstrip("+").split()[0] if key.startswith("none") else key.rstrip("+")
        here = [row for row in rows if row.asked == asked and _camera(key, row)]
        hits = sum(row.right or (key.endswith("+") and row.excused) for row in here)
        if key.startswith("none"):
            hits = len(here) - hits
        wanted = "" if goal is None else f"asked {'at most ' if key.startswith('none') else ''}{goal:.0%}"
        yield f"{words:48} {Rate(hits, len(here))!s:32} {wanted}"


def _camera(key: str, row: Row) -> bool:
    if not key.startswith("none"):
        return True
    word = next((word for word in ("correlated", "outliers") if word in row.kind), "white")
    return word == key.split()[1]


def _closing(rows: Sequence[Row]) -> Iterator[str]:
    for asked in ("natural", "pair", "form", "30 fps", "5 shots", "1 px"):
        here = [row for row in rows if row.asked == asked and row.oracle > 0]
        shares = [max(row.closed, -1.0) / row.oracle if np.isfinite(row.closed) else 0.0 for row in here]
        if shares:
            middle, low = np.median(shares), np.quantile(shares, 0.1)
            yield f"closed part over an oracle's, {asked}: median {middle:.3f}, 10th percentile {low:.3f}, {len(here)}"
    tried = [row for row in rows if np.isfinite([row.fresh, row.closed]).all()]
    covered = sum(row.low <= row.fresh <= row.high for row in tried)
    yield f"95 % interval holds the closed part of fresh shots: {Rate(covered, len(tried))} asked 90 to 98 %"
    cpu = [row.cpu for row in rows if row.asked == "natural"]
    if cpu:
        yield f"CPU s of 12 shots: median {np.median(cpu):.1f}, largest {max(cpu):.1f}; asked 45 s on two cores"


def _calibration(rows: Sequence[Row]) -> Iterator[str]:
    yield "probability of the answer -> how often it is right (or excused)"
    plain = [row for row in rows if row.asked in ("natural", "near", "none", "foreign", "pair")]
    for low, high in pairwise(BINS):
        here = [row for row in plain if low <= row.probability < high or (high == 1.0 == row.probability)]
        if here:
            yield f"  {low:.2f} to {high:.2f}: {Rate(sum(row.right or row.excused for row in here), len(here))}"


def _confusion(rows: Sequence[Row]) -> Iterator[str]:
    yield "what was there -> what was said, times"
    counts = Counter((row.asked, row.kind, row.said) for row in rows)
    order = list(dict.fromkeys((row.asked, row.kind) for row in rows))
    for (asked, kind, said), times in sorted(counts.items(), key=lambda one: (order.index(one[0][:2]), -one[1])):
        yield f"  {asked:9} {kind:48} {said:40} {times}"


def _wrong(rows: Sequence[Row]) -> Iterator[str]:
    yield "answers that were not right"
    for row in rows:
        if not row.right:
            mark = "(excused)" if row.excused else ""
            said = f"{row.said}, p {row.probability:.2f}"
            yield f"  {row.asked:9} {row.kind:48} seed {row.seed}: {said} {row.strengths} {mark}"
