"""Learn the physics of one table from the joint fits of its shots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.errors import TrackError
from models.core.fit_result import Parameter
from models.core.joint_solution import JointSolution, layout_parameters
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_arrays import NOSE_COLUMN
from models.estimation.table_learning.cloth_learning import fit_cloth
from models.estimation.table_learning.cushion_contacts import extract_cushion_contacts, join_contacts
from models.estimation.table_learning.cushion_learning import MIN_NOSE_SIGMA, learn_cushions, refit_scatter
from models.estimation.table_learning.learned_table import LearnedTable
from models.numerics.executor import SERIAL, Executor
from models.physics.billiards.ball_cushion.cushion_models import CUSHION_MODELS
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.tables import NOSE_SIGMA

MIN_CONTACTS = 8
"""Cushion contacts from which a table can be learned."""
_SPREADS = 9
"""Tried spreads of nose offsets up to their prior; neighbours differ by a fifth."""


@dataclass(frozen=True, slots=True)
class TableLesson:
    """A learned table with what it was learned from."""

    table: LearnedTable
    parameters: tuple[Parameter, ...]
    """Of cloth and cushions, with standard deviations."""
    candidates: tuple[tuple[str, float], ...]
    """Cushion models with their log evidence, the best first."""
    contact_count: int
    correction_gain: float | None
    """Share of the squared deviation of reporting shots that a network removes; None with too few contacts for one. It
    is switched on at `correction_training.MIN_GAIN` or more."""
    cloth_covariance: FloatArray
    """(P, P) of the first P parameters, those of the cloth."""


def learn_table(
    shots: list[tuple[JointSolution, Tracks]],
    table: Table,
    laws: tuple[str, ...] = CUSHION_MODELS,
    executor: Executor = SERIAL,
) -> TableLesson:
    """Learn a table from shots.

    Args:
        shots: Joint fit with covariance, and tracks with realistic sigmas, of each shot.
        table: Dimensions of the table.
        laws: Cushion models to compare.
        executor: Distributes work over processes.

    Returns:
        The table, and the evidence for it.

    Raises:
        TrackError: The shots have fewer than `MIN_CONTACTS` cushion contacts, or no free path.
    """
    contacts = join_contacts(extract_cushion_contacts(solution, table, k)[0] for k, (solution, _) in enumerate(shots))
    if len(contacts.t) < MIN_CONTACTS:
        raise TrackError(
            f"{len(contacts.t)} cushion contacts are too few to learn a table from; at least {MIN_CONTACTS} are needed"
        )
    cloth, cloth_covariance = fit_cloth(shots, table, executor)
    if not cloth:
        raise TrackError("no ball was observed long enough between contacts to learn the cloth")
    from models.estimation.table_learning.correction_training import train_correction  # torch is slow to import

    size = table.ball_radius, table.ball_mass
    fits = learn_cushions(contacts, *size, {p.name: p.value for p in cloth}, laws)
    trained = train_correction(contacts, CUSHION_MODELS.index(fits[0].law), fits[0].physics, *size, fits[0].scatter)
    is_corrected = trained is not None and trained.is_worthwhile
    correction = trained.weights if trained is not None and is_corrected else NO_CORRECTION
    best = refit_scatter(contacts, fits[0], correction, *size) if is_corrected else fits[0]
    noses, nose_covariance = combine_noses([solution for solution, _ in shots])
    learned = LearnedTable(
        best.law, best.physics_with_balls, best.scatter, noses, nose_covariance,
        best.indices, best.covariance, correction,
    )  # fmt: skip
    candidates = tuple((one.law, one.log_evidence) for one in fits)
    gain = None if trained is None else trained.gain
    parameters = *cloth, *best.parameters
    return TableLesson(learned, parameters, candidates, len(contacts.t), gain, cloth_covariance)


def combine_noses(solutions: list[JointSolution]) -> tuple[FloatArray, FloatArray]:
    """Combine the nose offsets of shots, weighted by their covariance.

    A shot contains the prior of the joint fit, `NOSE_SIGMA`, which is taken out and counted once: a nose that no shot
    touched keeps it. Offsets differ between shots by calibration; the spread, at least `MIN_NOSE_SIGMA`, has the
    greatest marginal likelihood.

    Args:
        solutions: Joint fit with covariance of each shot.

    Returns:
        Mean (4,) m, and covariance (4, 4) m^2 of the offsets in one more shot.
    """
    prior, informations, vectors = np.eye(4) / NOSE_SIGMA**2, [], []
    for one in solutions:
        first = layout_parameters(one.graph).shared + NOSE_COLUMN
        precision = np.linalg.inv(one.covariance[first : first + 4, first : first + 4])
        values, directions = np.linalg.eigh(precision - prior)
        informations.append((directions * np.maximum(values, 0.0)) @ directions.T)
        vectors.append(precision @ one.nose_offsets)
    information, vector = np.array(informations), np.array(vectors)

    def combine(spread: float) -> tuple[float, FloatArray, FloatArray]:
        """Return log likelihood of a spread (m), and mean and covariance of the common offsets."""
        inflated = np.eye(4) + spread**2 * information
        total = prior + np.linalg.solve(inflated, information).sum(axis=0)
        weighted = np.linalg.solve(inflated, vector[..., None])[..., 0]
        mean = np.linalg.solve(total, weighted.sum(axis=0))
        explained = spread**2 * float(np.sum(vector * weighted)) + float(mean @ total @ mean)
        determinants = np.linalg.slogdet(inflated)[1].sum() + np.linalg.slogdet(total)[1]
        return 0.5 * (explained - float(determinants)), mean, np.linalg.inv(total)

    spread = max(np.geomspace(MIN_NOSE_SIGMA, NOSE_SIGMA, _SPREADS), key=lambda one: combine(one)[0])
    _, mean, covariance = combine(float(spread))
    return mean, covariance + spread**2 * np.eye(4)
