"""Whether something is there that the library does not hold.

Three signs: what the best hypothesis leaves is not noise; shots disagree about its parameters by more than their
errors; other shots do not gain what the first ones promised.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import e, log

import numpy as np
from scipy.stats import chi2, norm

from diagnosis.fitting.gap_closure import Closing
from diagnosis.fitting.hypothesis_fits import Fitted, Told
from diagnosis.fitting.residual_blocks import Structure

SUSPICIOUS = 0.005
"""chance below which something is left."""
EXPLAINED = 0.95
"""share of what was systematic that data must allow effects to explain, for these to be named although something is
left: films of real tables leave a few per cent that no law makes."""
MOSTLY = 0.9
"""share that they must be found to explain."""
NEARLY = 0.995
"""the same from which effects are named although a generic law would explain the rest: another form of the law."""
LAWFUL = 0.3
"""share of what is left on shots which chose nothing that a generic law must explain to be a law that is missing."""
_PRIOR_ODDS = 0.1


@dataclass(frozen=True, slots=True)
class Doubt:
    """How much speaks for something unknown."""

    left: float
    """p-value of what is left."""
    shots_agree: float
    """p-value of the parameters being the same in all shots."""
    explained: float
    """share of the systematic part of the simulator's misfit that the effects named explain; 1 where there was none."""
    at_most: float
    """share that these data still allow."""
    select_gains: bool
    """shots that chose nothing gained from the effects."""
    lawful: float
    """share of what is left on shots that chose nothing that a generic law from the others explains; NaN where there
    is none to try."""

    @property
    def something_left(self) -> bool:
        return 2 * min(self.left, self.shots_agree) < SUSPICIOUS

    @property
    def law_missing(self) -> bool:
        """Of what is left."""
        if np.isnan(self.lawful):
            return self.explained < MOSTLY or self.at_most < EXPLAINED
        return self.explained < MOSTLY or (self.lawful > LAWFUL and self.explained < NEARLY)

    @property
    def unknown(self) -> bool:
        return (self.something_left and self.law_missing) or not self.select_gains

    @property
    def probability(self) -> float:
        """Of something unknown, by the largest odds that a p-value can stand for (Sellke, Bayarri, Berger 2001,
        doi:10.1198/000313001300339950)."""
        p = min(max(2 * min(self.left, self.shots_agree), 1e-12), 1 / e)
        odds = _PRIOR_ODDS / (-e * p * log(p))
        chance = odds / (1 + odds)
        if self.unknown:
            return max(chance, 0.6)
        return chance * (1 - self.explained) if self.something_left else min(chance, 0.4)


def agreement(told: Told, fitted: Fitted) -> float:
    """p-value of all shots having the fitted parameters."""
    total, free = _disagreement(told, fitted)
    return float(chi2.sf(total, free)) if free > 0 else 1.0


def _disagreement(told: Told, fitted: Fitted) -> tuple[float, int]:
    """chi2 that parameters of their own would gain shots, and how many more these are, from the slopes of their
    likelihoods at the fit."""
    total, free = 0.0, 0
    for information, score in zip(told.information, told.score, strict=True):
        here, slope = information[np.ix_(fitted.free, fitted.free)], score[fitted.free]
        scale = 1 / np.sqrt(np.maximum(np.diag(here), 1e-12))
        sizes, axes = np.linalg.eigh(here * scale * scale[:, None])
        kept = sizes > 1e-6
        total += float((np.square(axes[:, kept].T @ (slope * scale)) / sizes[kept]).sum())
        free += int(kept.sum())
    return total, free - int(fitted.free.sum())


def least_gain(first: int, second: int) -> float:
    """chi2 that so many shots must gain from an effect whose strength the `first` ones told; less is a contradiction.

    A strength of b standard deviations of the second shots, itself told by the first ones, makes them gain b^2 give or
    take 2 b sqrt(1 + second/first): whatever b, chance leaves less than this in half a SUSPICIOUS share of all cases.
    """
    return -float((1 + second / first) * norm.isf(SUSPICIOUS / 2) ** 2)


def explained(base: Fitted, best: Fitted, told: Told, ahead: Closing | None) -> tuple[float, float]:
    """Share of what is systematic that the better model takes away, and the most that it may be: of the error of
    predictions where that is more than noise, else of the cost of the fit. What it leaves is systematic as far as it is
    more than noise, or as shots contradict each other: parameters hide in the noise what they do not explain."""
    if ahead is not None and ahead.resolved:
        return float(np.clip(ahead.closed, 0.0, 1.0)), ahead.interval[1]
    total, free = _disagreement(told, best)
    excess = base.cost - best.cost + max(best.unlike_noise, total - free)
    share = 1.0 if excess <= 0 else float(np.clip((base.cost - best.cost) / excess, 0.0, 1.0))
    return share, share


def doubt(left: Structure, told: Told, base: Fitted, best: Fitted, ahead: Closing | None, select_gains: bool) -> Doubt:
    """All three signs together, of the best hypothesis on all shots that may be used."""
    shares = explained(base, best, told, ahead) if best.names or best.forms != base.forms else (0.0, 0.0)
    return Doubt(left.p_value, agreement(told, best), *shares, select_gains, float("nan"))


def lawful(before: Fitted, after: Fitted) -> float:
    """Share of what a model leaves of shots, beyond noise, that a generic law beside it explains."""
    left = before.unlike_noise
    return float(np.clip((before.cost - after.cost) / left, -1.0, 1.0)) if left > 0 else 0.0
