"""A refined story as a trajectory: pieces of physics where it was accepted, curves through the samples elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import Data, Layout, Solution, layout, owners
from models.estimation.segmentation.contact_graph import Story
from models.numerics.splines import smooth_pieces
from models.physics.billiards.cloth.closed_form_motion import (
    STATE,
    kinematics_jacobian,
    polynomials,
    rest_time,
    rolling_spin,
)

PhysicalRow = tuple[str, float, float, FloatArray, FloatArray]
"""Phase, start and end s after the span's, coefficients (4, 2) of place and (2, 2) of slip."""

KNOWN_FOR = 0.1
"""s over which an error of velocity is taken to add up."""


@dataclass(frozen=True, slots=True)
class Piece:
    """One row of a trajectory, see there."""

    ball: int
    start: float
    end: float
    position: FloatArray
    spin: FloatArray
    phase: str
    covariance: FloatArray


def pieces_of(
    solution: Solution, data: Data, good: NDArray[np.bool_], balls: int, whole: tuple[float, float], radius: float,
    ends: dict[int, float],
) -> list[Piece]:  # fmt: skip
    """The motion of all balls in the `whole` clip, s; `ends` are the times at which balls vanish, s."""
    story = solution.story
    plan, owner = layout(story), owners(story, data)
    pieces: list[Piece] = []
    for ball in range(balls):
        for k in story.of_ball(ball):
            begin, end = _extent(solution, data, k, *whole, ends)
            pieces += _bridge(story, data, k)
            if end - begin <= 1e-9:
                continue
            if good[k]:
                pieces += _physical(solution, plan, k, begin, end, radius)
            else:
                pieces += _measured(solution, data, owner, k, begin, end)
    return pieces


def measured_pieces(tracks: Tracks, ball: int) -> list[Piece]:
    """A curve through the samples of a ball, from its first to its last."""
    rows = np.flatnonzero(tracks.observed[:, ball])
    t = tracks.t[rows]
    return _curve(ball, t, tracks.xy[rows, ball], tracks.sigma[rows, ball], t[0], t[-1]) if len(rows) > 1 else []


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


def state_covariance(solution: Solution, plan: Layout, span: int, tau: FloatArray) -> FloatArray:
    """Covariances (M, 4, 4) of position and velocity of one span at times tau (M,) after its start, at those times of
    the clock: when it began, and where, err together."""
    described = solution.story.spans[span]
    first = plan.span[span]
    if described.static:
        fixed = np.zeros((len(tau), 4, 4))
        fixed[:, :2, :2] = solution.covariance[first : first + 2, first : first + 2]
        return fixed
    _, slope = kinematics_jacobian(np.repeat(described.state[None], len(tau), axis=0), tau, solution.friction)
    columns = [*range(first, first + STATE), plan.globals, plan.globals + 1]
    part = slope[:, :4][:, :, [*range(STATE), STATE + 1, STATE + 2]]
    if described.start is not None:
        columns.append(plan.contact + described.start)
        part = np.concatenate([part, -slope[:, :4, STATE, None]], axis=2)
    local = solution.covariance[np.ix_(columns, columns)]
    covariance: FloatArray = part @ local @ np.swapaxes(part, 1, 2)
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
        begin = t0 if span.static else span.t0
    end = story.finish(k)
    if span.start is not None and story.contacts[span.start].kind == "jump":
        begin = float(seen[min(np.searchsorted(seen, begin), len(seen) - 1)])
    if span.end is not None and story.contacts[span.end].kind == "jump":
        end = float(seen[max(np.searchsorted(seen, end) - 1, 0)])
    if span.end is not None and story.contacts[span.end].kind == "burst":
        end = story.contacts[span.end].since
    if span.end is None:
        last = float(seen[-1])
        rests = span.static or last - begin > float(rest_time(span.state, solution.friction))
        end = ends.get(span.ball, t1 if rests else last)
    return max(begin, t0), min(end, t1)


def _bridge(story: Story, data: Data, k: int) -> list[Piece]:
    """Straight from the last sample before a jump to the first one after it, where span k begins with a jump."""
    start = story.spans[k].start
    if start is None or story.contacts[start].kind != "jump":
        return []
    rows = np.flatnonzero(data.ball == story.spans[k].ball)
    after = int(np.clip(np.searchsorted(data.t[rows], story.begin(k)), 1, len(rows) - 1))
    pair = rows[[after - 1, after]]
    return _curve(story.spans[k].ball, data.t[pair], data.xy[pair], np.full(2, 0.01), *data.t[pair])


def _physical(solution: Solution, plan: Layout, k: int, begin: float, end: float, radius: float) -> list[Piece]:
    span = solution.story.spans[k]
    if span.static:
        covariance = state_covariance(solution, plan, k, np.zeros(1))[0]
        position = np.concatenate([span.state[None, :2], np.zeros((3, 2))])
        return [Piece(span.ball, begin, end, position, np.zeros((2, 3)), "rest", covariance)]
    rows = [part for row in polynomials(span.state, end - begin, solution.friction) for part in _parts(*row)]
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


def _parts(phase: str, start: float, stop: float, position: FloatArray, slip: FloatArray) -> list[PhysicalRow]:
    """A polynomial in parts that are short, each with what is known of its own beginning: the errors of place, velocity
    and deceleration of a long one make up for each other, which a piece does not carry on."""
    if phase == "rest":
        return [(phase, start, stop, position, slip)]
    edges = np.linspace(start, stop, max(1, int(np.ceil((stop - start) / KNOWN_FOR))) + 1)
    return [
        (phase, float(a), float(b), shifted(position, a - start), np.array([slip[0] + (a - start) * slip[1], slip[1]]))
        for a, b in pairwise(edges)
    ]


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
    noise = float(np.median(np.linalg.norm(np.linalg.inv(data.whiten[rows]), axis=(1, 2)))) if len(rows) else 0.01
    return _curve(span.ball, t, xy, np.full(len(t), noise), begin, end)


def _curve(ball: int, t: FloatArray, xy: FloatArray, sigma: FloatArray, begin: float, end: float) -> list[Piece]:
    """Pieces of a smooth curve through samples, held at its ends."""
    breaks, coefficients = smooth_pieces(t, xy, sigma) if len(t) > 1 else (t, np.empty((0, 4, 2)))
    noise, interval = float(np.median(sigma)), float(np.median(np.diff(t))) if len(t) > 1 else 0.04
    covariance = np.diag([noise**2, noise**2, (noise / interval) ** 2, (noise / interval) ** 2])
    first = coefficients[0, 0] if len(coefficients) else xy[0]
    last = shifted(coefficients[-1], breaks[-1] - breaks[-2])[0] if len(coefficients) else xy[0]
    rows = [(start, stop, c) for start, stop, c in zip(breaks[:-1], breaks[1:], coefficients, strict=True)]
    rows = [(-np.inf, breaks[0], _still(first)), *rows, (breaks[-1], np.inf, _still(last))]
    pieces = []
    for start, stop, position in rows:
        shown = (max(start, begin), min(stop, end))
        if shown[1] - shown[0] > 1e-9:
            moved = shifted(position, shown[0] - start) if np.isfinite(start) else position
            pieces.append(Piece(ball, *shown, moved, np.full((2, 3), np.nan), "measured", covariance))
    return pieces


def _still(x: FloatArray) -> FloatArray:
    return np.concatenate([x[None], np.zeros((3, 2))])


def shifted(position: FloatArray, by: float) -> FloatArray:
    """Coefficients (4, 2) of the same cubic about a later moment."""
    a, b, c, d = position
    return np.array([a + by * (b + by * (c + by * d)), b + by * (2 * c + 3 * by * d), c + 3 * by * d, d])
