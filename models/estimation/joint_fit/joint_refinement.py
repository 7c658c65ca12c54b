"""All spans, contacts and coefficients of a clip together: Levenberg-Marquardt with the physics as soft knowledge.

What the samples say is weighted by their noise and made robust (Huber); what physics says is in
`models.estimation.joint_fit.physics_priors`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dposv

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_arrays import (
    DIAMETER,
    NONE,
    ROLLING,
    SLIDING,
    Numbers,
    Skeleton,
    begins,
    finishes,
    numbers_of,
    skeleton_of,
    solution_with,
)
from models.estimation.joint_fit.fit_solution import Data, Solution, owners_among
from models.estimation.joint_fit.physics_priors import ROLLING_PRIOR, RUBBER, SLIDING_PRIOR, Rows, known
from models.estimation.segmentation.contact_graph import Story
from models.numerics.jit import compiled
from models.physics.billiards.cloth.closed_form_motion import STATE, Friction, differentiate_one

SLIDING_RANGE, ROLLING_RANGE = (0.05, 0.5), (0.002, 0.04)
"""What no cloth exceeds, polished or wet."""
GAIN_TO_GO_ON = 0.03
"""chi2 that an iteration must gain: far below what matters."""
REFRESH = 4
"""iterations between updates of the standard deviations that depend on speeds."""
LEAST_KNOWN = 1e-6
"""1/variance of a number that nothing tells, in its own unit."""
RIDGE = 1e-10
"""relative to what is known of a number: a thousand times the rounding errors of a large fit."""
SHORTEST = 1e-4
"""s: least time between two contacts of a ball."""
NEARER = 0.7
"""Of the time between two contacts of a ball, by which one step may shorten it."""
UNKNOWN = np.empty((0, 0))
"""The covariance before it is asked for."""
HUBER = 2.5
"""standard deviations where the loss turns linear."""


@dataclass(frozen=True, slots=True)
class _Linear:
    """Residuals and their derivatives at one place."""

    residual: FloatArray
    """(2K + M,) in standard deviations: of the observations, then of what is known."""
    slope: FloatArray
    columns: IntArray
    """(K, 2, 11) and (K, 11): of the observations, and at which of the P columns; -1 for none."""
    known: Rows
    """What physics and priors say."""


def refine(story: Story, data: Data, table: Table, iterations: int = 30, start: Solution | None = None) -> Solution:
    """Best-fitting states, contact times and coefficients for a story, without their covariance."""
    start = start or Solution(
        story, Friction(SLIDING_PRIOR[0], ROLLING_PRIOR[0]), 1.0, np.zeros(4), RUBBER.copy(), np.inf, UNKNOWN
    )
    bones, now = skeleton_of(story), numbers_of(start, story)
    damping, frame, settled = 1e-3, now, False
    linear = _linearise(bones, now, data, table, frame)
    for iteration in range(iterations):
        weight, cost = _robust(linear.residual, 2 * len(data.t))
        normal, gradient = _normal(linear, weight, bones.size)
        step = _solved(normal, -gradient, damping)
        if -float(gradient @ step) < GAIN_TO_GO_ON / 10 and frame is now:
            break
        for _ in range(8):
            trial = _moved(bones, now, step)
            if _in_order(bones, trial.t):
                further = _linearise(bones, trial, data, table, frame)
                new_cost = _robust(further.residual, 2 * len(data.t))[1]
                if new_cost < cost:
                    break
            damping = min(damping * 6 + 1e-4, 1e8)
            step = _solved(normal, -gradient, damping)
        else:
            break
        settled, before = cost - new_cost < GAIN_TO_GO_ON + 1e-5 * cost, settled
        now, linear = trial, further
        damping *= 0.15
        if settled and before and iteration > REFRESH:  # with standard deviations that have followed, too
            break
        if settled or iteration % REFRESH == REFRESH - 1:
            frame = now  # standard deviations that depend on speeds follow
            linear = _linearise(bones, now, data, table, frame)
    found = solution_with(start, story, now)
    return replace(found, chi2=_robust(linear.residual, 2 * len(data.t))[1], covariance=UNKNOWN)


def with_covariance(solution: Solution, data: Data, table: Table) -> Solution:
    """A refined solution with the covariance of all its numbers."""
    bones, now = skeleton_of(solution.story), numbers_of(solution, solution.story)
    linear = _linearise(bones, now, data, table, now)
    weight, _ = _robust(linear.residual, 2 * len(data.t))
    normal, _ = _normal(linear, weight, bones.size)
    return replace(solution, covariance=_solved(normal, np.eye(bones.size), 0.0))


def _solved(normal: FloatArray, right: FloatArray, damping: float) -> FloatArray:
    """Solution (P, ...) of damped normal equations (P, P), where nothing is known about a number too.

    Scaled to a unit diagonal, so that one ridge far above rounding makes every finite matrix invertible: contacts
    known to a nanosecond stand beside accelerations that nothing tells.
    """
    if not np.all(np.isfinite(normal)):
        raise np.linalg.LinAlgError("the normal equations of a fit hold numbers that are not finite")
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), LEAST_KNOWN))
    scaled = normal * scale * scale[:, None]
    scaled.flat[:: len(scaled) + 1] += damping + RIDGE
    _, found, failed = dposv(scaled.T, (right.T * scale).T, lower=1, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("the normal equations of a fit have no single solution")
    return np.asarray((found.T * scale).T, dtype=np.float64)


def _robust(residual: FloatArray, observed: int) -> tuple[FloatArray, float]:
    """Weights (rows,) and cost: Huber over the pairs of the first `observed` rows, squares for the rest."""
    size = np.linalg.norm(residual[:observed].reshape(-1, 2), axis=1)
    inner = np.minimum(size, HUBER)
    weight = np.ones(len(residual))
    weight[:observed] = np.repeat(inner / np.maximum(size, 1e-12), 2)
    weight[:observed][np.repeat(size == 0, 2)] = 1.0
    cost = float((2 * size * inner - inner**2).sum() + (residual[observed:] ** 2).sum())
    return weight, cost


def _normal(linear: _Linear, weight: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (P, P) and gradient (P,)."""
    observed = linear.slope.shape[0] * 2
    normal, gradient, known = np.zeros((size, size)), np.zeros(size), linear.known
    _add_known(known.residual, known.slope, known.column, known.first, normal, gradient)
    _accumulate(linear.slope, linear.columns, linear.residual[:observed], weight[:observed], normal, gradient)
    return normal, gradient


@compiled
def _add_known(residual, slope, column, first, normal, gradient):  # type: ignore[no-untyped-def]
    """Add what is known, see `models.estimation.joint_fit.physics_priors.Rows`, to the normal equations."""
    for row in range(len(residual)):
        for i in range(first[row], first[row + 1]):
            gradient[column[i]] += slope[i] * residual[row]
            for j in range(first[row], first[row + 1]):
                normal[column[i], column[j]] += slope[i] * slope[j]


@compiled
def _accumulate(slope, columns, residual, weight, normal, gradient):  # type: ignore[no-untyped-def]
    """Add what observations say, slope (K, 2, C) at columns (K, C), negative where unused, to the normal equations."""
    for k in range(slope.shape[0]):
        for axis in range(2):
            w, r = weight[2 * k + axis], residual[2 * k + axis]
            for i in range(slope.shape[2]):
                row = columns[k, i]
                if row < 0 or slope[k, axis, i] == 0.0:
                    continue
                scaled = w * slope[k, axis, i]
                gradient[row] += scaled * r
                for j in range(slope.shape[2]):
                    if columns[k, j] >= 0:
                        normal[row, columns[k, j]] += scaled * slope[k, axis, j]


def _moved(bones: Skeleton, now: Numbers, step: FloatArray) -> Numbers:
    """The numbers after a step (P,).

    No contact moves by more than 20 ms at once, nor most of the way to another one of its balls; no coefficient by
    more than a third.
    """
    moves = np.clip(step[bones.first_contact : bones.first_shared], -0.02, 0.02)
    _keep_apart(moves, bones, begins(bones, now.t), finishes(bones, now.t))
    shared, more = now.shared.copy(), step[bones.first_shared :]
    friction = shared[:DIAMETER] * np.exp(np.clip(more[:DIAMETER], -0.3, 0.3))
    shared[:DIAMETER] = np.clip(friction, *np.transpose([SLIDING_RANGE, ROLLING_RANGE]))
    shared[DIAMETER:] += more[DIAMETER:]
    return Numbers(_stepped(bones, now.state, step), now.t + moves, shared)


@compiled
def _stepped(bones, state, step):  # type: ignore[no-untyped-def]
    """States (S, 8) of spans after a step (P,)."""
    fresh = state.copy()
    for k in range(len(state)):
        for i in range(2 if bones.static[k] else STATE):
            fresh[k, i] += step[bones.column[k] + i]
    return fresh


@compiled
def _keep_apart(moves, bones, begin, finish):  # type: ignore[no-untyped-def]
    """Shorten the moves (C,) s of contacts until all spans last."""
    while True:
        share = np.ones(len(moves))
        for k in range(len(begin)):
            if bones.end[k] == NONE:
                continue
            lasts = finish[k] - begin[k]
            nearer = -moves[bones.end[k]]
            if bones.start[k] != NONE:
                nearer += moves[bones.start[k]]
            room = max(min(NEARER * lasts, lasts - 2 * SHORTEST), 0.0)
            if nearer > room + 1e-9:
                share[bones.end[k]] = min(share[bones.end[k]], 0.9 * room / nearer)
                if bones.start[k] != NONE:
                    share[bones.start[k]] = min(share[bones.start[k]], 0.9 * room / nearer)
        if np.all(share == 1.0):
            return
        moves *= share


def _in_order(bones: Skeleton, t: FloatArray) -> bool:
    """Do all spans last?"""
    return bool(np.all(finishes(bones, t) > begins(bones, t) + SHORTEST))


def _linearise(bones: Skeleton, now: Numbers, data: Data, table: Table, frame: Numbers) -> _Linear:
    """Whitened residuals and their derivatives: observations first, then what physics and priors say.

    Standard deviations that depend on speeds are taken from `frame`, so that steps compare like with like.
    """
    seen, slope, columns = _observations(bones, now, data.ball, data.t, data.xy, data.whiten)
    rows = known(bones, now, frame, table)
    return _Linear(np.concatenate([seen, rows.residual]), slope, columns, rows)


@compiled
def _observations(bones, now, ball, t, xy, whiten):  # type: ignore[no-untyped-def]
    """Whitened residuals (2K,), their derivatives (K, 2, 11) and their columns (K, 11), NONE where there is none."""
    begin = begins(bones, now.t)
    owner = owners_among(bones.ball, begin, ball, t)
    residual, slope = np.empty(2 * len(t)), np.zeros((len(t), 2, STATE + 3))
    columns = np.full((len(t), STATE + 3), NONE)
    slid, ds, value, d = np.empty(7), np.empty((7, STATE + 3)), np.empty(6), np.zeros((6, STATE + 3))
    for row in range(len(t)):
        k, w = owner[row], whiten[row]
        size = 2 if bones.static[k] else STATE
        if bones.static[k]:  # most balls rest most of the time
            value[:2], d[:2] = now.state[k, :2], 0.0
            d[0, 0] = d[1, 1] = 1.0
        else:
            tau = t[row] - begin[k]
            differentiate_one(now.state[k], tau, now.shared[SLIDING], now.shared[ROLLING], slid, ds, value, d)
            d[:, STATE] *= -1  # a later start is a shorter time since
            columns[row, STATE + 1], columns[row, STATE + 2] = bones.first_shared, bones.first_shared + 1
        if bones.start[k] != NONE and not bones.static[k]:
            columns[row, STATE] = bones.first_contact + bones.start[k]
        for i in range(size):
            columns[row, i] = bones.column[k] + i
        for axis in range(2):
            miss = value[:2] - xy[row]
            residual[2 * row + axis] = w[axis, 0] * miss[0] + w[axis, 1] * miss[1]
            slope[row, axis] = w[axis, 0] * d[0] + w[axis, 1] * d[1]
    return residual, slope, columns
