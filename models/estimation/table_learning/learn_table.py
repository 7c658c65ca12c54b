"""Learn the physics of one table from the joint fits of its shots.

The cloth (friction, drag, slope) is learned from free paths, whatever the contacts do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from models.core.contact_graph import ContactGraph, JointSolution, layout_parameters
from models.core.errors import TrackError
from models.core.fit_result import Parameter
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import evaluate_state
from models.estimation.joint_fit.fit_solution import NOSE_COLUMN
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions, fit_windows, summarize_parameters
from models.estimation.table_learning.cushion_contacts import extract_cushion_contacts, join_contacts
from models.estimation.table_learning.cushion_learning import MIN_NOSE_SIGMA, learn_cushions, refit_scatter
from models.estimation.table_learning.learned_table import LearnedTable
from models.estimation.whole_shot.shot_segments import ShotSegment
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.numerics.executor import SERIAL, Executor
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.contact_models import CUSHION_MODELS
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from models.physics.billiards.tables import NOSE_SIGMA
from models.physics.effect import Prior
from models.physics.effects.billiards_catalogue import find_prior

# Cushion contacts from which a table can be learned.
MIN_CONTACTS = 8
# Tried spreads of nose offsets up to their prior; neighbours differ by a fifth.
_SPREADS = 9


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
    fits = learn_cushions(contacts, *size, {p.name: p.value for p in cloth}, laws, executor)
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


# Parameters of the cloth that free paths determine.
CLOTH_EFFECTS = ("sliding_friction.mu", "rolling_resistance.mu", "viscous_drag.k", "slope.slope_x", "slope.slope_y")
# 1/s, at which a search begins: without drag a path has no derivative by it.
DRAG_GUESS = 0.005
# s before and after a contact that are left out at least.
CONTACT_MARGIN = 0.01
# Standard deviations of a contact's time that are left out.
CONTACT_SIGMAS = 4.0
# Observations of a path, and m/s at its start, from which it tells about the cloth.
MIN_PATH_ROWS, MIN_PATH_SPEED = 6, 0.05
_ITERATIONS = ShootingOptions(iterations=25)


def fit_cloth(
    shots: list[tuple[JointSolution, Tracks]], table: Table, executor: Executor = SERIAL
) -> tuple[tuple[Parameter, ...], FloatArray]:
    """Fit the cloth to the free paths of shots, with the covariance of its parameters.

    Args:
        shots: Joint fit and tracks, with realistic sigmas, of each shot.
        table: Dimensions of the table.
        executor: Distributes the paths over processes.

    Returns:
        The P parameters of `CLOTH_EFFECTS` and their covariance (P, P); both empty without a free path.
    """
    segments: list[ShotSegment] = []
    for solution, tracks in shots:
        segments += extract_free_segments(solution, tracks, len(segments))
    if not segments:
        return (), np.empty((0, 0))
    model = ShotWindows(tuple(segments), table, _cloth_priors(), ContactModels(), guess_spins=False)
    values = np.array([DRAG_GUESS if one.name == "viscous_drag.k" else one.value for one in model.unknowns])
    starts = tuple(window.start for window in model.windows)
    fitted = fit_windows(model, values, _ITERATIONS, starts, executor=executor)
    return summarize_parameters(model.unknowns, fitted), fitted.covariance


def extract_free_segments(solution: JointSolution, tracks: Tracks, first: int) -> Iterator[ShotSegment]:
    """Cut the free paths of single balls out of a shot, each as a recording of its own.

    Args:
        solution: Joint fit of the shot.
        tracks: Its tracks.
        first: Number of the first path.

    Yields:
        One segment of one ball per path.
    """
    graph, sigma = solution.graph, _contact_time_sigmas(solution)
    number = first
    for k, segment in enumerate(graph.segments):
        if segment.static:
            continue
        begin, end = graph.start_time(k), _end_of_free_path(graph, k)
        begin += 0.0 if segment.start is None else max(CONTACT_MARGIN, CONTACT_SIGMAS * float(sigma[segment.start]))
        end -= 0.0 if segment.end is None else max(CONTACT_MARGIN, CONTACT_SIGMAS * float(sigma[segment.end]))
        rows = np.flatnonzero(tracks.is_observed[:, segment.ball] & (tracks.t >= begin) & (tracks.t <= end))
        if len(rows) < MIN_PATH_ROWS:
            continue
        t = float(tracks.t[rows[0]])
        state = evaluate_state(graph, solution.friction, k, t)
        if np.hypot(*state[2:4]) < MIN_PATH_SPEED:
            continue
        start = np.concatenate([state, [0.0]])[None]
        xy, whitening = tracks.xy[rows, segment.ball][:, None], tracks.whitening[rows, segment.ball][:, None]
        yield ShotSegment(number, t, tracks.t[rows], xy, whitening, start, np.ones(1, bool))
        number += 1


def _end_of_free_path(graph: ContactGraph, k: int) -> float:
    """Return when the path of a segment meets its next contact, s: the first one of a break."""
    end = graph.segments[k].end
    contact = None if end is None else graph.contacts[end]
    return contact.break_start if contact is not None and contact.kind == "break" else graph.end_time(k)


def _cloth_priors() -> tuple[Prior, ...]:
    return tuple(replace(find_prior(*name.split(".")), name=name) for name in CLOTH_EFFECTS)


def _contact_time_sigmas(solution: JointSolution) -> FloatArray:
    """Return the standard deviation (C,) s of each contact's time."""
    first = layout_parameters(solution.graph).contact
    count = len(solution.graph.contacts)
    return np.asarray(np.sqrt(np.maximum(np.diag(solution.covariance)[first : first + count], 0.0)))
