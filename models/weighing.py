"""Did two bodies touch? Everything that may have happened is weighed, and the balance struck.

Apart from touching or not, a ball may have rolled or slid where its path begins, and errors of successive samples may
be correlated more or less: the evidences of all these add up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from models.evidence import Fitted, believed, fit, noise_of, starts
from models.touch import MEETING, SHARED, Encounter, free_paths, met_paths, nearest

Floats = NDArray[np.float64]

CORRELATIONS = (0.0, 0.35, 0.6, 0.8)
"""Of errors of successive samples, equally probable before: an AR(1) process each."""
SLIDES = 0.05
"""m/s of slip from which a ball slides; with less it is told as one that rolls."""
HOPELESS = 40.0
"""ln of the odds at which a hypothesis is not followed any further."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the samples say of one moment."""

    probability: float
    """That the bodies touched."""
    t: float
    """s: of the contact; of the nearest moment where none is likelier."""
    t_sigma: float
    gap: float
    """m: least distance of the surfaces on free paths, negative where they would overlap, as the samples before and
    after tell, whichever hypothesis is likelier."""
    gap_sigma: float
    chi2: float
    """per degree of freedom, of the likelier hypothesis, against the errors that the samples promise."""
    correlation: float
    """of errors of successive samples."""
    closing: float
    """m/s along the normal at contact; 0 where they did not touch."""


@dataclass(frozen=True, slots=True)
class _Weight:
    """One way in which it may have been."""

    encounter: Encounter
    correlation: float
    fit: Fitted
    log_evidence: float


def weigh(encounter: Encounter, t: float, correlations: tuple[float, ...] = CORRELATIONS) -> Verdict:
    """How probable a contact near t (s) is, and when; ValueError where there are too few samples to say.

    The encounter's window holds no other contact. `correlations` are those of errors that are thought possible.
    """
    count = sum(len(ball.t) for ball in encounter.balls)
    if 2 * count < encounter.shared + SHARED + MEETING:
        raise ValueError(f"a contact is weighed by at least {encounter.shared} samples; got {count}")
    kept = believed(encounter, *starts(encounter, t))
    ways = [(way, met) for way in _ways(encounter) for met in (False, True)]
    begun = [_weight(way, met, starts(way, t)[met], kept, correlations[0]) for way, met in ways]
    found = list(begun)
    best = max(weight.log_evidence for weight in begun)
    for (way, met), weight in zip(ways, begun, strict=True):
        if weight.log_evidence < best - HOPELESS:
            continue
        for correlation in correlations[1:]:
            weight = _weight(way, met, weight.fit.p, kept, correlation)
            found.append(weight)
    return _verdict(found)


def geometry_alone(encounter: Encounter, t: float) -> tuple[float, float]:
    """Gap, and its sigma, m, to which the paths that are seen before t (s) lead; errors taken as independent."""
    late = np.concatenate([ball.t >= t for ball in encounter.balls])
    _, met = starts(encounter, t)
    found = fit(encounter, free_paths, met[: encounter.shared + SHARED], noise_of(encounter, ~late, 0.0))
    return _margin(encounter, found)


def _ways(encounter: Encounter) -> Iterator[Encounter]:
    """The encounter with every ball that moves rolling or sliding where its path begins."""
    for rolls in product(*((False,) if ball.rests else (True, False) for ball in encounter.balls)):
        yield replace(encounter, balls=tuple(
            replace(ball, rolls=roll) for ball, roll in zip(encounter.balls, rolls, strict=True)))  # fmt: skip


def _weight(encounter: Encounter, met: bool, start: Floats, kept: NDArray[np.bool_], correlation: float) -> _Weight:
    found = fit(encounter, met_paths if met else free_paths, start, noise_of(encounter, kept, correlation))
    slips = [found.p[columns][4:] for columns in encounter.columns]
    told_twice = any(len(slip) and np.hypot(*slip) < SLIDES for slip in slips)
    return _Weight(encounter, correlation, found, -np.inf if told_twice else found.log_evidence)


def _verdict(found: list[_Weight]) -> Verdict:
    def met(weight: _Weight) -> bool:
        return len(weight.fit.p) > weight.encounter.shared + SHARED

    total = [float(logsumexp([w.log_evidence for w in found if met(w) is touched])) for touched in (False, True)]
    probability = float(np.exp(total[1] - logsumexp(total)))
    touched = probability > 0.5
    best = max((w for w in found if met(w) is touched), key=lambda w: w.log_evidence)
    encounter, chosen = best.encounter, best.fit
    gap, gap_sigma = _margin(encounter, chosen)
    column = encounter.shared + SHARED
    variance = chosen.covariance[column, column] if touched else _nearest_variance(encounter, chosen)
    data = 2 * sum(len(ball.t) for ball in encounter.balls)
    return Verdict(
        probability, chosen.paths.t, float(np.sqrt(variance)), gap, gap_sigma,
        chosen.chi2 / max(data - len(chosen.p), 1), best.correlation,
        max(chosen.paths.closing, 0.0) if touched else 0.0,
    )  # fmt: skip


def _margin(encounter: Encounter, found: Fitted) -> tuple[float, float]:
    """Gap of the free paths that begin as this fit does, and its sigma, m."""
    size = encounter.shared + SHARED
    paths = nearest(encounter, found.p[:size])
    variance = float(paths.gap_slope @ found.covariance[:size, :size] @ paths.gap_slope)
    if len(found.p) == size:
        variance += encounter.reach_sigma**2
    return paths.gap, float(np.sqrt(variance))


def _nearest_variance(encounter: Encounter, found: Fitted) -> float:
    """Of the moment at which free paths are nearest, s^2: where the closing speed passes zero."""
    later = met_paths(encounter, np.concatenate([found.p, [found.paths.t + 1e-3, 1.0, 0.0, 0.0]]))
    rate = (later.closing - found.paths.closing) / 1e-3
    slope = found.paths.closing_slope / min(rate, -1e-6)
    variance = float(slope @ found.covariance @ slope)
    return min(variance, 0.25)
