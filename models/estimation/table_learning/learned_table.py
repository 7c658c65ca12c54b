"""What many shots taught about one table: cloth, cushion model, scatter, and where its noses lie."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.table_learning.cushion_contacts import CushionContacts, SpinHistory, SpinLink
from models.estimation.table_learning.side_spin import (
    GRID_REACH_AT_REST,
    GRID_SIZE,
    ContactScatter,
    brake_spin,
    filter_side_spin,
    predict_rebounds,
)
from models.physics.billiards.ball_cushion.cushion_models import CUSHION_MODELS
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.parameter_vector import PARAMETER_NAMES, SPIN_DECAY
from models.physics.effects.catalogue import find_prior

CLOTH_SPREAD = 0.05
"""Standard deviation of ln friction from one shot to the next: cloth, dust and direction (measured on 91 recorded
three-cushion shots: 0.05 of sliding friction)."""
_WIDE_REACH = 3.0
"""Prior standard deviations that the grid of a spin without any contact covers."""


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


@dataclass(frozen=True, slots=True)
class SpinDistribution:
    """Distribution of the surface speed of side spin of one ball."""

    grid: FloatArray
    """(G,) m/s, even."""
    probability: FloatArray
    """(G,)"""

    @property
    def mean(self) -> float:
        """m/s."""
        return float(self.grid @ self.probability)

    @property
    def sigma(self) -> float:
        """m/s."""
        return float(np.sqrt(self.probability @ (self.grid - self.mean) ** 2))

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw values (count,) m/s, evenly within a step of the grid."""
        chosen = rng.choice(len(self.grid), count, p=self.probability / self.probability.sum())
        step = self.grid[1] - self.grid[0]
        return np.asarray(self.grid[chosen] + step * (rng.random(count) - 0.5))


def infer_side_spins(
    contacts: CushionContacts, histories: tuple[SpinHistory, ...], since: dict[int, float], table: LearnedTable,
    radius: float, mass: float,
) -> dict[int, SpinDistribution]:  # fmt: skip
    """Infer the side spin of every moving ball from all cushion contacts of its shot.

    Args:
        contacts: Cushion contacts of the shot.
        histories: What happened to each moving ball since its last one.
        since: By ball, s since its last segment began.
        table: The table.
        radius: m, of the balls.
        mass: kg, of the balls.

    Returns:
        The distribution by ball.
    """
    decay = float(table.physics[SPIN_DECAY])
    rebounds = predict_rebounds(contacts, table.law_code, table.physics, radius, mass, table.correction)
    filtered = filter_side_spin(contacts, rebounds, radius, table.scatter, decay)
    spins = {}
    for history in histories:
        link = history.link._replace(elapsed=history.link.elapsed + since[history.ball])
        if history.contact < 0:
            grid, start = _spread_prior(link)
            blur = 0.0
        else:
            grid, start, blur = filtered.grid[history.contact], filtered.after[history.contact], link.sigma
        loss = decay * radius * link.elapsed
        spins[history.ball] = SpinDistribution(grid, brake_spin(grid, start, loss, blur))
    return spins


def _spread_prior(link: SpinLink) -> tuple[FloatArray, FloatArray]:
    """Return a grid (G,) and the normal prior of a spin at the start of its chain on it."""
    reach = _WIDE_REACH * link.sigma + GRID_REACH_AT_REST
    grid = np.linspace(-reach, reach, GRID_SIZE)
    weight = np.exp(-0.5 * (grid / link.sigma) ** 2)
    return grid, weight / weight.sum()
