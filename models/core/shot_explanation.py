"""Explanation of a shot: what may have happened at each moment, with the weight of every hypothesis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from models.core.typing import FloatArray

# What changes the velocity of a ball. `unexplained`: something that no other cause explains; `none`: nothing, the
# velocity did not change.
Cause = Literal["strike", "ball", "cushion", "pocket", "rest", "unexplained", "none"]
# Why a moment is unsure: not detected around it; moved far between two frames; too few samples before or after; at the
# start or end of the clip; another ball could have been it; a pass that may have been a graze; no cause was found.
Doubt = Literal["hidden", "fast", "few_samples", "clip_edge", "rival", "close_pass", "no_cause"]


# Probability from which a cause is decided; below `MIN_LISTED_PROBABILITY` it is ruled out.
SURE_PROBABILITY = 0.9
# Least probability of a listed event; below, it is a hypothesis of the explanation only.
MIN_LISTED_PROBABILITY = 0.1


def is_undecided(probability: float) -> bool:
    """Return whether a probability decides nothing: 0.1 to 0.9."""
    return MIN_LISTED_PROBABILITY <= probability < SURE_PROBABILITY


# What the fit makes of a mark: the motion agrees; it shows no change at a marked contact; it changes where a contact
# was deleted; it puts the contact at another time; the balls, or ball and cushion, are too far apart; a ball that the
# mark names is not tracked there.
MarkOutcomeCode = Literal["confirmed", "no_change", "change_remains", "other_time", "too_far", "ball_missing"]


@dataclass(frozen=True, slots=True)
class CauseHypothesis:
    """One possible cause."""

    cause: Cause
    other: str
    """The other ball, the cushion or the pocket; empty where there is none."""
    probability: float
    category: str = ""
    """What it is concluded from, see `models.estimation.shot_hypotheses.event_probability`."""
    evidence: tuple[float, ...] = ()
    """Evidence that the probability follows from, in the order of `event_probability.EVIDENCE_NAMES`."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment at which the velocity of a ball changes, or may have changed."""

    ball: str
    t: float
    t_sigma: float
    """s."""
    xy: FloatArray
    """(2,) m, place of the ball."""
    hypotheses: tuple[CauseHypothesis, ...]
    """The most probable first; their probabilities add to 1."""
    doubts: tuple[Doubt, ...] = ()

    @property
    def best(self) -> CauseHypothesis:
        """The most probable hypothesis."""
        return self.hypotheses[0]


@dataclass(frozen=True, slots=True)
class RackBreak:
    """A rack, or another cluster of balls in contact, that a ball bursts."""

    rest: float
    start: float
    t: float
    end: float
    """s: since when the rack rests, since when that ball comes in on one path, when it meets the rack, and until when
    contacts follow each other faster than frames, and no simulation explains them."""
    ball: str
    rack: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class BallPremise:
    """What all statements about a ball rest on: its track is one ball, and its motion is that of balls on the table."""

    probability: float
    """Probability that it holds."""
    evidence: tuple[float, ...] = ()
    """Evidence that the probability follows from, in the order of `event_premises.PREMISE_EVIDENCE_NAMES`."""


@dataclass(frozen=True, slots=True)
class ShotExplanation:
    """All moments of a shot, sorted by time."""

    moments: tuple[Moment, ...] = ()
    moving_at_start: tuple[str, ...] = ()
    """Balls that move when they are first detected: what set them in motion, or what they met before, is not known."""
    breaks: tuple[RackBreak, ...] = ()
    premises: Mapping[str, BallPremise] = field(default_factory=dict)
    """By ball; nothing speaks against those that are missing."""

    def premise_probability(self, *balls: str) -> float:
        """Return the probability of the weakest premise of some balls: what makes several fail is mostly common."""
        return min((self.premises[ball].probability for ball in balls if ball in self.premises), default=1.0)

    def is_within_rack(self, t: float, *balls: str) -> bool:
        """Return whether only balls of a rack take part in a contact at t, s, while it rests or bursts."""
        return any(one.rest < t < one.end and {*balls} <= {*one.rack} for one in self.breaks)

    def is_due_to_break(self, t: float, ball: str) -> bool:
        """Return whether a break is the cause of all that a ball does at t, s."""
        comes_in = any(one.start < t < one.end and one.ball == ball for one in self.breaks)
        return comes_in or self.is_within_rack(t, ball)

    def contacts_of(self, ball: str, other: str) -> list[tuple[Moment, float]]:
        """Return the moments at which two balls may have touched, with the probability of that."""
        contacts = []
        for moment in self.moments:
            names = {one.other: one.probability for one in moment.hypotheses if one.cause == "ball"}
            p = names.get(other, 0.0) if moment.ball == ball else names.get(ball, 0.0) if moment.ball == other else 0.0
            if p > 0:
                contacts.append((moment, p))
        return contacts


@dataclass(frozen=True, slots=True)
class MarkOutcome:
    """What the fitted motion says about a contact that was set by hand."""

    kind: str
    """Of the correction: mark, move or delete."""
    code: MarkOutcomeCode
    balls: tuple[str, ...]
    """Ids of the balls; as in the corrections where they are not tracked."""
    cushion: str
    t: float
    """s, time that was set by hand."""
    value: float = float("nan")
    """chi2 that the contact gains of `confirmed` and `no_change`, or that its removal costs of `change_remains`; fitted
    minus set time of `other_time`, s; distance of the surfaces of `too_far`, m."""
