"""All spans, contacts and coefficients of a clip together: Levenberg-Marquardt with the physics as soft knowledge.

What the samples say is weighted by their noise and made robust (Huber); what physics says is in `models.knowledge`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from models.billiards.motion import STATE, Friction, kinematics_jacobian
from models.knowledge import ROLLING_PRIOR, RUBBER, SLIDING_PRIOR, Knowledge
from models.scene import Table
from models.solution import Data, Layout, Solution, layout, owners
from models.story import Story

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
SPARSE = 150
"""columns from which on the rows of what is known are squared as a sparse matrix."""
HUBER = 2.5
"""standard deviations where the loss turns linear."""


@dataclass(frozen=True, slots=True)
class _Linear:
    """Residuals and their derivatives at one place."""

    residual: Floats
    """(2K + M,) in standard deviations."""
    slope: Floats
    columns: Ints
    """(K, 2, 11) and (K, 11): of the observations, and at which of the P columns; -1 for none."""
    known: Floats
    """(M, P) of what physics and priors say."""


def refine(story: Story, data: Data, table: Table, iterations: int = 30, start: Solution | None = None) -> Solution:
    """Best-fitting states, contact times and coefficients for a story; the covariance is taken at the end."""
    now = start or Solution(
        story, Friction(SLIDING_PRIOR[0], ROLLING_PRIOR[0]), 1.0, np.zeros(4), RUBBER.copy(), np.inf, np.empty((0, 0))
    )
    now = replace(now, story=story)
    plan = layout(story)
    damping, frame = 1e-3, now
    linear = _linearise(now, plan, data, table, frame)
    for iteration in range(iterations):
        weight, cost = _robust(linear.residual, 2 * len(data.t))
        normal, gradient = _normal(linear, weight)
        for _ in range(8):
            step = _solved(normal, -gradient, damping)
            trial = _moved(now, plan, _limited(step, plan))
            if _in_order(trial.story):
                further = _linearise(trial, plan, data, table, frame)
                new_cost = _robust(further.residual, 2 * len(data.t))[1]
                if new_cost < cost:
                    break
            damping = min(damping * 6 + 1e-4, 1e8)
        else:
            break
        settled = cost - new_cost < GAIN_TO_GO_ON + 1e-5 * cost
        now, linear = trial, further
        damping *= 0.15
        if settled and iteration > REFRESH:
            break
        if settled or iteration % REFRESH == REFRESH - 1:
            frame = now  # standard deviations that depend on speeds follow
            linear = _linearise(now, plan, data, table, frame)
    weight, cost = _robust(linear.residual, 2 * len(data.t))
    normal, _ = _normal(linear, weight)
    return replace(now, chi2=cost, covariance=_solved(normal, np.eye(plan.size), 0.0))


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


def _normal(linear: _Linear, weight: Floats) -> tuple[Floats, Floats]:
    """Normal matrix (P, P) and gradient (P,)."""
    size = linear.known.shape[1]
    observed = linear.slope.shape[0] * 2
    known = sparse.csr_matrix(linear.known) if size > SPARSE else linear.known
    square = known.T @ known
    normal = np.ascontiguousarray(square if isinstance(square, np.ndarray) else square.toarray())
    gradient = known.T @ linear.residual[observed:]
    _accumulate(linear.slope, linear.columns, linear.residual[:observed], weight[:observed], normal, gradient)
    return normal, gradient


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


def _limited(step: Floats, plan: Layout) -> Floats:
    """No contact moves by more than 20 ms at once, no coefficient by more than a third."""
    limited = step.copy()
    limited[plan.contact : plan.globals] = np.clip(step[plan.contact : plan.globals], -0.02, 0.02)
    limited[plan.globals : plan.globals + 2] = np.clip(step[plan.globals : plan.globals + 2], -0.3, 0.3)
    return limited


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
    return all(story.finish(k) > story.begin(k) + 1e-4 for k in range(len(story.spans)))


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
    return _Linear(np.concatenate([seen, known.values()]), slope, columns, known.rows())


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
