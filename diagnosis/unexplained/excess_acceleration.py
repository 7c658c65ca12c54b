"""Accelerations that a model lacks, measured on short pieces of motion without a contact.

A force that the model lacks bends the residuals of a path: their second derivative is the acceleration that it causes,
whatever its law. It is measured piece by piece with a parabola, with an error that follows from the noise alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.fitting.diagnosis_windows import MIN_ROWS
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states
from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import ContactRichScene, Covariates

# Number of pieces of a window; their length is limited by the next two.
_PIECES = 4
# Least and largest number of rows of a piece: a parabola leaves six degrees of freedom of the least.
_MIN_PIECE_ROWS, _MAX_PIECE_ROWS = 9, 30
# Phases in which a residual is no measure of a force: an impulse acts, or nothing moves.
_CONTACT_PHASES = ("ball_contact", "cushion_contact", "wall_contact", "rest")


@dataclass(frozen=True, slots=True)
class ExcessAcceleration:
    """Acceleration that a model lacks, in M pieces of motion with D coordinates."""

    values: FloatArray
    """(M, D) in the unit of the scene per s^2."""
    sigma: FloatArray
    """(M,) standard deviation of each coordinate, from the noise alone."""
    shot: IntArray
    """(M,) index of the shot."""
    t: FloatArray
    """(M,) s since the start of the shot."""
    position: FloatArray
    """(M, D) in the unit of the scene."""
    velocity: FloatArray
    """(M, D) in the unit of the scene per s."""

    @property
    def speed(self) -> FloatArray:
        """(M,) in the unit of the scene per s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))

    def project(self, directions: FloatArray) -> FloatArray:
        """Return the components (M,) along unit vectors (M, D)."""
        return np.asarray((self.values * directions).sum(axis=1))


def measure_excess_acceleration(problem: DiagnosisProblem, fitted: EffectFit) -> ExcessAcceleration:
    """Measure the acceleration that the model of a fit lacks.

    Args:
        problem: Scene and noise.
        fitted: The fit.

    Returns:
        Accelerations of all pieces; none where every window is too short.
    """
    if not isinstance(problem.scene, ContactRichScene):
        # a force that pulls back changes the residuals of a long path; a piece with a start of its own stays near it
        pieces = tuple(
            piece
            for segment, start in zip(fitted.segments, fitted.starts, strict=True)
            for piece in _cut_pieces(segment, _find_contact_rows(problem, segment, start, fitted))
        )
        fitted = fit_start_states(problem, pieces, fitted) if pieces else fitted
    correlated = np.sqrt((1 + problem.correlation) / (1 - problem.correlation))
    rows: list[tuple[FloatArray, float, int, float, FloatArray, FloatArray]] = []
    for segment, start in zip(fitted.segments, fitted.starts, strict=True):
        path = problem.scene.predict_positions(segment, start, fitted.shared, fitted.forms)
        covariates = problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms)
        rows += _measure_pieces(segment, path, covariates, float(correlated))
    values, sigma, shot, t, position, velocity = (
        zip(*rows, strict=True) if rows else (np.empty((0, 1)), (), (), (), np.empty((0, 1)), np.empty((0, 1)))
    )
    return ExcessAcceleration(
        np.array(values), np.array(sigma), np.array(shot, np.int64), np.array(t), np.array(position), np.array(velocity)
    )


def _find_contact_rows(
    problem: DiagnosisProblem, segment: Recording, start: FloatArray, fitted: EffectFit
) -> list[int]:
    """Find the rows of a segment before which a body meets a wall, in order."""
    since = problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms).since_contact
    rows, bodies = np.nonzero(segment.is_observed)
    contact_rows: set[int] = set()
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(bodies == body)
        last = np.nan_to_num(segment.t[rows[own]] - since[own], nan=-np.inf)
        contact_rows.update(int(row) for row in rows[own[1:]][last[1:] > last[:-1] + 1e-9])
    return sorted(contact_rows)


def _cut_pieces(segment: Recording, contacts: list[int]) -> list[Recording]:
    """Cut a segment between its contacts into pieces in which every body is observed often enough."""
    pieces = []
    for first, end in pairwise([0, *contacts, len(segment.t)]):
        length = min(_piece_length(len(segment.t)), max(end - first, _MIN_PIECE_ROWS))
        pieces += [segment.select_rows(k, k + length) for k in range(first, end - length + 1, length)]
    return [one for one in pieces if (one.is_observed.sum(axis=0) >= MIN_ROWS).all()]


def _piece_length(rows: int) -> int:
    """Return the number of rows of the pieces of a window."""
    return int(np.clip(rows // _PIECES, _MIN_PIECE_ROWS, _MAX_PIECE_ROWS))


def _measure_pieces(
    segment: Recording, path: FloatArray, covariates: Covariates, correlated: float
) -> list[tuple[FloatArray, float, int, float, FloatArray, FloatArray]]:
    """Measure the pieces of one window: acceleration, sigma, shot, time, position and velocity of each."""
    rows, bodies = np.nonzero(segment.is_observed)
    phases: NDArray[np.str_] = np.array(covariates.phase)
    length, measured = _piece_length(len(segment.t)), []
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(bodies == body)
        for k in range(0, len(own) - length + 1, length):
            here = own[k : k + length]
            t = segment.t[rows[here]]
            if np.isin(phases[here], _CONTACT_PHASES).any() or not np.isfinite(path[rows[here], body]).all():
                continue
            span = float(np.ptp(t))
            weights = 2 * np.linalg.pinv(np.vander((t - t.mean()) / span, 3))[0] / span**2  # of a second derivative
            miss = segment.positions[rows[here], body] - path[rows[here], body]
            measured.append(
                (
                    weights @ miss,
                    float(np.linalg.norm(weights) * segment.sigma[rows[here], body].mean() * correlated),
                    segment.shot,
                    float(t.mean()),
                    covariates.position[here].mean(axis=0),
                    covariates.velocity[here].mean(axis=0),
                )
            )
    return measured
