"""Result of the fit of a shot: events, trajectory, parameters, and trust level."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.naming import Naming
from models.core.shot_explanation import MarkOutcome, ShotExplanation
from models.core.shot_numbers import ShotNumbers
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray

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
