"""Evidence for an effect that the library lacks.

There are three signs: the residuals of the best hypothesis are not noise; shots disagree about its parameters by more
than their errors; other shots do not gain as much as the first ones predict. The first two count unless other shots are
predicted as well as noise allows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import e, log
from typing import Literal

import numpy as np
from scipy.stats import chi2, norm

from diagnosis.fitting.gap_closure import GapClosure
from diagnosis.fitting.hypothesis_fits import EffectFit, ShotInformation

# p-value below which residuals are systematic.
SUSPICIOUS_P_VALUE = 0.005
# Explained share from which effects are named: they are then a larger part of the truth than all that is left.
MIN_EXPLAINED_SHARE = 0.5
# Explained share from which effects are named although a generic law explains the rest: it has another form.
NEARLY_EXPLAINED_SHARE = 0.995
# Share of the misfit of selection shots that a generic law must explain to be far better than the named effects.
#
# It then halves the error that they leave.
MIN_LAW_SHARE = 0.75
# Share of the gap of selection shots from which the named effects are the answer, whatever small part of it they leave.
MOST_OF_GAP = 0.9
# A gap that other shots show, that they would show and do not, or that they cannot show.
GapState = Literal["shown", "absent", "unmeasured"]
# Largest size of residuals that are noise, relative to its estimate: estimates are right to a tenth on most scenes.
_MAX_NOISE_SCALE = 2.0
# Odds of an effect that the library lacks, before the data: one scene in ten or so has one.
_PRIOR_ODDS = 0.1
# Probability that agrees with either verdict.
_EVEN = 0.5


@dataclass(frozen=True, slots=True)
class UnknownEvidence:
    """Evidence for an unknown effect."""

    residual_p_value: float
    """p-value of the structure of the residuals, whatever their size."""
    residual_scale: float
    """Size of the residuals relative to the noise; 1 where the size of the noise is unknown."""
    agreement_p_value: float
    """p-value of equal parameters in all shots."""
    explained_share: float = 0.0
    """Share of the simulator's systematic misfit that the named effects explain; 1 where there was none."""
    most_probability: float = 0.0
    """Probability that the named effects explain more than half."""
    selection_gains: bool = True
    """Whether selection shots gained from the effects."""
    generic_law_share: float = float("nan")
    """Share of the misfit of selection shots that a generic law, fitted to others, explains; NaN without such a law."""
    imitation_probability: float = 0.0
    """Probability that generic laws alone explain another shot better than several named effects do, by the rule of
    succession; 0 where they explain less than `MIN_LAW_SHARE` of what these leave on selection shots, or no more than
    half of these shots better."""
    gap: GapState = "unmeasured"
    """Whether selection shots are predicted worse than noise explains, without the effects."""
    effect_count: int = 1
    """Number of named effects: each further one is half as likely beforehand, and an unknown one as likely as before.
    """

    @property
    def noise_p_value(self) -> float:
        """p-value of residuals that are only noise, and of equal parameters in all shots."""
        if self.residual_scale > _MAX_NOISE_SCALE:
            return 0.0
        return min(2 * min(self.residual_p_value, self.agreement_p_value), 1.0)

    @property
    def has_systematic_residuals(self) -> bool:
        """Whether residuals are more than noise, or shots disagree about the parameters."""
        return self.noise_p_value < SUSPICIOUS_P_VALUE

    @property
    def is_law_missing(self) -> bool:
        """Whether the systematic residuals need another law, or one law is what several effects together imitate."""
        return (
            self.explained_share < MIN_EXPLAINED_SHARE
            or (self.generic_law_share > MIN_LAW_SHARE and self.explained_share < NEARLY_EXPLAINED_SHARE)
            or self.imitation_probability > 0
        )

    @property
    def is_unknown(self) -> bool:
        """Whether an unknown effect is present."""
        return (self.has_systematic_residuals and self.is_law_missing) or not self.selection_gains

    @property
    def rest_probability(self) -> float:
        """Probability that something systematic is left.

        By the prior odds of an unknown effect to the named ones, which several together may imitate as the terms of a
        series do, and the largest odds that correspond to a p-value (Sellke, Bayarri and Berger 2001,
        doi:10.1198/000313001300339950).
        """
        smallest = self.noise_p_value if self.selection_gains else min(self.noise_p_value, SUSPICIOUS_P_VALUE)
        p = min(max(smallest, 1e-12), 1 / e)
        odds = _PRIOR_ODDS * 2.0 ** (max(self.effect_count, 1) - 1) / (-e * p * log(p))
        return odds / (1 + odds)

    @property
    def probability(self) -> float:
        """Probability that most of what is missing is not in the library: that something is left, and is most of it."""
        if self.is_unknown:
            return self.rest_probability * max(1 - self.most_probability, self.imitation_probability, _EVEN)
        return self.rest_probability * min(1 - self.most_probability, _EVEN)

    def judge_by_predictions(self, ahead: GapClosure) -> UnknownEvidence:
        """Judge the effects by how much of the gap of selection shots they close.

        Effects that close nearly all of it, and surely the larger part, are the answer, unless a generic law shows that
        theirs has another form; effects that may close less than half of it are not, where more than noise remains.

        Args:
            ahead: Closure of selection shots by the effects, with strengths from fitting shots.

        Returns:
            The evidence, with the state of the gap.
        """
        if not ahead.resolved:
            return replace(self, gap="absent" if ahead.is_absent else "unmeasured")
        judged, (low, _) = replace(self, gap="shown"), ahead.interval
        if low <= MIN_EXPLAINED_SHARE:
            return replace(judged, explained_share=max(low, 0.0))
        return replace(judged, selection_gains=True) if ahead.closed >= MOST_OF_GAP else judged

    @property
    def supported(self) -> UnknownEvidence:
        """The evidence without that of residuals, where other shots are predicted as well as noise allows.

        Residuals of a fit that are not noise are no evidence then: noise that is correlated over many samples, as a
        filter leaves it, looks like that.
        """
        if self.gap != "absent":
            return self
        return replace(self, residual_p_value=1.0, residual_scale=1.0, agreement_p_value=1.0)


def agreement_p_value(*fits: tuple[ShotInformation, EffectFit]) -> float:
    """Return the p-value of all shots of each fit having its parameters; one fit per body where bodies differ."""
    parts = [_disagreement_chi2(shot_information, fitted) for shot_information, fitted in fits]
    total, free = sum(one for one, _ in parts), sum(max(more, 0) for _, more in parts)
    return float(chi2.sf(total, free)) if free > 0 else 1.0


def _disagreement_chi2(shot_information: ShotInformation, fitted: EffectFit) -> tuple[float, int]:
    """Return the chi2 that shots would gain from own parameters, and the number of additional parameters.

    It follows from the gradients of their likelihoods at the fit.
    """
    total, free = 0.0, 0
    for information, score in zip(shot_information.information, shot_information.score, strict=True):
        here, slope = information[np.ix_(fitted.free, fitted.free)], score[fitted.free]
        scale = 1 / np.sqrt(np.maximum(np.diag(here), 1e-12))
        sizes, axes = np.linalg.eigh(here * scale * scale[:, None])
        significant = sizes > 1e-6
        total += float((np.square(axes[:, significant].T @ (slope * scale)) / sizes[significant]).sum())
        free += int(significant.sum())
    return total, free - int(fitted.free.sum())


def min_selection_gain(first: int, second: int) -> float:
    """Return the chi2 that `second` shots must gain from an effect fitted to `first` shots; less is a contradiction.

    A strength of b standard deviations of the second shots, itself estimated from the first ones, gives a gain of b^2
    plus or minus 2 b sqrt(1 + second/first). For any b, chance leaves less than this in half of SUSPICIOUS_P_VALUE of
    all cases.
    """
    return -float((1 + second / first) * norm.isf(SUSPICIOUS_P_VALUE / 2) ** 2)


def estimate_explained_share(
    base: EffectFit, best: EffectFit, shot_information: ShotInformation, ahead: GapClosure | None
) -> tuple[float, float]:
    """Estimate the share of the systematic misfit that the better model explains, and how probably it is most of it.

    The misfit is the error of predictions where that exceeds noise, else the cost of the fit. Its remainder is
    systematic where it exceeds noise or shots contradict each other: parameters hide unexplained parts in the noise.
    """
    if not best.names and best.forms == base.forms:
        # so few shots allow no certainty: the next one may be explained (Laplace's rule of succession)
        return 0.0, 1 / (len(shot_information.shots) + 2)
    if ahead is not None and ahead.resolved:
        return float(np.clip(ahead.closed, 0.0, 1.0)), ahead.most_probability
    total, free = _disagreement_chi2(shot_information, best)
    excess = base.cost - best.cost + max(best.systematic_cost, total - free)
    share = 1.0 if excess <= 0 else float(np.clip((base.cost - best.cost) / excess, 0.0, 1.0))
    return share, share
