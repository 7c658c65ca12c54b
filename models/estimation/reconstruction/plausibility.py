"""Sizes and times that contacts and rolling balls contradict."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from models.core.contact_graph import JointSolution
from models.core.fit_result import Parameter
from models.core.scene import BallSize, Scene, Table, find_contradictions
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.pseudo_observations import DIAMETER_SIGMA
from models.physics.billiards.tables import TABLE_PRESETS, format_contradiction

# Distance at which balls touch over two radii of the table's balls.
FACTOR_NAME = "ball_size.factor"
# Share of the prior's standard deviation above which the contacts do not identify the factor: below it they hold more
# information than the prior. One contact alone rarely does, and its place may be wrong.
MAX_PRIOR_SHARE = 0.7
# Relative systematic standard deviation of the estimate. On nine clips with known balls and enough contacts the errors
# are then 0.6 standard deviations (root mean square) and at most 1.6.
CONTACT_FLOOR = 0.015


def describe_ball_factor(factor: float, sigma: float) -> Parameter:
    """Describe the fitted factor on the distance of touching balls.

    Args:
        factor: Estimate, with its prior.
        sigma: Standard deviation of the estimate, with its prior.

    Returns:
        The parameter of a fit.
    """
    return Parameter(FACTOR_NAME, factor, sigma, "", sigma > MAX_PRIOR_SHARE * DIAMETER_SIGMA)


def estimate_contact_ball_size(parameters: Iterable[Parameter], radius: float) -> BallSize | None:
    """Estimate the ball size from contacts alone, without the prior that ties it to the other estimates.

    Args:
        parameters: Parameters of a fit.
        radius: Radius of the table's balls, m.

    Returns:
        The estimate; None where the contacts do not identify it.
    """
    factor = next((p for p in parameters if p.name == FACTOR_NAME), None)
    if factor is None or factor.prior_only or not 0 < factor.sigma < DIAMETER_SIGMA:
        return None
    information, prior = factor.sigma**-2, DIAMETER_SIGMA**-2
    value = (factor.value * information - prior) / (information - prior)
    if value <= 0:
        return None
    return BallSize(radius * value, radius * math.hypot((information - prior) ** -0.5, CONTACT_FLOOR), "contacts")


def warn_of_contact_ball_size(parameters: Iterable[Parameter], scene: Scene) -> tuple[str, ...]:
    """Return a warning if the contacts contradict the nominal ball size; empty otherwise.

    A contradiction between the nominal size and the images is a warning of the scene already.

    Args:
        parameters: Parameters of a fit.
        scene: Table with the estimates of the ball size.
    """
    contacts = estimate_contact_ball_size(parameters, scene.table.ball_radius)
    if contacts is None or find_contradictions(scene.ball_size_estimates):
        return ()
    nominal = [estimate for estimate in scene.ball_size_estimates if estimate.source != "image"]
    pairs = find_contradictions([*nominal, contacts])
    return tuple(format_contradiction(*pair, scene.table.name) for pair in pairs)


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
