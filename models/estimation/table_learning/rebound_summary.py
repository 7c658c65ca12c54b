"""Rebounds of rolling balls from a learned cushion, and a short formula of its restitution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.table_learning.learned_table import LearnedTable
from models.physics.billiards.ball_cushion.rebound_correction import correct_rebound
from models.physics.billiards.simulation.contact_resolution import rebound_with_slip

SPEEDS, ANGLES, SPINS = (0.3, 0.6, 1.2, 2.4, 4.0), (0.0, 20.0, 40.0, 60.0), (-0.5, 0.0, 0.5)
"""m/s, degrees from the normal, and surface speed of side spin over the speed: what balls on a table do."""


@dataclass(frozen=True, slots=True)
class RestitutionFormula:
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
        table: The table.
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


def fit_restitution_formula(table: LearnedTable, radius: float, mass: float) -> RestitutionFormula:
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
    return RestitutionFormula(float(np.exp(intercept)), -float(slope), float(np.sqrt(np.mean(misfit**2))))
