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

from models.core.typing import FloatArray
from models.estimation.contact_test.contact_evidence import Fitted, believed, fit, noise_of, starts
from models.estimation.contact_test.contact_moment import MEETING, SHARED, Encounter, free_paths, met_paths, nearest

CORRELATIONS = (0.0, 0.35, 0.6, 0.8)
"""Of errors of successive samples, equally probable before: an AR(1) process each."""
SLIDES = 0.05
"""m/s of slip from which a ball slides; with less it is told as one that rolls."""
HOPELESS = 20.0
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
    _check(encounter)
    kept = _kept(encounter, t)
    found = []
    for way in _ways(encounter):
        free = _weight(way, False, starts(way, t)[0], kept, correlations[0])
        found += [free, _met(way, t, kept, correlations[0], free.fit)]
    best = max(weight.log_evidence for weight in found)
    for begun in [weight for weight in found if weight.log_evidence > best - HOPELESS]:
        start, met = begun.fit.p, _touches(begun)
        found += [_weight(begun.encounter, met, start, kept, correlation) for correlation in correlations[1:]]
    return _verdict(found)


def timed(encounter: Encounter, t: float) -> Verdict:
    """When bodies touched that surely did, near t (s); errors taken as independent. ValueError as for `weigh`."""
    _check(encounter)
    kept = _kept(encounter, t)
    return _verdict([_met(way, t, kept, 0.0) for way in _ways(encounter)])


def _check(encounter: Encounter) -> None:
    count = sum(len(ball.t) for ball in encounter.balls)
    if 2 * count < encounter.shared + SHARED + MEETING:
        raise ValueError(f"a contact is weighed by at least {encounter.shared} samples; got {count}")


def _kept(encounter: Encounter, t: float) -> NDArray[np.bool_]:
    """(K,) samples that are believed, however the balls moved."""
    moving = replace(encounter, balls=tuple(replace(ball, rests=False) for ball in encounter.balls))
    return believed(moving, *starts(moving, t))


def _met(way: Encounter, t: float, kept: NDArray[np.bool_], correlation: float, free: Fitted | None = None) -> _Weight:
    """The better of two descents: from how the balls came, and from the path that ignores the contact."""
    start = starts(way, t)[1]
    found = _weight(way, True, start, kept, correlation)
    if free is None or found.fit.chi2 < free.chi2:
        return found
    column = way.shared + SHARED
    again = np.concatenate([free.p, [free.paths.t], start[column + 1 :]])
    other = _weight(way, True, again, kept, correlation)
    return max(found, other, key=lambda weight: weight.log_evidence)


def geometry_alone(encounter: Encounter, t: float) -> tuple[float, float]:
    """Gap, and its sigma, m, to which the paths that are seen before t (s) lead; errors taken as independent."""
    late = np.concatenate([ball.t >= t for ball in encounter.balls])
    _, met = starts(encounter, t)
    found = fit(encounter, free_paths, met[: encounter.shared + SHARED], noise_of(encounter, ~late, 0.0))
    return _margin(encounter, found)


def _ways(encounter: Encounter) -> Iterator[Encounter]:
    """The encounter with every ball rolling or sliding where its path begins, or resting if it may."""
    told = [
        [replace(ball, rests=False, rolls=rolls) for rolls in (True, False)] + [ball] * ball.rests
        for ball in encounter.balls
    ]
    for balls in product(*told):
        yield replace(encounter, balls=balls)


def _weight(encounter: Encounter, met: bool, start: FloatArray, kept: NDArray[np.bool_], correlation: float) -> _Weight:
    found = fit(encounter, met_paths if met else free_paths, start, noise_of(encounter, kept, correlation))
    slips = [found.p[columns][4:] for columns in encounter.columns]
    told_twice = any(len(slip) and np.hypot(*slip) < SLIDES for slip in slips)
    return _Weight(encounter, correlation, found, -np.inf if told_twice else found.log_evidence)


def _touches(weight: _Weight) -> bool:
    return len(weight.fit.p) > weight.encounter.shared + SHARED


def _verdict(found: list[_Weight]) -> Verdict:
    free, met = ([w.log_evidence for w in found if _touches(w) is touches] for touches in (False, True))
    probability = float(np.exp(logsumexp(met) - logsumexp([*free, *met])))
    touched = probability > 0.5
    best = max((w for w in found if _touches(w) is touched), key=lambda w: w.log_evidence)
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
