"""What many opened cases say together: rates with their intervals, confusion, calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from pipeline.experiments.gapcheck.blind_case import Opened

CONFIDENCE = 0.95
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True, slots=True)
class Rate:
    """So many of so many, with Wilson's interval (1927, doi:10.1080/01621459.1927.10502953)."""

    hits: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """At CONFIDENCE; (0, 1) where nothing was tried."""
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
class Marks:
    """All cases by what they ask."""

    named: Rate
    """one effect missing: its name."""
    grouped: Rate
    """or a group of effects that holds it."""
    pairs: Rate
    """two effects missing: both names."""
    alarms: Rate
    """nothing missing: something named all the same."""
    unknowns: Rate
    """what no library holds: said to be unknown."""
    traps: Rate
    """shots that cannot tell what is missing: no name that is a guess."""
    closed: tuple[float, float]
    """closed part of the gap over that of an oracle, where an effect is missing: median, tenth percentile."""
    covered: Rate
    """the interval of the closed part holds what the oracle closes."""


def marks_of(cases: Sequence[Opened]) -> Marks:
    traps = [one for one in cases if one.kind.trap]
    plain = [one for one in cases if not one.kind.trap]
    foreign = [one for one in plain if one.kind.foreign]
    single, pairs, clean = (
        [one for one in plain if len(one.kind.withheld) == count and not one.kind.foreign] for count in (1, 2, 0)
    )
    shares = np.array([share for one in (*single, *pairs) for share in _share(one)])
    resolved = [one for one in (*single, *pairs) if np.isfinite([one.closed, one.oracle]).all()]
    return Marks(
        _rate(single, "right"),
        _rate(single, "right", "group"),
        _rate(pairs, "right"),
        Rate(len(clean) - _rate(clean, "right").hits, len(clean)),
        _rate(foreign, "right"),
        _rate(traps, "right"),
        (float(np.median(shares)), float(np.quantile(shares, 0.1))) if len(shares) else (np.nan, np.nan),
        Rate(sum(one.interval[0] <= one.oracle <= one.interval[1] + 1e-9 for one in resolved), len(resolved)),
    )


def confusion(cases: Sequence[Opened]) -> list[tuple[str, str, int]]:
    """What was withheld, what was said, how often; the most frequent of each first."""
    counts = Counter((one.kind.name, " + ".join(one.named)) for one in cases)
    order = list(dict.fromkeys(one.kind.name for one in cases))
    return sorted(
        ((kind, said, n) for (kind, said), n in counts.items()), key=lambda row: (order.index(row[0]), -row[2])
    )


def calibration(cases: Sequence[Opened]) -> list[tuple[float, float, Rate]]:
    """By the probability of the answer: from, to, how often it was right."""
    rows = []
    for low, high in pairwise(BINS):
        inside = [one for one in cases if low <= one.probability < high or (high == 1.0 and one.probability == 1.0)]
        rows.append((low, high, _rate(inside, "right")))
    return rows


def _rate(cases: Sequence[Opened], *answers: str) -> Rate:
    return Rate(sum(one.answer in answers for one in cases), len(cases))


def _share(one: Opened) -> tuple[float, ...]:
    """Closed part over the oracle's; 0 where only the oracle's is resolved, nothing where neither is."""
    if not np.isfinite(one.oracle) or one.oracle <= 0:
        return ()
    return (max(one.closed, -1.0) / one.oracle if np.isfinite(one.closed) else 0.0,)
