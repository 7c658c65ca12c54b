"""Deceleration of rolling balls, which shows a stated frame rate or table size that cannot be."""

from __future__ import annotations

import numpy as np

from models.core.joint_solution import JointSolution
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.physics.billiards.tables import TABLE_PRESETS

# m/s^2 of rolling balls: fast cloths have 0.05, slow or damp ones 0.2; worn napped cloth may have 0.3.
DECELERATION_RANGE = (0.03, 0.3)
# m/s^2: a coefficient of 0.01 (Marlow 1995); the samples and real snooker cloth have 0.09 to 0.11.
USUAL_DECELERATION = 0.1
# Samples of a free path from which its deceleration is measured.
MIN_SAMPLES = 10
# Last part of a free path, of its samples: before, a ball may slide, which decelerates it by 2 m/s^2.
ROLLING_SHARE = 0.6
# m/s: a slower ball may settle into its dent.
MIN_SPEED = 0.05
# Standard deviation that the tilt of a table and the perspective add to a deceleration, share of it.
RELATIVE_ERROR = 0.1
# Standard deviations by which a deceleration is outside the range where it is doubted.
SURE_SIGMAS = 2.0
# Difference of the ratio of ball and table up to which a table may be another one of the same game.
SAME_TABLE_RATIO = 0.15


def find_implausible_deceleration(solution: JointSolution, tracks: Tracks, table: Table) -> float | None:
    """Find whether rolling balls decelerate as on no table that the clip may show.

    Times that are k times too long make decelerations k^2 times too small.

    Args:
        solution: Solution of the shot.
        tracks: Tracks at their capture times.

    Returns:
        The deceleration, m/s^2; None where it is possible, or not known well.
    """
    values, sigmas = _measure_decelerations(solution, tracks)
    if not len(values):
        return None
    order = np.argsort(values)
    weight = np.cumsum(sigmas[order] ** -2.0)
    value = float(values[order][np.searchsorted(weight, weight[-1] / 2)])
    sigma = float(np.hypot(weight[-1] ** -0.5, RELATIVE_ERROR * value))
    ratio = table.ball_radius / table.length
    scales = [
        other.length / table.length
        for other in (table, *TABLE_PRESETS.values())
        if other.game == table.game and abs(other.ball_radius / other.length / ratio - 1) < SAME_TABLE_RATIO
    ]
    low, high = DECELERATION_RANGE[0] / max(scales), DECELERATION_RANGE[1] / min(scales)
    return value if value + SURE_SIGMAS * sigma < low or value - SURE_SIGMAS * sigma > high else None


def _measure_decelerations(solution: JointSolution, tracks: Tracks) -> tuple[FloatArray, FloatArray]:
    """Measure the decelerations (n,) along free paths, m/s^2, and their standard deviations (n,)."""
    graph, measured = solution.graph, list[tuple[float, float]]()
    for k, segment in enumerate(graph.segments):
        inside = (tracks.t > graph.start_time(k)) & (tracks.t < graph.end_time(k)) & tracks.is_observed[:, segment.ball]
        rows = np.flatnonzero(inside)[-int(ROLLING_SHARE * np.count_nonzero(inside)) :]
        if segment.static or len(rows) < MIN_SAMPLES:
            continue
        tau = tracks.t[rows] - tracks.t[rows].mean()
        basis = np.stack([np.ones_like(tau), tau, tau**2 / 2], axis=1)
        path, *_ = np.linalg.lstsq(basis, tracks.xy[rows, segment.ball])
        speed = float(np.hypot(*path[1]))
        if speed < MIN_SPEED:
            continue
        residual = tracks.xy[rows, segment.ball] - basis @ path
        noise = float(np.sqrt((residual**2).sum() / (2 * (len(rows) - 3))))
        error = noise * float(np.sqrt(np.linalg.inv(basis.T @ basis)[2, 2]))
        measured.append((-float(path[2] @ path[1]) / speed, max(error, 1e-4)))
    values, sigmas = np.array(measured, dtype=np.float64).reshape(-1, 2).T
    return values, sigmas
