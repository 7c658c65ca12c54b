"""Trajectory of a refined contact graph: physical pieces where it was accepted, curves through samples elsewhere.

Curves are linear, not-a-knot cubic, or smoothing cubic.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import (
    SEGMENT_STATE_SIZE,
    ContactGraph,
    JointSolution,
    Observations,
    ParameterLayout,
    layout_parameters,
)
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import assign_observations
from models.physics.billiards.cloth.closed_form_motion import (
    differentiate_kinematics,
    duration_until_rest,
    spin_from_slip,
    split_into_polynomials,
)

# Phase, start and end in s after the segment's start, coefficients (4, 2) of place and (2, 2) of slip.
PhysicalRow = tuple[str, float, float, FloatArray, FloatArray]

# s over which a velocity error is taken to add up.
MAX_PIECE_TIME = 0.1


@dataclass(frozen=True, slots=True)
class TrajectoryPiece:
    """One row of a `Trajectory`."""

    ball: int
    start: float
    end: float
    position: FloatArray
    spin: FloatArray
    phase: str
    covariance: FloatArray


def build_pieces(
    solution: JointSolution,
    observations: Observations,
    is_accepted: NDArray[np.bool_],
    balls: int,
    clip_span: tuple[float, float],
    radius: float,
    vanish_times: dict[int, float],
) -> list[TrajectoryPiece]:
    """Build the motion of all balls within `clip_span`, s; balls vanish at `vanish_times`, s."""
    graph = solution.graph
    layout, owner = layout_parameters(graph), assign_observations(graph, observations)
    pieces: list[TrajectoryPiece] = []
    for ball in range(balls):
        for k in graph.segments_of_ball(ball):
            begin, end = _segment_extent(solution, observations, k, *clip_span, vanish_times)
            pieces += _bridge_jump(graph, observations, k)
            if end - begin <= 1e-9:
                continue
            if is_accepted[k]:
                pieces += _build_physical_pieces(solution, layout, k, begin, end, radius)
            else:
                pieces += _build_measured_segment(solution, observations, owner, k, begin, end)
    return pieces


def build_measured_pieces(tracks: Tracks, ball: int) -> list[TrajectoryPiece]:
    """Build a curve through the samples of a ball, from its first to its last."""
    rows = np.flatnonzero(tracks.is_observed[:, ball])
    t = tracks.t[rows]
    return (
        _build_smooth_curve(ball, t, tracks.xy[rows, ball], tracks.sigma[rows, ball], t[0], t[-1])
        if len(rows) > 1
        else []
    )


def pack_trajectory(pieces: list[TrajectoryPiece], ids: tuple[str, ...]) -> Trajectory:
    """Pack pieces, sorted by ball and start, into columns."""
    pieces = sorted(pieces, key=lambda piece: (piece.ball, piece.start))
    return Trajectory(
        ids,
        np.array([piece.ball for piece in pieces], dtype=np.int64),
        np.array([piece.start for piece in pieces], dtype=np.float64),
        np.array([piece.end for piece in pieces], dtype=np.float64),
        np.array([piece.position for piece in pieces]).reshape(-1, 4, 2),
        np.array([piece.spin for piece in pieces]).reshape(-1, 2, 3),
        tuple(piece.phase for piece in pieces),
        np.array([piece.covariance for piece in pieces]).reshape(-1, 4, 4),
    )


def state_covariance(solution: JointSolution, layout: ParameterLayout, index: int, tau: FloatArray) -> FloatArray:
    """Return covariances (M, 4, 4) of position and velocity of a segment at tau (M,) s after its start.

    They hold at fixed times of the clock: errors of the start time and of the start state add up.
    """
    segment = solution.graph.segments[index]
    first = layout.segment[index]
    if segment.static:
        fixed = np.zeros((len(tau), 4, 4))
        fixed[:, :2, :2] = solution.covariance[first : first + 2, first : first + 2]
        return fixed
    _, jacobian = differentiate_kinematics(np.repeat(segment.state[None], len(tau), axis=0), tau, solution.friction)
    columns = [*range(first, first + SEGMENT_STATE_SIZE), layout.shared, layout.shared + 1]
    part = jacobian[:, :4][:, :, [*range(SEGMENT_STATE_SIZE), SEGMENT_STATE_SIZE + 1, SEGMENT_STATE_SIZE + 2]]
    if segment.start is not None:
        columns.append(layout.contact + segment.start)
        part = np.concatenate([part, -jacobian[:, :4, SEGMENT_STATE_SIZE, None]], axis=2)
    local = solution.covariance[np.ix_(columns, columns)]
    covariance: FloatArray = part @ local @ np.swapaxes(part, 1, 2)
    return covariance


def _segment_extent(
    solution: JointSolution, observations: Observations, k: int, t0: float, t1: float, vanish_times: dict[int, float]
) -> tuple[float, float]:
    """Return when a segment is shown: resting balls for the whole clip, moving ones while they were observed."""
    graph = solution.graph
    segment = graph.segments[k]
    times = observations.t[observations.ball == segment.ball]
    begin = graph.start_time(k)
    if segment.start is None:
        begin = t0 if segment.static else segment.t0
    end = graph.end_time(k)
    if segment.start is not None and graph.contacts[segment.start].kind == "jump":
        begin = float(times[min(np.searchsorted(times, begin), len(times) - 1)])
    if segment.end is not None and graph.contacts[segment.end].kind == "jump":
        end = float(times[max(np.searchsorted(times, end) - 1, 0)])
    if segment.end is not None and graph.contacts[segment.end].kind == "break":
        end = graph.contacts[segment.end].break_start
    if segment.end is None:
        last = float(times[-1])
        rests = segment.static or last - begin > float(duration_until_rest(segment.state, solution.friction))
        end = vanish_times.get(segment.ball, t1 if rests else last)
    return max(begin, t0), min(end, t1)


def _bridge_jump(graph: ContactGraph, observations: Observations, k: int) -> list[TrajectoryPiece]:
    """Build a straight piece from the last sample before a jump to the first one after it."""
    start = graph.segments[k].start
    if start is None or graph.contacts[start].kind != "jump":
        return []
    rows = np.flatnonzero(observations.ball == graph.segments[k].ball)
    after = int(np.clip(np.searchsorted(observations.t[rows], graph.start_time(k)), 1, len(rows) - 1))
    pair = rows[[after - 1, after]]
    return _build_smooth_curve(
        graph.segments[k].ball, observations.t[pair], observations.xy[pair], np.full(2, 0.01), *observations.t[pair]
    )


def _build_physical_pieces(
    solution: JointSolution, layout: ParameterLayout, k: int, begin: float, end: float, radius: float
) -> list[TrajectoryPiece]:
    """Build the pieces of an accepted segment."""
    segment = solution.graph.segments[k]
    if segment.static:
        covariance = state_covariance(solution, layout, k, np.zeros(1))[0]
        position = np.concatenate([segment.state[None, :2], np.zeros((3, 2))])
        return [TrajectoryPiece(segment.ball, begin, end, position, np.zeros((2, 3)), "rest", covariance)]
    rows = [
        part
        for row in split_into_polynomials(segment.state, end - begin, solution.friction)
        for part in _split_polynomial(*row)
    ]
    covariances = state_covariance(solution, layout, k, np.array([row[1] for row in rows]))
    pieces = []
    for (phase, start, stop, position, slip), covariance in zip(rows, covariances, strict=True):
        spin = np.zeros((2, 3))
        spin[0, :2] = spin_from_slip(position[1], slip[0], radius)
        spin[1, :2] = spin_from_slip(2 * position[2], slip[1], radius)
        if phase == "rest":
            spin[:] = 0.0
            covariance = covariance * np.outer([1, 1, 0, 0], [1, 1, 0, 0])
        else:
            spin[0, 2], spin[1, 2] = np.nan, np.nan
        pieces.append(TrajectoryPiece(segment.ball, begin + start, begin + stop, position, spin, phase, covariance))
    return pieces


def _split_polynomial(
    phase: str, start: float, stop: float, position: FloatArray, slip: FloatArray
) -> list[PhysicalRow]:
    """Split a polynomial into short parts, each with the covariance at its own start.

    In a long one the errors of place, velocity and deceleration compensate each other, which a piece does not carry on.
    """
    if phase == "rest":
        return [(phase, start, stop, position, slip)]
    edges = np.linspace(start, stop, max(1, int(np.ceil((stop - start) / MAX_PIECE_TIME))) + 1)
    return [
        (
            phase,
            float(a),
            float(b),
            shift_polynomial(position, a - start),
            np.array([slip[0] + (a - start) * slip[1], slip[1]]),
        )
        for a, b in pairwise(edges)
    ]


def _build_measured_segment(
    solution: JointSolution, observations: Observations, owner: NDArray[np.int64], k: int, begin: float, end: float
) -> list[TrajectoryPiece]:
    """Build a cubic through the samples of a segment, joined to the starts of its neighbours."""
    segment = solution.graph.segments[k]
    rows = np.flatnonzero((owner == k) & (observations.ball == segment.ball))
    t, xy = observations.t[rows], observations.xy[rows]
    interval = (
        float(np.median(np.diff(observations.t[observations.ball == segment.ball])))
        if (observations.ball == segment.ball).sum() > 1
        else 0.04
    )
    nexts = (
        [q for q in solution.graph.segments_of_ball(segment.ball) if solution.graph.segments[q].start == segment.end]
        if segment.end is not None
        else []
    )
    knots = [(begin, segment.state[:2])] if segment.start is not None else []
    knots += [(end, solution.graph.segments[nexts[0]].state[:2])] if nexts else []
    for moment, place in knots:
        if len(t) == 0 or np.abs(t - moment).min() > 0.25 * interval:
            order = np.argsort([*t, moment], kind="stable")
            t, xy = np.array([*t, moment])[order], np.vstack([xy.reshape(-1, 2), place])[order]
    if len(t) == 0:
        return []
    noise = (
        float(np.median(np.linalg.norm(np.linalg.inv(observations.whiten[rows]), axis=(1, 2)))) if len(rows) else 0.01
    )
    return _build_smooth_curve(segment.ball, t, xy, np.full(len(t), noise), begin, end)


def _build_smooth_curve(
    ball: int, t: FloatArray, xy: FloatArray, sigma: FloatArray, begin: float, end: float
) -> list[TrajectoryPiece]:
    """Build a smooth curve through samples, constant beyond its ends."""
    breaks, coefficients = fit_smoothing_pieces(t, xy, sigma) if len(t) > 1 else (t, np.empty((0, 4, 2)))
    noise, interval = float(np.median(sigma)), float(np.median(np.diff(t))) if len(t) > 1 else 0.04
    covariance = np.diag([noise**2, noise**2, (noise / interval) ** 2, (noise / interval) ** 2])
    first = coefficients[0, 0] if len(coefficients) else xy[0]
    last = shift_polynomial(coefficients[-1], breaks[-1] - breaks[-2])[0] if len(coefficients) else xy[0]
    rows = [(start, stop, c) for start, stop, c in zip(breaks[:-1], breaks[1:], coefficients, strict=True)]
    rows = [(-np.inf, breaks[0], _constant_polynomial(first)), *rows, (breaks[-1], np.inf, _constant_polynomial(last))]
    pieces = []
    for start, stop, position in rows:
        clipped = (max(start, begin), min(stop, end))
        if clipped[1] - clipped[0] > 1e-9:
            moved = shift_polynomial(position, clipped[0] - start) if np.isfinite(start) else position
            pieces.append(TrajectoryPiece(ball, *clipped, moved, np.full((2, 3), np.nan), "measured", covariance))
    return pieces


def _constant_polynomial(x: FloatArray) -> FloatArray:
    """Return the coefficients (4, 2) of a constant."""
    return np.concatenate([x[None], np.zeros((3, 2))])


def shift_polynomial(position: FloatArray, by: float) -> FloatArray:
    """Return the coefficients (4, 2) of the same cubic about a later moment."""
    a, b, c, d = position
    return np.array([a + by * (b + by * (c + by * d)), b + by * (2 * c + 3 * by * d), c + 3 * by * d, d])


# Median sample intervals: over wider gaps a cubic overshoots, so the curve is straight there.
MAX_SMOOTH_GAP = 2.5


def fit_linear_pieces(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Connect samples by straight lines.

    Args:
        t: Times (T,), s, increasing.
        xy: Positions (T, 2), m.

    Returns:
        Coefficients (T-1, 4, 2) of powers of t - t[k], m/s^k.
    """
    slope = np.diff(xy, axis=0) / np.diff(t)[:, None]
    zero = np.zeros_like(slope)
    return np.stack([xy[:-1], slope, zero, zero], axis=1)


def fit_cubic_pieces(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Fit a not-a-knot cubic spline through samples, with straight lines over wide gaps.

    Args:
        t: Times (T,), s, increasing.
        xy: Positions (T, 2), m.

    Returns:
        Coefficients (T-1, 4, 2) of powers of t - t[k], m/s^k.
    """
    if len(t) < 4:
        return fit_linear_pieces(t, xy)
    from scipy.interpolate import CubicSpline  # slow to import, and not needed if every segment has an accepted fit

    pieces = np.moveaxis(CubicSpline(t, xy, bc_type="not-a-knot").c[::-1], 0, 1)  # (T-1, 4, 2)
    step = np.diff(t)
    wide = step > MAX_SMOOTH_GAP * np.median(step)
    return np.where(wide[:, None, None], fit_linear_pieces(t, xy), pieces)


def fit_smoothing_pieces(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit the smoothest cubic that stays within the errors of the samples.

    If a gap is wide, or there are fewer than six samples, the curve passes through all samples (`fit_cubic_pieces`).

    Args:
        t: Times (T,), s, increasing.
        xy: Positions (T, 2), m.
        sigma: Standard deviations of the positions (T,), m.

    Returns:
        Break points (M+1,) in s, and coefficients (M, 4, 2) of powers of the time since the break point, m/s^k.
    """
    step = np.diff(t)
    if len(t) < 6 or np.any(step > MAX_SMOOTH_GAP * np.median(step)):
        return t, fit_cubic_pieces(t, xy)
    from scipy.interpolate import PPoly, UnivariateSpline

    curves = [PPoly.from_spline(UnivariateSpline(t, xy[:, k], w=1 / sigma, s=len(t))._eval_args) for k in (0, 1)]
    breaks = np.unique(np.concatenate([curve.x for curve in curves]))
    breaks = breaks[(breaks >= t[0]) & (breaks <= t[-1])]
    orders = [
        [curve.derivative(k)(breaks[:-1]) / (1, 1, 2, 6)[k] if k else curve(breaks[:-1]) for k in range(4)]
        for curve in curves
    ]
    return breaks, np.moveaxis(np.array(orders), (0, 1, 2), (2, 1, 0))
