"""Result of the fit of a shot: events, trajectory, parameters, explanation, numbers for players, and trust level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.naming import Naming
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray

# What changes the velocity of a ball. `unexplained`: something that no other cause explains; `none`: nothing, the
# velocity did not change.
Cause = Literal["strike", "ball", "cushion", "pocket", "rest", "unexplained", "none"]
# Why a moment is unsure: not detected around it; moved far between two frames; too few samples before or after; at the
# start or end of the clip; another ball could have been it; a pass that may have been a graze; no cause was found.
Doubt = Literal["hidden", "fast", "few_samples", "clip_edge", "rival", "close_pass", "no_cause"]


# Probability from which a cause is decided; below `MIN_LISTED_PROBABILITY` it is ruled out.
SURE_PROBABILITY = 0.9
# Shares of the moving time that accepted fits must explain.
GREEN_SHARE, AMBER_SHARE = 0.9, 0.6
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
    """Evidence that the probability follows from, in the order of `event_probability.PREMISE_EVIDENCE_NAMES`."""


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


# State of the cue ball when it reaches the first ball: spinning backwards, without spin about its horizontal axis,
# turning forwards but still sliding, rolling.
SpinState = Literal["draw", "stun", "follow", "roll", "unknown"]
# All states but `unknown`, in the order of the spin.
SPIN_STATES: tuple[SpinState, ...] = ("draw", "stun", "follow", "roll")

# s between a strike and the start of a shot or of its fit as a whole, at most.
SAME_STRIKE = 0.1


@dataclass(frozen=True, slots=True)
class ShotNumber:
    """One number of a shot."""

    name: str
    """Name, such as `cue_speed`; docs/how-to/numbers-for-players.md defines all."""
    value: float
    """In `unit`; NaN where the data contain nothing about it."""
    sigma: float
    """Standard deviation of `value`, in `unit`."""
    unit: str
    """Unit symbol; empty for shares and counts."""
    observable: bool
    """Whether the data determine the number: what is not observable repeats a prior assumption."""
    ball: str = ""
    """Id of the ball that it belongs to."""
    place: str = ""
    """Pocket that it belongs to; empty where there is none."""


@dataclass(frozen=True, slots=True)
class ShotNumbers:
    """Numbers of one shot, from its strike to the next."""

    t: float
    """s, presentation time of the strike; of the first frame where the clip begins later."""
    cue: str
    """Id of the struck ball."""
    first: str
    """Id of the ball that it hits first; empty if it hits none."""
    spin_state: SpinState
    """The most probable state of the cue ball at that contact; `unknown` where it is not observable."""
    spin_state_probabilities: tuple[float, ...]
    """(4,) of `SPIN_STATES`; empty if there is no contact."""
    potted: tuple[str, ...]
    """Ids of the balls that were potted."""
    pockets: tuple[str, ...]
    """Pocket of each of them."""
    numbers: tuple[ShotNumber, ...]

    def find_number(self, name: str, ball: str = "") -> ShotNumber | None:
        """Return the number with a name, of a ball where several balls have one; None if there is none."""
        return next((one for one in self.numbers if one.name == name and ball in ("", one.ball)), None)


TrustLevel = Literal["green", "amber", "red"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A fitted parameter of the physics."""

    name: str
    """`effect.parameter`, e.g. `rolling_resistance.mu`."""
    value: float
    """Estimate, in `unit`."""
    sigma: float
    """Standard deviation of `value`, in `unit`."""
    unit: str
    """Unit symbol; empty for dimensionless parameters."""
    prior_only: bool
    """Whether the data do not identify the parameter, so that value and sigma are those of the prior."""


@dataclass(frozen=True, slots=True)
class Trust:
    """Trust level of the result of a clip, with the reasons for it."""

    level: TrustLevel
    """`green`: an accepted fit explains the motion; `amber`: it explains most of the motion, or there is a warning;
    `red`: the estimates must not be used."""
    reasons: tuple[str, ...]
    """Sentences for the user."""


@dataclass(frozen=True, slots=True)
class WholeShotSolution:
    """Result of a fit of whole shots: the selected contact models, their parameters, and the state after the strike.

    N counts the balls that moved.
    """

    cushion_model: str
    """Name of the selected contact model of ball and cushion."""
    ball_model: str
    """Name of the selected contact model of two balls."""
    chi2_per_dof: float
    """Robust chi-square per degree of freedom of all observed positions of these balls."""
    parameters: tuple[Parameter, ...]
    """Parameters of the effects, of the contact models and of the table."""
    t: float
    """s, time of `state`: just after the first strike."""
    ids: tuple[str, ...]
    """(N,) ids of the balls."""
    state: FloatArray
    """(N, 7) state of the balls: x, y (m), vx, vy (m/s), wx, wy, wz (rad/s)."""
    covariance: FloatArray
    """(N, 7, 7) covariance of `state` for each ball, SI units."""
    moving: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, bool))
    """(N,) whether a ball moves at `t`."""
    start_samples: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """(M, S) posterior samples of the starts of all balls, as in `parametrised_shot`."""
    parameter_samples: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """(M, Q) parameters of each sample, in the order of `parametrised_shot.SHOT_PARAMETERS`."""
    sample_ball_models: tuple[str, ...] = ()
    """(M,) contact model of two balls of each sample."""
    equal_models: tuple[str, ...] = ()
    """Contact models of ball and cushion that explain the shots as well: the evidence does not decide between them."""


@dataclass(frozen=True, slots=True)
class WholeShotMisfit:
    """Where the published contact model that explains most of a shot stops to explain it."""

    cushion_model: str
    """Name of the contact model of ball and cushion."""
    ball_model: str
    """Name of the contact model of two balls."""
    explained_until: float
    """s, end of the part of the shot that the model explains; `t` at the latest."""
    ball: str
    """Id of the ball whose positions deviate."""
    contact: str
    """Kind of the first contact of this ball that the model does not explain, as in `Events.kind`; empty if none."""
    other: str
    """The other ball, or the cushion, of this contact."""
    t: float
    """s, time of this contact; NaN if there is none."""
    deviation: float
    """m, RMS distance of observed positions of the ball from the best fit, from the contact to the end of the view."""
    times_noise: float
    """The same deviation over the standard deviation of the measurement noise, per axis."""
    whole_times_noise: float
    """RMS deviation of the whole shot over the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class WholeShotFit:
    """What published contact models make of whole shots; one of the fields says it."""

    solution: WholeShotSolution | None = None
    """The models that explain them."""
    misfit: WholeShotMisfit | None = None
    """Where the best models fail."""
    refusal: str = ""
    """Sentence on why nothing was fitted."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Views of a shot with T frames and N balls."""

    events: Events
    """Strikes, contacts, pocketed balls and rests."""
    trajectory: Trajectory
    """Motion of every ball between and within frames."""
    parameters: tuple[Parameter, ...]
    """Parameters that were fitted to the segments between contacts."""
    noise: float
    """m, standard deviation of measured positions of moving balls per axis, estimated robustly from the residuals."""
    chi2_per_dof: float
    """Chi-square per degree of freedom of the same positions, relative to their assumed errors."""
    residual: FloatArray
    """(T, N, 2) m, measured minus fitted position; NaN where a ball was not observed."""
    moving: NDArray[np.bool_]
    """(T, N) whether a ball moves."""
    accepted: NDArray[np.bool_]
    """(T, N) whether an accepted fit explains the motion."""
    trust: Trust
    """Trust level, with reasons."""
    explanation: ShotExplanation = field(default_factory=ShotExplanation)
    """What may have happened at each moment, with the weight of every hypothesis."""
    mark_outcomes: tuple[MarkOutcome, ...] = ()
    """What the motion says about the contacts that were set by hand."""
    chi2_range: tuple[float, float] = (0.0, np.inf)
    """Values of `chi2_per_dof` that agree with the assumed errors."""
    laws: WholeShotFit | None = None
    """What published contact models make of whole shots; None if nobody asked."""
    profile_misfits: tuple[str, ...] = ()
    """Why the physics of the table profile was not used; empty if it fits, or none was given."""
    shot_numbers: tuple[ShotNumbers, ...] = ()
    """Numbers of each shot for players and coaches; empty where physics could not be fitted."""
    naming: Naming = field(default_factory=Naming)
    """What balls, rails and pockets are called."""

    @property
    def whole_shot(self) -> WholeShotSolution | None:
        """The contact models that explain whole shots; None if none was asked for, or found."""
        return None if self.laws is None else self.laws.solution
