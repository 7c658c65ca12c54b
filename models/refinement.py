"""All spans, contacts and coefficients of a clip together: Levenberg-Marquardt with the physics as soft knowledge.

Real cushions and cloths obey no single law, so laws enter as pseudo-observations with honest standard deviations:
paths are continuous, balls touch at two radii, cushions at one, equal masses share momentum, spin survives a contact
with another ball. What the samples say is weighted by their noise and made robust (Huber).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from models.billiards.motion import STATE, Friction, kinematics, kinematics_jacobian
from models.contacts import INWARD, cushion_distances
from models.scene import CUSHIONS, Table
from models.story import Contact, Story
from models.tracks import Tracks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SLIDING_PRIOR = (0.2, 0.25)
"""mu_sliding and the standard deviation of its logarithm: 0.15 to 0.25 on worn and new cloth (Alciatore 2024)."""
ROLLING_PRIOR = (0.010, 0.4)
"""mu_rolling and the standard deviation of its logarithm: 0.005 to 0.015."""
SLIDING_RANGE, ROLLING_RANGE = (0.05, 0.5), (0.002, 0.04)
"""What no cloth exceeds, polished or wet."""
DIAMETER_SIGMA = 0.02
"""relative: one factor per clip on the distance of touching balls, for what the calibration misses."""
NOSE_SIGMA = 0.004
"""m: one offset per cushion, for what the calibration misses and the rubber gives."""
EXTRA_SIGMA = 0.02
"""m/s^2 per axis: slope, nap and drag, per span."""
SLIP_SIGMA = 0.7
"""slip after a strike, over the speed."""
CONTINUITY_SIGMA = 2e-4
"""m: paths do not jump at contacts."""
TOUCH_SIGMA = 8e-4
"""m: scatter of the distance of touching balls."""
NOSE_SCATTER = 1.5e-3
"""m: scatter of where balls meet a nose."""
BALL_RESTITUTION = (0.94, 0.05)
CUSHION_RESTITUTION = (0.75, 0.2)
"""mean and standard deviation; wide, since laws differ."""
GAIN_TO_GO_ON = 0.03
"""chi2 that an iteration must gain: far below what matters."""
REFRESH = 4
"""iterations between updates of the standard deviations that depend on speeds."""
HUBER = 2.5
"""standard deviations where the loss turns linear."""
_LONE = 5.0
"""m/s: prior standard deviation of a velocity."""


@dataclass(frozen=True, slots=True)
class Data:
    """What was seen, one row per observation, sorted by ball and time."""

    ball: Ints
    t: Floats
    xy: Floats
    whiten: Floats
    """(K, 2, 2): takes a residual in m to standard deviations."""


@dataclass(frozen=True, slots=True)
class Solution:
    """A refined story."""

    story: Story
    friction: Friction
    diameter: float
    """factor on two radii."""
    nose: Floats
    """(4,) m, where centres turn, beyond one radius from each nose; > 0 towards the table."""
    chi2: float
    """robust, with pseudo-observations."""
    covariance: Floats
    """(P, P) of the packed parameters, see `Layout`."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where each number stands in the packed vector."""

    span: Ints
    """(S,) first column; a static span has two numbers, a moving one eight."""
    contact: int
    """column of the time of the first contact."""
    globals: int
    """ln mu_sliding, ln mu_rolling, diameter, four noses."""
    size: int


def gather(tracks: Tracks) -> Data:
    """Observations of all balls."""
    frame, ball = np.nonzero(tracks.observed)
    order = np.lexsort((frame, ball))
    frame, ball = frame[order], ball[order]
    streak = tracks.streak[frame, ball]
    length = np.linalg.norm(streak, axis=1)
    along = np.where(length[:, None] > 0, streak / np.maximum(length, 1e-12)[:, None], np.array([1.0, 0.0]))
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    sigma = np.stack([tracks.sigma_along[frame, ball], tracks.sigma[frame, ball]], axis=1)
    whiten = np.stack([along, across], axis=1) / sigma[:, :, None]
    return Data(ball.astype(np.int64), tracks.t[frame], tracks.xy[frame, ball], whiten)


def layout(story: Story) -> Layout:
    """Columns of the packed parameters of a story."""
    sizes = np.array([2 if span.static else STATE for span in story.spans], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    contact = int(starts[-1])
    return Layout(starts[:-1], contact, contact + len(story.contacts), contact + len(story.contacts) + 7)


def refine(story: Story, data: Data, table: Table, iterations: int = 30, start: Solution | None = None) -> Solution:
    """Best-fitting states, contact times and coefficients for a story; the covariance is taken at the end."""
    now = start or Solution(
        story, Friction(SLIDING_PRIOR[0], ROLLING_PRIOR[0]), 1.0, np.zeros(4), np.inf, np.empty((0, 0))
    )
    now = replace(now, story=story)
    plan = layout(story)
    damping, frame = 1e-3, now
    residual, jacobian = _linearise(now, plan, data, table, frame)
    for iteration in range(iterations):
        weight, cost = _robust(residual, 2 * len(data.t))
        normal, gradient = _normal(jacobian, residual, weight)
        for _ in range(8):
            diagonal = np.maximum(np.diag(normal), 1e-6)
            step = cho_solve(cho_factor(normal + np.diag(damping * diagonal)), -gradient)
            trial = _moved(now, plan, _limited(step, plan))
            if _in_order(trial.story):
                linear = _linearise(trial, plan, data, table, frame)
                new_cost = _robust(linear[0], 2 * len(data.t))[1]
                if new_cost < cost:
                    break
            damping = min(damping * 6 + 1e-4, 1e8)
        else:
            break
        settled = cost - new_cost < GAIN_TO_GO_ON + 1e-5 * cost
        now, (residual, jacobian) = trial, linear
        damping *= 0.15
        if settled and iteration > REFRESH:
            break
        if settled or iteration % REFRESH == REFRESH - 1:
            frame = now  # standard deviations that depend on speeds follow
            residual, jacobian = _linearise(now, plan, data, table, frame)
    weight, cost = _robust(residual, 2 * len(data.t))
    normal, _ = _normal(jacobian, residual, weight)
    covariance = np.linalg.inv(normal + np.diag(np.full(plan.size, 1e-9)))
    return replace(now, chi2=cost, covariance=covariance)


def owners(story: Story, data: Data) -> Ints:
    """Which span each observation belongs to, by time (K,)."""
    owner = np.zeros(len(data.t), np.int64)
    for ball in np.unique(data.ball):
        rows = np.flatnonzero(data.ball == ball)
        spans = story.of_ball(int(ball))
        begins = np.array([story.begin(k) for k in spans])
        place = np.clip(np.searchsorted(begins, data.t[rows] + 1e-12, side="right") - 1, 0, None)
        owner[rows] = np.array(spans)[place]
    return owner


def residuals(solution: Solution, data: Data) -> Floats:
    """Measured minus fitted (K, 2) in m."""
    story = solution.story
    owner = owners(story, data)
    begins = np.array([story.begin(k) for k in range(len(story.spans))])
    states = np.array([span.state for span in story.spans])[owner]
    fitted = kinematics(states, data.t - begins[owner], solution.friction)[:, :2]
    static = np.array([span.static for span in story.spans])[owner]
    return data.xy - np.where(static[:, None], states[:, :2], fitted)


def _robust(residual: Floats, observed: int) -> tuple[Floats, float]:
    """Weights (rows,) and cost: Huber over the pairs of the first `observed` rows, squares for the rest."""
    size = np.linalg.norm(residual[:observed].reshape(-1, 2), axis=1)
    inner = np.minimum(size, HUBER)
    weight = np.ones(len(residual))
    weight[:observed] = np.repeat(inner / np.maximum(size, 1e-12), 2)
    weight[:observed][np.repeat(size == 0, 2)] = 1.0
    cost = float((2 * size * inner - inner**2).sum() + (residual[observed:] ** 2).sum())
    return weight, cost


def _normal(jacobian: sparse.csr_matrix, residual: Floats, weight: Floats) -> tuple[Floats, Floats]:
    weighted = jacobian.multiply(weight[:, None]).tocsr()
    return (jacobian.T @ weighted).toarray(), weighted.T @ residual


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
    )  # fmt: skip


def _in_order(story: Story) -> bool:
    return all(story.finish(k) > story.begin(k) + 1e-4 for k in range(len(story.spans)))


def _linearise(
    now: Solution, plan: Layout, data: Data, table: Table, frame: Solution
) -> tuple[Floats, sparse.csr_matrix]:
    """Whitened residuals (rows,) and their Jacobian: observations first, then what physics and priors say.

    Standard deviations that depend on speeds are taken from `frame`, so that steps compare like with like.
    """
    seen, seen_rows = _observations(now, plan, data)
    known = _Knowledge(now, frame, plan, table)
    for number in range(len(now.story.contacts)):
        known.contact(number)
    for number in range(len(now.story.spans)):
        known.span(number)
    known.coefficients()
    return np.concatenate([seen, known.values()]), sparse.vstack([seen_rows, known.rows()], format="csr")


def _observations(now: Solution, plan: Layout, data: Data) -> tuple[Floats, sparse.csr_matrix]:
    story = now.story
    owner = owners(story, data)
    begins = np.array([story.begin(k) for k in range(len(story.spans))])
    static = np.array([span.static for span in story.spans])[owner]
    states = np.array([span.state for span in story.spans])[owner]
    value, slope = kinematics_jacobian(states, data.t - begins[owner], now.friction)
    value, slope = value[:, :2].copy(), slope[:, :2].copy()  # (K, 2), (K, 2, 11)
    value[static] = states[static, :2]
    slope[static] = 0.0
    slope[static, 0, 0] = slope[static, 1, 1] = 1.0
    whitened = np.einsum("kij,kj->ki", data.whiten, value - data.xy)
    slope = np.einsum("kij,kjp->kip", data.whiten, slope)
    starts = np.array([-1 if span.start is None else plan.contact + span.start for span in story.spans])[owner]
    columns = np.column_stack(
        [
            plan.span[owner, None] + np.arange(STATE),
            starts,
            np.full(len(owner), plan.globals),
            np.full(len(owner), plan.globals + 1),
        ]
    )
    slope[:, :, STATE] *= -1  # a later start is a shorter time since
    used = np.ones_like(columns, bool)
    used[static, 2:] = False
    used[starts < 0, STATE] = False
    rows = np.arange(2 * len(owner)).reshape(-1, 2, 1)
    keep = np.broadcast_to(used[:, None, :], slope.shape)
    row = np.broadcast_to(rows, slope.shape)[keep]
    column = np.broadcast_to(columns[:, None, :], slope.shape)[keep]
    matrix = sparse.csr_matrix((slope[keep], (row, column)), shape=(2 * len(owner), plan.size))
    return whitened.reshape(-1), matrix


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A vector (d,) and its derivatives (d, P)."""

    value: Floats
    slope: Floats

    def __add__(self, other: _Quantity) -> _Quantity:
        return _Quantity(self.value + other.value, self.slope + other.slope)

    def __sub__(self, other: _Quantity) -> _Quantity:
        return _Quantity(self.value - other.value, self.slope - other.slope)

    def times(self, matrix: Floats) -> _Quantity:
        """Left-multiplied by a constant matrix (m, d)."""
        return _Quantity(matrix @ self.value, matrix @ self.slope)


class _Knowledge:
    """Rows of pseudo-observations, collected one law at a time."""

    def __init__(self, now: Solution, frame: Solution, plan: Layout, table: Table) -> None:
        self.now, self.frame, self.plan, self.table = now, frame, plan, table
        self._value: list[Floats] = []
        self._slope: list[Floats] = []
        self._ends = self._at_ends(now)
        self._frame_ends = self._at_ends(frame)[0] if frame is not now else self._ends[0]

    def values(self) -> Floats:
        return np.concatenate(self._value)

    def rows(self) -> sparse.csr_matrix:
        return sparse.csr_matrix(np.concatenate(self._slope))

    def contact(self, number: int) -> None:
        """What is known about one contact."""
        contact = self.now.story.contacts[number]
        before = [self._end(k) for k in contact.before]
        after = [self._start(k) for k in contact.after]
        if contact.kind == "jump":
            self._say(self._time(number), np.array([0.01]))
            return
        for one, two in zip(before, after, strict=True):
            self._say(one.times(_X) - two.times(_X), np.full(2, CONTINUITY_SIGMA))
        if contact.kind == "ball":
            self._touch(contact, before, after)
        elif contact.kind == "cushion":
            self._bounce(contact, before[0], after[0])

    def span(self, number: int) -> None:
        """Slip, extra acceleration and velocity have priors; the slip after a ball contact is told there."""
        span = self.now.story.spans[number]
        if span.static:
            return
        start = self._start(number)
        speed = float(np.hypot(*self.frame.story.spans[number].state[2:4]))
        self._say(start.times(_V), np.full(2, _LONE))
        self._say(start.times(_C), np.full(2, EXTRA_SIGMA))
        self._say(start.times(_U), np.full(2, SLIP_SIGMA * speed + 0.2))

    def coefficients(self) -> None:
        """Priors of what all spans share."""
        identity = np.eye(self.plan.size)[self.plan.globals :]
        friction = self.now.friction
        value = np.concatenate(
            [[np.log(friction.sliding / SLIDING_PRIOR[0]), np.log(friction.rolling / ROLLING_PRIOR[0])],
             [self.now.diameter - 1], self.now.nose]
        )  # fmt: skip
        sigma = np.array([SLIDING_PRIOR[1], ROLLING_PRIOR[1], DIAMETER_SIGMA, *[NOSE_SIGMA] * 4])
        self._say(_Quantity(value, identity), sigma)

    def _touch(self, contact: Contact, before: list[_Quantity], after: list[_Quantity]) -> None:
        """Two balls: distance, momentum, restitution, little friction, spin that survives."""
        apart = after[1].times(_X) - after[0].times(_X)
        distance = float(np.hypot(*apart.value))
        normal = apart.value / max(distance, 1e-9)
        frame_apart = self._state(contact.after[1])[:2] - self._state(contact.after[0])[:2]
        n = frame_apart / max(float(np.hypot(*frame_apart)), 1e-9)
        reach = 2 * self.table.ball_radius
        slope = normal @ apart.slope
        slope[self.plan.globals + 2] -= reach
        self._say(_Quantity(np.array([distance - reach * self.now.diameter]), slope[None]), np.array([TOUCH_SIGMA]))
        if contact.driven:
            return
        tangent = np.array([[-n[1], n[0]]])
        changes = [two - one for one, two in zip(before, after, strict=True)]
        closing = float((self._frame_ends[contact.before[0]][2:4] - self._frame_ends[contact.before[1]][2:4]) @ n)
        hit = max(abs(closing), 0.02)
        momentum = changes[0].times(_V) + changes[1].times(_V)
        self._say(momentum, np.full(2, 0.03 * hit + 0.01))
        back = (after[1] - after[0]).times(_V).times(n[None]) + (before[1] - before[0]).times(_V).times(
            n[None] * BALL_RESTITUTION[0]
        )
        self._say(back, np.array([BALL_RESTITUTION[1] * hit + 0.01]))
        for change in changes:
            self._say(change.times(_V).times(tangent), np.array([0.06 * hit + 0.01]))
            self._say(change.times(_U) - change.times(_V), np.full(2, 0.12 * hit + 0.03))

    def _bounce(self, contact: Contact, before: _Quantity, after: _Quantity) -> None:
        """A cushion: distance, restitution, some friction, spin that partly survives."""
        side = CUSHIONS.index(contact.cushion)
        n = INWARD[side][None]
        tangent = np.array([[-n[0, 1], n[0, 0]]])
        distance = cushion_distances(after.value[:2], self.table)[side] - self.table.ball_radius - self.now.nose[side]
        slope = n @ after.times(_X).slope
        slope[0, self.plan.globals + 3 + side] -= 1
        self._say(_Quantity(np.array([distance]), slope), np.array([NOSE_SCATTER]))
        velocity = self._frame_ends[contact.before[0]][2:4]
        hit, pace = max(float(-(n @ velocity)[0]), 0.02), float(np.hypot(*velocity))
        mean, spread = CUSHION_RESTITUTION
        self._say(after.times(_V).times(n) + before.times(_V).times(n * mean), np.array([spread * hit + 0.02]))
        change = after - before
        self._say(change.times(_V).times(tangent), np.array([0.25 * pace + 0.02]))
        self._say(change.times(_U) - change.times(_V), np.full(2, 0.5 * pace + 0.05))

    def _time(self, number: int) -> _Quantity:
        """Of a contact, relative to where it stands: nothing else holds the time of a jump."""
        slope = np.zeros((1, self.plan.size))
        slope[0, self.plan.contact + number] = 1.0
        moved = self.now.story.contacts[number].t - self.frame.story.contacts[number].t
        return _Quantity(np.array([moved]), slope)

    def _say(self, quantity: _Quantity, sigma: Floats) -> None:
        self._value.append(quantity.value / sigma)
        self._slope.append(quantity.slope / sigma[:, None])

    def _state(self, span: int) -> Floats:
        return self.frame.story.spans[span].state

    def _start(self, span: int) -> _Quantity:
        """State at the start (8,)."""
        described = self.now.story.spans[span]
        slope = np.zeros((STATE, self.plan.size))
        size = 2 if described.static else STATE
        first = self.plan.span[span]
        slope[np.arange(size), first + np.arange(size)] = 1.0
        return _Quantity(described.state, slope)

    def _end(self, span: int) -> _Quantity:
        """State at the end (8,); the extra acceleration is of no interest there and zero."""
        described = self.now.story.spans[span]
        value, slope = np.zeros(STATE), np.zeros((STATE, self.plan.size))
        first = self.plan.span[span]
        if described.static:
            value[:2] = described.state[:2]
            slope[[0, 1], [first, first + 1]] = 1.0
            return _Quantity(value, slope)
        ends, slopes, index = self._ends
        value[:6] = ends[span]
        local = slopes[index[span]]  # (6, 11)
        slope[:6, first : first + STATE] = local[:, :STATE]
        slope[:6, self.plan.globals : self.plan.globals + 2] = local[:, STATE + 1 :]
        if described.end is not None:
            slope[:6, self.plan.contact + described.end] += local[:, STATE]
        if described.start is not None:
            slope[:6, self.plan.contact + described.start] -= local[:, STATE]
        return _Quantity(value, slope)

    @staticmethod
    def _at_ends(solution: Solution) -> tuple[Floats, Floats, dict[int, int]]:
        """Position, velocity, slip (S, 6) of all spans at their ends, with Jacobians of the moving ones."""
        story = solution.story
        moving = [k for k, span in enumerate(story.spans) if not span.static and span.end is not None]
        ends = np.zeros((len(story.spans), 6))
        for k, span in enumerate(story.spans):
            ends[k, :2] = span.state[:2]
        if not moving:
            return ends, np.empty((0, 6, STATE + 3)), {}
        states = np.array([story.spans[k].state for k in moving])
        tau = np.array([story.finish(k) - story.begin(k) for k in moving])
        ends[moving], slopes = kinematics_jacobian(states, tau, solution.friction)
        return ends, slopes, {k: row for row, k in enumerate(moving)}


_X, _V, _U, _C = (np.eye(STATE)[k : k + 2] for k in (0, 2, 4, 6))
