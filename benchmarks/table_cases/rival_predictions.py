"""Rivals of a learned table with its network: other tables, and a network without physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.table_learning.cushion_contacts import CushionContacts
from models.estimation.table_learning.cushion_learning import CushionFit, refit_scatter
from models.estimation.table_learning.learned_table import DEFAULT_SCATTER, LearnedTable
from models.neural.common.method_interface import MIN_SAMPLES, TrainingBudget
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.parameter_vector import PARAMETER_NAMES, neutral_parameters
from models.physics.effects.billiards_catalogue import find_prior
from pipeline.io.table_profile import NEUTRAL_BY_DEFAULT

# s before the cut, at most, on which a network without physics is trained: a contact would be a kink in its motion.
NETWORK_HISTORY = 1.0


def remove_network(learned: LearnedTable, contacts: CushionContacts, radius: float, mass: float) -> LearnedTable:
    """Return the best published model with the parameters that the shots taught, and the scatter about it alone."""
    if not len(learned.correction):
        return learned
    fit = CushionFit(learned.cushion_law, (), learned.scatter, learned.physics, learned.covariance, 0.0)
    scatter = refit_scatter(contacts, fit, NO_CORRECTION, radius, mass).scatter
    return replace(learned, correction=NO_CORRECTION, scatter=scatter)


def use_catalogue(learned: LearnedTable) -> LearnedTable:
    """Return the best published model with the values of the catalogue; cloth and noses stay as learned."""
    physics, neutral = learned.physics.copy(), neutral_parameters()
    for k in learned.uncertain:
        name = PARAMETER_NAMES[k]
        physics[k] = neutral[k] if name in NEUTRAL_BY_DEFAULT else find_prior(*name.split(".")).value
    return replace(
        learned, physics=physics, scatter=DEFAULT_SCATTER, uncertain=np.empty(0, np.int64), covariance=np.empty((0, 0)),
        correction=NO_CORRECTION,
    )  # fmt: skip


def extrapolate_by_network(
    tracks: Tracks, ball: int, since: float, at: float, ahead: tuple[float, ...], seconds: float
) -> FloatArray:
    """Train dv/dt = net(x, v) on a ball's last places before the cut, and extrapolate as the thesis does.

    Args:
        ball: Index of the ball.
        since: s, its last contact before the cut.
        at: s, the cut.
        ahead: Horizons (K), s.
        seconds: CPU time of the training.

    Returns:
        (K, 2) m; NaN with too few samples, or where the motion diverges.
    """
    from models.neural.networks.neural_flow import SECOND_ORDER

    begin = max(since, at - NETWORK_HISTORY)
    rows = np.flatnonzero(tracks.is_observed[:, ball] & (tracks.t > begin) & (tracks.t <= at + 1e-9))
    if len(rows) < 2 * MIN_SAMPLES:
        return np.full((len(ahead), 2), np.nan)
    fitted = SECOND_ORDER.fit(tracks.t[rows], tracks.xy[rows, ball][:, None], 0, TrainingBudget(seconds=seconds))
    return fitted.at(at + np.array(ahead))[:, 0]
