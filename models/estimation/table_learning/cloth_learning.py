"""Cloth of a table learned from the free paths of many shots: friction, drag and slope, whatever the contacts do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from models.core.contact_graph import ContactGraph
from models.core.fit_result import Parameter
from models.core.joint_solution import JointSolution, layout_parameters
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions, fit_windows, summarize_parameters
from models.estimation.whole_shot.shot_segments import ShotSegment
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.numerics.executor import SERIAL, Executor
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from models.physics.effect import Prior
from models.physics.effects.catalogue import find_prior

CLOTH_EFFECTS = ("sliding_friction.mu", "rolling_resistance.mu", "viscous_drag.k", "slope.slope_x", "slope.slope_y")
"""Parameters of the cloth that free paths determine."""
DRAG_GUESS = 0.005
"""1/s, at which a search begins: without drag a path has no derivative by it."""
CONTACT_MARGIN = 0.01
"""s before and after a contact that are left out at least."""
CONTACT_SIGMAS = 4.0
"""Standard deviations of a contact's time that are left out."""
MIN_PATH_ROWS, MIN_PATH_SPEED = 6, 0.05
"""Observations of a path, and m/s at its start, from which it tells about the cloth."""
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
        tau = np.array([max(t - graph.start_time(k), 0.0)])
        state = evaluate_kinematics(segment.state[None], tau, solution.friction)[0]
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
