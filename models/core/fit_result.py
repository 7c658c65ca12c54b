"""What a fit found: events, motion, parameters, and whether to believe it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray

Light = Literal["green", "amber", "red"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One fitted number of the physics, such as `rolling_resistance.mu`."""

    name: str
    value: float
    sigma: float
    unit: str
    prior_only: bool
    """True where the data did not determine it: value and sigma are the prior's."""


@dataclass(frozen=True, slots=True)
class Trust:
    """The traffic light of a clip, and the sentences that say why."""

    light: Light
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Laws:
    """By which published laws balls and cushions touched in a fit of whole shots, and how well these told of it.

    N balls, those that moved.
    """

    cushion: str
    ball: str
    chi2_per_dof: float
    """robust, of all that was seen of these balls."""
    parameters: tuple[Parameter, ...]
    t: float
    """s, when the balls were in these states: just after the first strike."""
    ids: tuple[str, ...]
    state: FloatArray
    """(N, 7) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s)."""
    covariance: FloatArray
    """(N, 7, 7)"""


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted shot."""

    events: Events
    trajectory: Trajectory
    parameters: tuple[Parameter, ...]
    noise: float
    """m, one standard deviation per axis of the measured positions, as the residuals say (robust)."""
    chi2_per_dof: float
    """of the accepted pieces, against the noise that successive samples show by themselves."""
    residual: FloatArray
    """(T, N, 2) m, measured minus fitted; NaN where not seen."""
    moving: NDArray[np.bool_]
    """(T, N) ball in motion."""
    accepted: NDArray[np.bool_]
    """(T, N) an accepted fit holds there."""
    trust: Trust
    laws: Laws | None = None
    """of the whole shots; None where no law explains them."""
    lawless: str = ""
    """why there are none, a sentence."""
