"""Probability of an event from its evidence: a logistic model, learned on shots of another engine.

No probability is set by hand. `benchmarks/calibrate_events.py` simulates shots, damages their detections, and fits the
coefficients to what was true; its seeds are none of the stress test's. A probability is never nearer to 0 or 1 than the
number of such shots allows.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from scipy.special import expit

from models.core.shot import ContactTestResult
from models.core.shot_explanation import CauseHypothesis
from models.core.typing import FloatArray
from models.estimation.shot_hypotheses.event_evidence import EVIDENCE_NAMES, EventEvidence

MAX_LOG_ODDS = 7.0
"""Limit of the logarithm of the odds of the contact test: its windows hold no more evidence about real balls."""
CATEGORIES = (
    "strike", "object_strike", "ball", "passing", "cushion", "fall", "vanish", "rest", "rival", "close_pass",
)  # fmt: skip
"""What an event is concluded from: a strike of the cue ball; of another ball; a fitted contact of two balls; a ball
that turns beside another one; a cushion; a path that leads into a pocket; a ball that vanishes in the jaws; a rest; a
rival of the best explanation; two paths that pass closely."""
COEFFICIENTS = "event_coefficients.json"


@dataclass(frozen=True, slots=True)
class EventModel:
    """Coefficients of the logistic model."""

    bias: dict[str, float]
    """By category."""
    weight: FloatArray
    """Of the evidence, in the order of `EVIDENCE_NAMES`."""
    count: dict[str, float]
    """Events of each category that the model was fitted to."""
    unlisted_contact: dict[str, float]
    """Share of pairs of balls that touched although no contact of them is listed, by class of the pair, see
    `models.estimation.contact_test.call_answers`."""


@cache
def read_event_model() -> EventModel:
    """Read the coefficients that belong to the program."""
    content = json.loads(files(__package__).joinpath(COEFFICIENTS).read_text(encoding="utf-8"))
    return EventModel(
        content["bias"],
        np.array([content["weight"][name] for name in EVIDENCE_NAMES]),
        content["count"],
        content["unlisted_contact"],
    )


def estimate_event_probability(category: str, evidence: EventEvidence) -> float:
    """Estimate the probability of an event.

    Args:
        category: One of `CATEGORIES`.
        evidence: Evidence on the event.

    Returns:
        The probability, limited by Laplace's rule of succession for events of this category.
    """
    model = read_event_model()
    p = float(expit(model.bias[category] + model.weight @ evidence.vector))
    limit = 1 / (model.count[category] + 2)
    return float(np.clip(p, limit, 1 - limit))


def weigh_close_pass(other: str, result: ContactTestResult) -> tuple[tuple[CauseHypothesis, ...], float]:
    """Return the hypotheses of a close pass, the most probable first, and the probability of a contact."""
    odds = np.log(max(result.probability, 1e-12)) - np.log(max(1 - result.probability, 1e-12))
    evidence = EventEvidence(test=float(np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS)))
    p = estimate_event_probability("close_pass", evidence)
    contact = CauseHypothesis("ball", other, p, "close_pass", tuple(evidence.vector.tolist()))
    return tuple(sorted((contact, CauseHypothesis("none", "", 1 - p)), key=lambda entry: -entry.probability)), p
