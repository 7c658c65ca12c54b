"""Probability of an event from its evidence: a logistic model, learned on shots of another engine.

No probability is set by hand, with one exception: the odds of contacts that a person marked or deleted are then
multiplied or divided by `HAND_ODDS` (`models.estimation.hand_marks.resolved_marks.weigh_marks`).
`benchmarks/calibrate_events.py` simulates shots, damages their detections, and fits the coefficients to what was true;
its seeds are none of the stress test's. A learned probability is never nearer to 0 or 1 than the number of such shots
allows.

Evidence for and against an event is numbers that the fit of the shot yields, without any judgement.

All of it rests on premises: the track of a ball is one ball, and its motion is that of balls on this table. An event
happened if its premises hold and it happened given that, so that its probability is the product of both. The evidence
against premises is what the trust level of the clip knows. Its weights are fitted to the same shots, to which objects
were added that are no balls, and whose calibration was falsified.
"""

from __future__ import annotations

import json
from dataclasses import astuple, dataclass, fields
from functools import cache
from importlib.resources import files

import numpy as np
from scipy.special import expit

from models.core.fit_result import BallPremise, CauseHypothesis
from models.core.shot import ContactTestResult
from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class EventRow:
    """One event, see `models.core.events.Events`."""

    kind: str
    t: float
    t_sigma: float
    a: str
    b: str
    xy: FloatArray
    category: str
    """What it is concluded from, see `CATEGORIES`; empty for the contacts of a simulated break, whose probability is
    known."""
    contact: int = -1
    """Contact of the graph that it belongs to; -1 for none."""
    probability: float = np.nan
    """NaN until the evidence is weighed."""
    gap: float = np.nan
    gap_sigma: float = np.nan
    speed: float = np.nan


# chi2: scale on which gains are compressed; a contact needs about as much to be fitted at all.
GAIN_SCALE = 20.0
# m of overlap and m/s of closing speed beyond which a contact leaves no doubt by itself.
GRAZE_GAP, SLOW_SPEED = 1e-3, 0.1
# Frames from the start or the end of a clip within which the motion before or after is hardly observed.
EDGE_FRAMES = 2.0


@dataclass(frozen=True, slots=True)
class EventEvidence:
    """Evidence on one event; every value is 0 where there is nothing against it, or nothing is known."""

    gain: float = 0.0
    """Logarithm of the chi2 that the event improves over nothing, in units of `GAIN_SCALE`, plus 1."""
    misfit: float = 0.0
    """Logarithm of the chi2 per degree of freedom of the motion around it, at least 0."""
    apart: float = 0.0
    """As `gain`, of separate velocity changes over the contact of two balls: where the laws of contacts do not fit."""
    rival: float = 0.0
    """0 to 1: how well a contact with another ball fits instead; 1 if as well."""
    fit: float = 0.0
    """0 to 1, of a rival itself: how well it fits; 1 if as well as the best explanation."""
    hidden: float = 0.0
    """Logarithm of the missed frames of a ball around the event, plus 1."""
    travel: float = 0.0
    """Logarithm of the way of the fastest ball between two frames in ball radii, plus 1."""
    short: float = 0.0
    """Reciprocal of the number of samples of the shortest motion before or after, plus 1."""
    edge: float = 0.0
    """1 at the start or the end of the clip."""
    driven: float = 0.0
    """1 where another ball moves when a ball starts: no cue strikes meanwhile."""
    graze: float = 0.0
    """0 to 1: 1 where free paths only just overlap."""
    slow: float = 0.0
    """0 to 1: 1 where the bodies hardly approach each other."""
    test: float = 0.0
    """Logarithm of the odds of a contact by the contact test, compressed."""

    @property
    def vector(self) -> FloatArray:
        """Values in the order of `EVIDENCE_NAMES`."""
        return np.array(astuple(self))


EVIDENCE_NAMES = tuple(field.name for field in fields(EventEvidence))


def compress_gain(chi2: float) -> float:
    """Compress a difference of chi2: errors of a model are not normal, so that its tails count less."""
    return float(np.sign(chi2) * np.log1p(abs(chi2) / GAIN_SCALE))


def compress_rival(cost: float) -> float:
    """Convert the chi2 that a rival costs beyond the best explanation to 0 ... 1."""
    return float(1 / (1 + max(cost, 0.0) / GAIN_SCALE))


def count_missed_frames(times: FloatArray, t: float, interval: float) -> float:
    """Count the frames without a sample around a time.

    Args:
        times: (K,) times of the samples of a ball, s.
        t: s.
        interval: Frame interval, s.

    Returns:
        Missed frames between the samples before and after; infinite time before the first one counts none.
    """
    row = int(np.searchsorted(times, t))
    if not 0 < row < len(times):
        return 0.0
    return max(float(times[row] - times[row - 1]) / interval - 1.0, 0.0)


# Limit of the logarithm of the odds of the contact test: its windows hold no more evidence about real balls.
MAX_LOG_ODDS = 7.0
# What an event is concluded from: a strike of the cue ball; of another ball; a fitted contact of two balls; a ball that
# turns beside another one; a cushion; a path that leads into a pocket; a ball that vanishes in the jaws; a rest; a
# rival of the best explanation; two paths that pass closely.
CATEGORIES = (
    "strike", "object_strike", "ball", "passing", "cushion", "fall", "vanish", "rest", "rival", "close_pass",
)  # fmt: skip
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
    premise_bias: float
    """Logarithm of the odds of premises that nothing speaks against."""
    premise_weight: dict[str, float]
    """By evidence against premises; none is negative."""


@cache
def read_event_model() -> EventModel:
    """Read the coefficients that belong to the program."""
    content = json.loads(files(__package__).joinpath(COEFFICIENTS).read_text(encoding="utf-8"))
    return EventModel(
        content["bias"],
        np.array([content["weight"][name] for name in EVIDENCE_NAMES]),
        content["count"],
        content["unlisted_contact"],
        content["premises"]["bias"],
        content["premises"]["weight"],
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


def weigh_close_pass(
    other: str, result: ContactTestResult, premise: float
) -> tuple[tuple[CauseHypothesis, ...], float]:
    """Return the hypotheses of a close pass, the most probable first, and the probability of a contact.

    `premise` is the probability that the premises of its balls hold.
    """
    odds = np.log(max(result.probability, 1e-12)) - np.log(max(1 - result.probability, 1e-12))
    evidence = EventEvidence(test=float(np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS)))
    p = premise * estimate_event_probability("close_pass", evidence)
    contact = CauseHypothesis("ball", other, p, "close_pass", tuple(evidence.vector.tolist()))
    return tuple(sorted((contact, CauseHypothesis("none", "", 1 - p)), key=lambda entry: -entry.probability)), p


@dataclass(frozen=True, slots=True)
class PremiseEvidence:
    """Evidence against the premises of the events of a ball; every value is at least 0, and 0 where there is none."""

    own: float = 0.0
    """Share of the moving time of the ball that no accepted fit explains."""
    others: float = 0.0
    """The same share of all other balls together."""
    changes: float = 0.0
    """Logarithm of the sum of the sizes of velocity changes and jumps of the ball without a known cause, plus 1."""
    starts: float = 0.0
    """Logarithm of the number of times that the ball leaves a rest although neither a cue nor a ball touches it, plus
    1."""
    absence: float = 0.0
    """Share of the clip before the first and after the last detection of the ball, unless it was potted."""

    @property
    def vector(self) -> FloatArray:
        """Values in the order of `PREMISE_EVIDENCE_NAMES`."""
        return np.array(astuple(self))


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


def assess_premises(
    seconds: FloatArray, explained_seconds: FloatArray, changes: FloatArray, starts: FloatArray, absence: FloatArray
) -> list[BallPremise]:
    """Assess the premises of the events of each ball.

    Args:
        seconds: (N,) moving time of each ball, s.
        explained_seconds: (N,) the part of it that accepted fits explain, s.
        changes: (N,) sum of the sizes of its velocity changes and jumps without a known cause.
        starts: (N,) number of times that it leaves a rest without a known cause.
        absence: (N,) share of the clip before its first and after its last detection.

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
            float(np.log1p(starts[ball])),
            float(absence[ball]),
        )
        premises.append(BallPremise(estimate_premise_probability(evidence), tuple(evidence.vector.tolist())))
    return premises
