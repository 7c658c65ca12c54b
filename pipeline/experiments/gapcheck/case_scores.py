"""Scores of many opened cases: rates with their intervals, confusions and calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from pipeline.experiments.gapcheck.blind_case import OpenedCase

# Coverage of the intervals.
CONFIDENCE = 0.95
# Edges of the bins of probability in the calibration.
PROBABILITY_BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True, slots=True)
class Proportion:
    """A proportion `hits` of `of`, with Wilson's interval (1927, doi:10.1080/01621459.1927.10502953)."""

    hits: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """Interval at CONFIDENCE; (0, 1) where `of` is 0."""
        if not self.of:
            return 0.0, 1.0
        z = float(norm.ppf(0.5 + CONFIDENCE / 2))
        share, weight = self.hits / self.of, z**2 / self.of
        middle = (share + weight / 2) / (1 + weight)
        half = z / (1 + weight) * np.sqrt(share * (1 - share) / self.of + z**2 / (4 * self.of**2))
        return float(middle - half), float(middle + half)

    def __str__(self) -> str:
        if not self.of:
            return "-"
        low, high = self.interval
        return f"{self.hits}/{self.of} = {self.hits / self.of:.0%} ({low:.0%} to {high:.0%})"


@dataclass(frozen=True, slots=True)
class CaseScores:
    """Scores of all cases by their kind."""

    named: Proportion
    """One effect is missing: its name is given."""
    grouped: Proportion
    """One effect is missing: its name or a group that holds it is given."""
    pairs: Proportion
    """Two effects are missing: both names are given."""
    alarms: Proportion
    """Nothing is missing: an effect is named (false alarm)."""
    unknowns: Proportion
    """The missing effect is in no library: the verdict is `unknown`."""
    traps: Proportion
    """The shots cannot show the missing effect: no name is guessed."""
    closed: tuple[float, float]
    """Closed part of the gap over that of an oracle, where an effect is missing: median and tenth percentile."""
    covered: Proportion
    """The interval of the closed part holds that of the oracle."""


def score_cases(cases: Sequence[OpenedCase]) -> CaseScores:
    """Score opened cases.

    Args:
        cases: Opened cases of all kinds.

    Returns:
        Rates by kind of question, and the closed part of the gap.
    """
    traps = [one for one in cases if one.kind.trap]
    plain = [one for one in cases if not one.kind.trap]
    foreign = [one for one in plain if one.kind.foreign]
    single, pairs, clean = (
        [one for one in plain if len(one.kind.withheld) == count and not one.kind.foreign] for count in (1, 2, 0)
    )
    shares = np.array([share for one in (*single, *pairs) for share in _closure_share(one)])
    resolved = [one for one in (*single, *pairs) if np.isfinite([one.closed, one.oracle]).all()]
    return CaseScores(
        _count_answers(single, "right"),
        _count_answers(single, "right", "group"),
        _count_answers(pairs, "right"),
        Proportion(len(clean) - _count_answers(clean, "right").hits, len(clean)),
        _count_answers(foreign, "right"),
        _count_answers(traps, "right"),
        (float(np.median(shares)), float(np.quantile(shares, 0.1))) if len(shares) else (np.nan, np.nan),
        Proportion(sum(one.interval[0] <= one.oracle <= one.interval[1] + 1e-9 for one in resolved), len(resolved)),
    )


def count_confusions(cases: Sequence[OpenedCase]) -> list[tuple[str, str, int]]:
    """Count the answers to each kind of case.

    Args:
        cases: Opened cases.

    Returns:
        Kind, answer and count, in the order of the kinds; the most frequent answer of each first.
    """
    counts = Counter((one.kind.name, " + ".join(one.named)) for one in cases)
    order = list(dict.fromkeys(one.kind.name for one in cases))
    return sorted(
        ((kind, answer, n) for (kind, answer), n in counts.items()), key=lambda row: (order.index(row[0]), -row[2])
    )


def compute_calibration(cases: Sequence[OpenedCase]) -> list[tuple[float, float, Proportion]]:
    """Compute the rate of right answers by their stated probability.

    Args:
        cases: Opened cases.

    Returns:
        Lower edge, upper edge and rate of each bin.
    """
    rows = []
    for low, high in pairwise(PROBABILITY_BINS):
        inside = [one for one in cases if low <= one.probability < high or (high == 1.0 and one.probability == 1.0)]
        rows.append((low, high, _count_answers(inside, "right")))
    return rows


def _count_answers(cases: Sequence[OpenedCase], *answers: str) -> Proportion:
    """Return the proportion of cases with one of these answers."""
    return Proportion(sum(one.answer in answers for one in cases), len(cases))


def _closure_share(one: OpenedCase) -> tuple[float, ...]:
    """Return the closed part over the oracle's; 0 where only the oracle's is resolved, empty where neither is."""
    if not np.isfinite(one.oracle) or one.oracle <= 0:
        return ()
    return (max(one.closed, -1.0) / one.oracle if np.isfinite(one.closed) else 0.0,)
