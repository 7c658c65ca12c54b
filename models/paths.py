"""A refined story as a trajectory: pieces of physics where it was accepted, curves through the samples elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.baselines import cubic_pieces
from models.billiards.motion import STATE, kinematics_jacobian, polynomials, rolling_spin
from models.refinement import Data, Layout, Solution, layout, owners
from models.trajectory import Trajectory

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Piece:
    """One row of a trajectory, see there."""

    ball: int
    start: float
    end: float
    position: Floats
    spin: Floats
    phase: str
    covariance: Floats


def trajectory_of(
    solution: Solution, data: Data, good: NDArray[np.bool_], ids: tuple[str, ...], t0: float, t1: float,
    radius: float, ends: dict[int, float],
) -> Trajectory:  # fmt: skip
    """The motion of all balls between t0 and t1; `ends` are the times at which balls vanish, s."""
    story = solution.story
    plan, owner = layout(story), owners(story, data)
    pieces: list[Piece] = []
    for ball in range(len(ids)):
        for k in story.of_ball(ball):
            begin, end = _extent(solution, data, k, t0, t1, ends)
            if end - begin <= 1e-9:
                continue
            if good[k]:
                pieces += _physical(solution, plan, k, begin, end, radius)
            else:
                pieces += _measured(solution, data, owner, k, begin, end)
    return pack(pieces, ids)


def pack(pieces: list[Piece], ids: tuple[str, ...]) -> Trajectory:
    """Pieces, sorted by ball and start, as columns."""
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


def state_covariance(solution: Solution, plan: Layout, span: int, tau: Floats) -> Floats:
    """Covariances (M, 4, 4) of position and velocity of one span at times tau (M,) after its start."""
    described = solution.story.spans[span]
    first = plan.span[span]
    if described.static:
        fixed = np.zeros((len(tau), 4, 4))
        fixed[:, :2, :2] = solution.covariance[first : first + 2, first : first + 2]
        return fixed
    _, slope = kinematics_jacobian(np.repeat(described.state[None], len(tau), axis=0), tau, solution.friction)
    columns = [*range(first, first + STATE), plan.globals, plan.globals + 1]
    part = slope[:, :4][:, :, [*range(STATE), STATE + 1, STATE + 2]]  # at fixed time since the start
    local = solution.covariance[np.ix_(columns, columns)]
    covariance: Floats = part @ local @ np.swapaxes(part, 1, 2)
    return covariance


def _extent(
    solution: Solution, data: Data, k: int, t0: float, t1: float, ends: dict[int, float]
) -> tuple[float, float]:
    """When a span is shown: resting balls as long as the clip, moving ones while they were seen."""
    story = solution.story
    span = story.spans[k]
    seen = data.t[data.ball == span.ball]
    begin = story.begin(k)
    if span.start is None:
        begin = t0 if span.static else float(seen[0])
    end = story.finish(k)
    if span.end is None:
        last = float(seen[-1])
        rests = span.static or polynomials(span.state, last - begin, solution.friction)[-1][0] == "rest"
        end = ends.get(span.ball, t1 if rests else last)
    return max(begin, t0), min(end, t1)


def _physical(solution: Solution, plan: Layout, k: int, begin: float, end: float, radius: float) -> list[Piece]:
    span = solution.story.spans[k]
    if span.static:
        covariance = state_covariance(solution, plan, k, np.zeros(1))[0]
        position = np.concatenate([span.state[None, :2], np.zeros((3, 2))])
        return [Piece(span.ball, begin, end, position, np.zeros((2, 3)), "rest", covariance)]
    rows = polynomials(span.state, end - begin, solution.friction)
    covariances = state_covariance(solution, plan, k, np.array([row[1] for row in rows]))
    pieces = []
    for (phase, start, stop, position, slip), covariance in zip(rows, covariances, strict=True):
        spin = np.zeros((2, 3))
        spin[0, :2] = rolling_spin(position[1], slip[0], radius)
        spin[1, :2] = rolling_spin(2 * position[2], slip[1], radius)
        if phase == "rest":
            spin[:] = 0.0
            covariance = covariance * np.outer([1, 1, 0, 0], [1, 1, 0, 0])
        else:
            spin[0, 2], spin[1, 2] = np.nan, np.nan
        pieces.append(Piece(span.ball, begin + start, begin + stop, position, spin, phase, covariance))
    return pieces


def _measured(
    solution: Solution, data: Data, owner: NDArray[np.int64], k: int, begin: float, end: float
) -> list[Piece]:
    """A cubic through the samples of a span, joined to where its neighbours start."""
    span = solution.story.spans[k]
    rows = np.flatnonzero((owner == k) & (data.ball == span.ball))
    t, xy = data.t[rows], data.xy[rows]
    interval = float(np.median(np.diff(data.t[data.ball == span.ball]))) if (data.ball == span.ball).sum() > 1 else 0.04
    nexts = (
        [q for q in solution.story.of_ball(span.ball) if solution.story.spans[q].start == span.end]
        if span.end is not None
        else []
    )
    knots = [(begin, span.state[:2])] if span.start is not None else []
    knots += [(end, solution.story.spans[nexts[0]].state[:2])] if nexts else []
    for moment, place in knots:
        if len(t) == 0 or np.abs(t - moment).min() > 0.25 * interval:
            order = np.argsort([*t, moment], kind="stable")
            t, xy = np.array([*t, moment])[order], np.vstack([xy.reshape(-1, 2), place])[order]
    if len(t) == 0:
        return []
    t, xy = _held(t, xy, begin, end)
    coefficients = cubic_pieces(t, xy)
    noise = float(np.median(np.linalg.norm(np.linalg.inv(data.whiten[rows]), axis=(1, 2)))) if len(rows) else 0.01
    covariance = np.diag([noise**2, noise**2, (noise / interval) ** 2, (noise / interval) ** 2]) / 2
    starts, stops = t[:-1].copy(), t[1:].copy()
    pieces = []
    for index, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        shown = (max(start, begin), min(stop, end))
        if shown[1] - shown[0] > 1e-9:
            position = _shifted(coefficients[index], shown[0] - start)
            pieces.append(Piece(span.ball, *shown, position, np.full((2, 3), np.nan), "measured", covariance))
    return pieces


def _held(t: Floats, xy: Floats, begin: float, end: float) -> tuple[Floats, Floats]:
    """Samples, with the first and last place kept where the curve must reach beyond them."""
    if begin < t[0] - 1e-9:
        t, xy = np.array([begin, *t]), np.vstack([xy[:1], xy])
    if end > t[-1] + 1e-9:
        t, xy = np.array([*t, end]), np.vstack([xy, xy[-1:]])
    return t, xy


def _shifted(position: Floats, by: float) -> Floats:
    """Coefficients (4, 2) of the same cubic about a later moment."""
    a, b, c, d = position
    return np.array([a + by * (b + by * (c + by * d)), b + by * (2 * c + 3 * by * d), c + 3 * by * d, d])
