"""All spans, contacts and coefficients of a clip together: Levenberg-Marquardt with the physics as soft knowledge.

What the samples say is weighted by their noise and made robust (Huber); what physics says is in
`models.fitting.knowledge`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from models.billiards.motion import STATE, Friction, kinematics_jacobian
from models.fitting.knowledge import ROLLING_PRIOR, RUBBER, SLIDING_PRIOR, Knowledge, Rows
from models.fitting.solution import Data, Layout, Solution, layout, owners
from models.fitting.story import Story
from models.scene import Table

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

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

    residual: Floats
    """(2K + M,) in standard deviations: of the observations, then of what is known."""
    slope: Floats
    columns: Ints
    """(K, 2, 11) and (K, 11): of the observations, and at which of the P columns; -1 for none."""
    known: Rows
    """What physics and priors say."""


def refine(story: Story, data: Data, table: Table, iterations: int = 30, start: Solution | None = None) -> Solution:
    """Best-fitting states, contact times and coefficients for a story, without their covariance."""
    now = start or Solution(
        story, Friction(SLIDING_PRIOR[0], ROLLING_PRIOR[0]), 1.0, np.zeros(4), RUBBER.copy(), np.inf, UNKNOWN
    )
    now = replace(now, story=story)
    plan = layout(story)
    damping, frame, settled = 1e-3, now, False
    linear = _linearise(now, plan, data, table, frame)
    for iteration in range(iterations):
        weight, cost = _robust(linear.residual, 2 * len(data.t))
        normal, gradient = _normal(linear, weight, plan.size)
        step = _solved(normal, -gradient, damping)
        if -float(gradient @ step) < GAIN_TO_GO_ON / 10 and frame is now:
            break
        for _ in range(8):
            trial = _moved(now, plan, _limited(step, plan, now.story))
            if _in_order(trial.story):
                further = _linearise(trial, plan, data, table, frame)
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
            linear = _linearise(now, plan, data, table, frame)
    return replace(now, chi2=_robust(linear.residual, 2 * len(data.t))[1], covariance=UNKNOWN)


def with_covariance(solution: Solution, data: Data, table: Table) -> Solution:
    """A refined solution with the covariance of all its numbers."""
    plan = layout(solution.story)
    linear = _linearise(solution, plan, data, table, solution)
    weight, _ = _robust(linear.residual, 2 * len(data.t))
    normal, _ = _normal(linear, weight, plan.size)
    return replace(solution, covariance=_solved(normal, np.eye(plan.size), 0.0))


def _solved(normal: Floats, right: Floats, damping: float) -> Floats:
    """Solution (P, ...) of damped normal equations (P, P), where nothing is known about a number too.

    Scaled to a unit diagonal, so that one ridge far above rounding makes every finite matrix invertible: contacts
    known to a nanosecond stand beside accelerations that nothing tells.
    """
    if not np.all(np.isfinite(normal)):
        raise np.linalg.LinAlgError("the normal equations of a fit hold numbers that are not finite")
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), LEAST_KNOWN))
    scaled = normal * scale * scale[:, None]
    scaled[np.diag_indices_from(scaled)] += damping + RIDGE
    right = right.T * scale
    return np.asarray((cho_solve(cho_factor(scaled), right.T).T * scale).T, dtype=np.float64)


def _robust(residual: Floats, observed: int) -> tuple[Floats, float]:
    """Weights (rows,) and cost: Huber over the pairs of the first `observed` rows, squares for the rest."""
    size = np.linalg.norm(residual[:observed].reshape(-1, 2), axis=1)
    inner = np.minimum(size, HUBER)
    weight = np.ones(len(residual))
    weight[:observed] = np.repeat(inner / np.maximum(size, 1e-12), 2)
    weight[:observed][np.repeat(size == 0, 2)] = 1.0
    cost = float((2 * size * inner - inner**2).sum() + (residual[observed:] ** 2).sum())
    return weight, cost


def _normal(linear: _Linear, weight: Floats, size: int) -> tuple[Floats, Floats]:
    """Normal matrix (P, P) and gradient (P,)."""
    observed = linear.slope.shape[0] * 2
    normal, gradient, known = np.zeros((size, size)), np.zeros(size), linear.known
    _add_known(known.residual, known.slope, known.column, known.first, normal, gradient)
    _accumulate(linear.slope, linear.columns, linear.residual[:observed], weight[:observed], normal, gradient)
    return normal, gradient


@njit(cache=True, error_model="numpy")
def _add_known(residual, slope, column, first, normal, gradient):  # type: ignore[no-untyped-def]
    """Add what is known, see `models.fitting.knowledge.Rows`, to the normal equations."""
    for row in range(len(residual)):
        for i in range(first[row], first[row + 1]):
            gradient[column[i]] += slope[i] * residual[row]
            for j in range(first[row], first[row + 1]):
                normal[column[i], column[j]] += slope[i] * slope[j]


@njit(cache=True, error_model="numpy")
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


def _limited(step: Floats, plan: Layout, story: Story) -> Floats:
    """No contact moves by more than 20 ms at once, nor most of the way to another one of its balls; no coefficient by
    more than a third."""
    limited = step.copy()
    moves = limited[plan.contact : plan.globals]  # a view
    np.clip(moves, -0.02, 0.02, out=moves)
    limited[plan.globals : plan.globals + 2] = np.clip(step[plan.globals : plan.globals + 2], -0.3, 0.3)
    while shorter := _too_near(moves, story):
        for contact, share in shorter.items():
            moves[contact] *= share
    return limited


def _too_near(moves: Floats, story: Story) -> dict[int, float]:
    """By which share the moves (C,) s of contacts have to be less, for all spans to last."""
    shares: dict[int, float] = {}
    for number, span in enumerate(story.spans):
        if span.end is None:
            continue
        lasts = story.finish(number) - story.begin(number)
        nearer = (0.0 if span.start is None else moves[span.start]) - moves[span.end]
        room = max(min(NEARER * lasts, lasts - 2 * SHORTEST), 0.0)
        if nearer > room + 1e-9:
            for contact in (span.start, span.end):
                if contact is not None:
                    shares[contact] = min(shares.get(contact, 1.0), 0.9 * room / nearer)
    return shares


def _moved(solution: Solution, plan: Layout, step: Floats) -> Solution:
    spans = []
    for span, first in zip(solution.story.spans, plan.span, strict=True):
        size = 2 if span.static else STATE
        state = span.state.copy()
        state[:size] += step[first : first + size]
        spans.append(replace(span, state=state))
    contacts = tuple(replace(c, t=c.t + float(step[plan.contact + k])) for k, c in enumerate(solution.story.contacts))
    g = step[plan.globals :]
    friction = Friction(
        float(np.clip(solution.friction.sliding * np.exp(g[0]), *SLIDING_RANGE)),
        float(np.clip(solution.friction.rolling * np.exp(g[1]), *ROLLING_RANGE)),
    )
    return replace(
        solution, story=Story(tuple(spans), contacts), friction=friction,
        diameter=solution.diameter + float(g[2]), nose=solution.nose + g[3:7],
        rubber=solution.rubber + g[7:10],
    )  # fmt: skip


def _in_order(story: Story) -> bool:
    return all(story.finish(k) > story.begin(k) + SHORTEST for k in range(len(story.spans)))


def _linearise(now: Solution, plan: Layout, data: Data, table: Table, frame: Solution) -> _Linear:
    """Whitened residuals and their derivatives: observations first, then what physics and priors say.

    Standard deviations that depend on speeds are taken from `frame`, so that steps compare like with like.
    """
    seen, slope, columns = _observations(now, plan, data)
    known = Knowledge(now, frame, plan, table)
    for number in range(len(now.story.contacts)):
        known.contact(number)
    for number in range(len(now.story.spans)):
        known.span(number)
    known.coefficients()
    rows = known.rows()
    return _Linear(np.concatenate([seen, rows.residual]), slope, columns, rows)


def _observations(now: Solution, plan: Layout, data: Data) -> tuple[Floats, Floats, Ints]:
    """Whitened residuals (2K,), their derivatives (K, 2, 11) and at which columns these stand (K, 11), -1 for none."""
    story = now.story
    owner = owners(story, data)
    begins = np.array([story.begin(k) for k in range(len(story.spans))])
    static = np.array([span.static for span in story.spans])[owner]
    states = np.array([span.state for span in story.spans])[owner]
    value = states[:, :2].copy()
    slope = np.zeros((len(owner), 2, STATE + 3))
    slope[static, 0, 0] = slope[static, 1, 1] = 1.0
    runs = ~static  # most balls rest most of the time
    moved, moved_slope = kinematics_jacobian(states[runs], (data.t - begins[owner])[runs], now.friction)
    value[runs], slope[runs] = moved[:, :2], moved_slope[:, :2]
    whitened = np.einsum("kij,kj->ki", data.whiten, value - data.xy)
    slope = data.whiten @ slope
    slope[:, :, STATE] *= -1  # a later start is a shorter time since
    starts = np.array([-1 if span.start is None else plan.contact + span.start for span in story.spans])[owner]
    columns = np.empty((len(owner), STATE + 3), np.int64)
    columns[:, :STATE] = plan.span[owner, None] + np.arange(STATE)
    columns[:, STATE] = starts
    columns[:, STATE + 1 :] = plan.globals + np.arange(2)
    columns[static, 2:] = -1
    return whitened.reshape(-1), slope, columns
