"""What many shots taught about one table: cloth, cushion model, scatter, and where its noses lie.

Rebounds of rolling balls from its cushions have a short formula of the restitution.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION, correct_rebound
from models.physics.billiards.contact_models import CUSHION_MODELS
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.billiards.simulation.contact_resolution import rebound_with_slip
from models.physics.effects.billiards_catalogue import find_prior

# Standard deviation of ln friction from one shot to the next: cloth, dust and direction (measured on 91 recorded
# three-cushion shots: 0.05 of sliding friction).
CLOTH_SPREAD = 0.05
# Of the logarithm of rolling friction: one number for all speeds of a shot.
ROLLING_MODEL_SIGMA = 0.1
# Of Student's t distribution of deviations from the contact model: a few contacts are cut wrongly.
DEGREES_OF_FREEDOM = 4.0


@dataclass(frozen=True, slots=True)
class ContactScatter:
    """Standard deviations of what follows a cushion contact, per component, as shares of the speed before it."""

    velocity: float
    slip: float
    side_spin: float

    @property
    def shares(self) -> FloatArray:
        """(5,) of velocity along n and t, slip along n and t, and surface speed of side spin."""
        return np.array([self.velocity, self.velocity, self.slip, self.slip, self.side_spin])

    def draw(self, rng: np.random.Generator, size: tuple[int, ...]) -> FloatArray:
        """Draw deviations (*size, 5), shares of the speed, from Student's t distribution."""
        tails = np.sqrt((DEGREES_OF_FREEDOM - 2) / rng.chisquare(DEGREES_OF_FREEDOM, (*size, 1)))
        return np.asarray(tails * rng.standard_normal((*size, len(self.shares))) * self.shares)


# Scatter on tables that no shot has taught: the differences of published models.
DEFAULT_SCATTER = ContactScatter(0.05, 0.12, 0.12)


@dataclass(frozen=True, slots=True)
class LearnedTable:
    """Physics of one table with the uncertainty that predictions need."""

    cushion_law: str
    physics: FloatArray
    """(P,) parameters of the engine."""
    scatter: ContactScatter
    noses: FloatArray
    """(4,) m, mean offset of each contact line towards the table, as in the joint fit."""
    nose_covariance: FloatArray
    """(4, 4) m^2, of the offsets in one more shot."""
    uncertain: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    """(M,) indices of the parameters of `physics` that are drawn anew for every ensemble member, and their covariance
    (M, M)."""
    covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    correction: FloatArray = field(default_factory=NO_CORRECTION.copy)
    """Weights of `rebound_correction`; empty where no correction is switched on."""

    def draw_physics(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw values (count, M) of the uncertain parameters, within their bounds."""
        if not len(self.uncertain):
            return np.empty((count, 0))
        values, vectors = np.linalg.eigh(self.covariance)
        drawn = rng.standard_normal((count, len(values))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        bounds = [find_prior(*PARAMETER_NAMES[k].split(".")).bounds for k in self.uncertain]
        low, high = np.transpose(bounds)
        return np.asarray(np.clip(self.physics[self.uncertain] + drawn, low, high))

    @property
    def nose_sigma(self) -> FloatArray:
        """(4,) m, of the offset of each nose in one more shot."""
        return np.asarray(np.sqrt(np.diag(self.nose_covariance)))

    @property
    def law_code(self) -> int:
        """Index of the cushion model in `CUSHION_MODELS`."""
        return CUSHION_MODELS.index(self.cushion_law)


# m/s, degrees from the normal, and surface speed of side spin over the speed: what balls on a table do.
SPEEDS, ANGLES, SPINS = (0.3, 0.6, 1.2, 2.4, 4.0), (0.0, 20.0, 40.0, 60.0), (-0.5, 0.0, 0.5)


@dataclass(frozen=True, slots=True)
class _RestitutionFormula:
    """Restitution `factor` vn^-`power`, for the speed into the cushion in m/s."""

    factor: float
    power: float
    misfit: float
    """RMS error of the normal velocity after rebounds of rolling balls, as a share of the speed before."""


def rebound_rolling_balls(
    table: LearnedTable, speed: FloatArray, degrees: FloatArray, spin: FloatArray, radius: float, mass: float
) -> FloatArray:
    """Let rolling balls meet a learned cushion.

    Args:
        speed: (K,) m/s.
        degrees: (K,) angle of incidence from the normal.
        spin: (K,) surface speed of side spin over the speed.
        radius: m, of the balls.
        mass: kg, of the balls.

    Returns:
        (K, 5) velocity along n (into the cushion) and t, slip along n and t, surface speed of side spin, m/s.
    """
    angle, zero = np.radians(degrees), np.zeros_like(speed)
    before = np.stack([speed * np.cos(angle), speed * np.sin(angle), zero, zero, speed * spin], axis=1)
    after = np.empty_like(before)
    for one, left in zip(before, after, strict=True):
        rebound_with_slip(table.law_code, one, radius, mass, table.physics, left)
        correct_rebound(table.correction, one, left)
    return after


def fit_restitution_formula(table: LearnedTable, radius: float, mass: float) -> _RestitutionFormula:
    """Fit a power law of the speed into the cushion to the restitution of a learned table.

    Args:
        table: The table, with its correction.
        radius: m, of the balls.
        mass: kg, of the balls.

    Returns:
        The formula and its error over `SPEEDS`, `ANGLES` and `SPINS`.
    """
    speed, degrees, spin = (grid.ravel() for grid in np.meshgrid(SPEEDS, ANGLES, SPINS))
    into = speed * np.cos(np.radians(degrees))
    left = -rebound_rolling_balls(table, speed, degrees, spin, radius, mass)[:, 0]
    slope, intercept = np.polyfit(np.log(into), np.log(left / into), 1, w=into / speed)
    misfit = (left - np.exp(intercept) * into ** (1 + slope)) / speed
    return _RestitutionFormula(float(np.exp(intercept)), -float(slope), float(np.sqrt(np.mean(misfit**2))))
