"""The tables of benchmarks/diagnosis/gap.py, made from its rows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from benchmarks.diagnosis.gap_trial import GapRow
from pipeline.experiments.gapcheck.blind_case import PROBABILITY_BINS, Proportion

GOALS = (
    ("natural", "natural strength: named", 0.90), ("natural+", "or in a group that an oracle cannot separate", 0.97),
    ("near+", "just above the noise: named or in its group", 0.75),
    ("none white", "false alarms: white noise", 0.03), ("none correlated", "false alarms: correlated noise", 0.05),
    ("none outliers", "false alarms: outliers and gaps", 0.05),
    ("none heavy", "false alarms: noise of Student's t, 3 degrees", 0.05),
    ("none quantised", "false alarms: steps of three sigmas", 0.05),
    ("none filtered", "false alarms: smoothed over nine frames", 0.05),
    ("withheld+", "removed from the library: unknown, or a twin", 0.80), ("foreign", "in no library: unknown", 0.80),
    ("pair", "two missing: both named", 0.80), ("form", "another functional form: the family named", None),
    ("trap", "traps: group or not identifiable", 1.0), ("garbage", "garbage in reporting shots changes nothing", 1.0),
    ("30 fps+", "30 fps: named or grouped", None), ("5 shots+", "5 shots: named or grouped", None),
    ("1 px+", "1 px: named or grouped", None),
)  # fmt: skip


def format_report(rows: Sequence[GapRow]) -> str:
    """Format goals, gap closure, calibration, confusion, and every wrong answer."""
    parts = [
        *_goal_lines(rows),
        *_closing_lines(rows),
        "",
        *_calibration_lines(rows),
        "",
        *_confusion_lines(rows),
        "",
        *_law_lines(rows),
        "",
        *_wrong_lines(rows),
    ]
    return "\n".join(parts)


def _goal_lines(rows: Sequence[GapRow]) -> Iterator[str]:
    for key, words, goal in GOALS:
        question = key.rstrip("+").split()[0] if key.startswith("none") else key.rstrip("+")
        here = [row for row in rows if row.question == question and _has_noise_kind(key, row)]
        hits = sum(row.right or (key.endswith("+") and row.excused) for row in here)
        if key.startswith("none"):
            hits = len(here) - hits
        wanted = "" if goal is None else f"goal {'at most ' if key.startswith('none') else ''}{goal:.0%}"
        yield f"{words:48} {Proportion(hits, len(here))!s:32} {wanted}"


def _has_noise_kind(key: str, row: GapRow) -> bool:
    if not key.startswith("none"):
        return True
    words = ("correlated", "outliers", "heavy", "quantised", "filtered")
    word = next((word for word in words if word in row.kind), "white")
    return word == key.split()[1]


def _closing_lines(rows: Sequence[GapRow]) -> Iterator[str]:
    for question in ("natural", "pair", "form", "30 fps", "5 shots", "1 px"):
        here = [row for row in rows if row.question == question and row.oracle > 0]
        shares = [max(row.closed, -1.0) / row.oracle if np.isfinite(row.closed) else 0.0 for row in here]
        if shares:
            middle, low = np.median(shares), np.quantile(shares, 0.1)
            statistics = f"median {middle:.3f}, 10th percentile {low:.3f}, {len(here)}"
            yield f"closed share over an oracle's, {question}: {statistics}"
    resolved = [row for row in rows if np.isfinite([row.fresh, row.closed]).all()]
    covered = sum(row.low <= row.fresh <= row.high for row in resolved)
    yield f"95 % interval contains the share of fresh shots: {Proportion(covered, len(resolved))} goal 90 to 98 %"
    cpu = [row.cpu for row in rows if row.question == "natural"]
    if cpu:
        yield f"CPU s of 12 shots: median {np.median(cpu):.1f}, largest {max(cpu):.1f}; goal 45 s on two cores"


def _calibration_lines(rows: Sequence[GapRow]) -> Iterator[str]:
    yield "probability of the answer -> share of right (or excused) answers"
    plain = [row for row in rows if row.question in ("natural", "near", "none", "foreign", "pair")]
    for low, high in pairwise(PROBABILITY_BINS):
        here = [row for row in plain if low <= row.probability < high or (high == 1.0 == row.probability)]
        if here:
            yield f"  {low:.2f} to {high:.2f}: {Proportion(sum(row.right or row.excused for row in here), len(here))}"


def _confusion_lines(rows: Sequence[GapRow]) -> Iterator[str]:
    yield "missing -> answer, count"
    counts = Counter((row.question, row.kind, row.answer) for row in rows)
    order = list(dict.fromkeys((row.question, row.kind) for row in rows))
    for (question, kind, answer), times in sorted(counts.items(), key=lambda one: (order.index(one[0][:2]), -one[1])):
        yield f"  {question:9} {kind:48} {answer:40} {times}"


def _law_lines(rows: Sequence[GapRow]) -> Iterator[str]:
    yield "laws that no library holds: what remains unexplained"
    for row in rows:
        if row.question in ("foreign", "form"):
            closed = "" if math.isnan(row.closed) else f", closes {row.closed:.2f}"
            yield f"  {row.kind:32} seed {row.seed}: {row.answer}{closed}; {row.law or 'no law'}"


def _wrong_lines(rows: Sequence[GapRow]) -> Iterator[str]:
    yield "wrong answers"
    for row in rows:
        if not row.right:
            mark = "(excused)" if row.excused else ""
            answer = f"{row.answer}, p {row.probability:.2f}"
            yield f"  {row.question:9} {row.kind:48} seed {row.seed}: {answer} {row.strengths} {mark}"
