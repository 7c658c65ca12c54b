"""Premises of all events of a ball: its track is one ball, and its motion is that of balls on this table.

An event happened if its premises hold and it happened given that, so that its probability is the product of both. The
evidence against premises is what the trust level of the clip knows. Its weights are fitted to the same shots as those
of `event_probability`, to which objects were added that are no balls, and whose calibration was falsified.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.special import expit

from models.core.fit_result import BallPremise
from models.core.typing import FloatArray
from models.estimation.shot_hypotheses.event_probability import read_event_model


@dataclass(frozen=True, slots=True)
class PremiseEvidence:
    """Evidence against the premises of the events of a ball; every value is at least 0, and 0 where there is none."""

    own: float = 0.0
    """Share of the moving time of the ball that no accepted fit explains."""
    others: float = 0.0
    """The same share of all other balls together."""
    changes: float = 0.0
    """Logarithm of the sum of the sizes of velocity changes and jumps of the ball without a known cause, plus 1."""

    @property
    def vector(self) -> FloatArray:
        """Values in the order of `PREMISE_EVIDENCE_NAMES`."""
        return np.array([getattr(self, name) for name in PREMISE_EVIDENCE_NAMES])


PREMISE_EVIDENCE_NAMES = tuple(field.name for field in fields(PremiseEvidence))


def estimate_premise_probability(evidence: PremiseEvidence) -> float:
    """Estimate the probability that the premises of the events of a ball hold.

    Args:
        evidence: Evidence against them.

    Returns:
        The probability.
    """
    model = read_event_model()
    weight = np.array([model.premise_weight[name] for name in PREMISE_EVIDENCE_NAMES])
    return float(expit(model.premise_bias - weight @ evidence.vector))


def assess_premises(seconds: FloatArray, explained_seconds: FloatArray, changes: FloatArray) -> list[BallPremise]:
    """Assess the premises of the events of each ball.

    Args:
        seconds: (N,) moving time of each ball, s.
        explained_seconds: (N,) the part of it that accepted fits explain, s.
        changes: (N,) sum of the sizes of its velocity changes and jumps without a known cause.

    Returns:
        N premises.
    """
    unexplained = seconds - explained_seconds
    premises = []
    for ball in range(len(seconds)):
        others = seconds.sum() - seconds[ball]
        evidence = PremiseEvidence(
            float(unexplained[ball] / seconds[ball]) if seconds[ball] > 0 else 0.0,
            float((unexplained.sum() - unexplained[ball]) / others) if others > 0 else 0.0,
            float(np.log1p(changes[ball])),
        )
        premises.append(BallPremise(estimate_premise_probability(evidence), tuple(evidence.vector.tolist())))
    return premises
