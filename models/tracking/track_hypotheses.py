"""Multiple-hypothesis tracking with delayed decisions (Reid 1979, doi:10.1109/TAC.1979.1102177).

Every hypothesis (`TrackHypothesis`) holds all balls with place and velocity. For each new frame it predicts its balls
(straight on, or through contacts with cushions and each other), evaluates the cost of every detection for every ball,
and takes the cheapest assignment and the cheapest swaps of two balls beside it. Hypotheses that explain the following
frames badly die out; after `patience` seconds the best one decides. The branching is over swaps instead of Murty's full
ranking.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from models.core.progress import Progress, ignore_progress
from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.tracking.assignment_cost import (
    CONFIRMED_HITS,
    FREE,
    OUTLIER,
    OUTLIER_RADII,
    PREDICTED_CONTACT,
    STRUCK,
    UNPREDICTED_CONTACT,
    AssignmentCosts,
    TrackHypothesis,
    evaluate_assignment_costs,
    unit_vectors,
)
from models.tracking.table_detections import TableDetections

# m/s per axis, one standard deviation: velocity of a ball that appears at rest, as most do.
NEW_BALL_SPEED_SIGMA = 0.1
# Squared normalized innovation above which the velocity variance grows (8 % of good detections).
SUSPICIOUS_CHI2 = 5.0
# Cost of a ball that appears after the first moments: balls do not, except from under a hand.
LATE_BIRTH_COST = 7.0
# Share of a predicted but unobserved velocity change that is added to the velocity sigma.
LATE_CONTACT_SHARE = 0.3
# Largest extra cost of an assignment over the best one.
MAX_BRANCH_COST = 14.0
_IMPOSSIBLE = 1e6


def track_balls(
    detections: TableDetections,
    t: FloatArray,
    table: Table,
    breadth: int,
    patience: float,
    progress: Progress = ignore_progress,
) -> list[tuple[IntArray, IntArray]]:
    """Track balls and return tracklets as (frame indices (M,), detections (M,)), in the order of their birth."""
    hypotheses = [_empty_hypothesis()]
    labels = 0
    window = max(3, round(patience / float(np.median(np.diff(t)))))
    for k in range(len(t)):
        now = np.arange(detections.first[k], detections.first[k + 1])
        dt = float(t[k] - t[k - 1]) if k else 0.0
        early = float(t[k] - t[0]) < 0.4
        hypotheses, labels = _advance_hypotheses(hypotheses, detections, now, dt, early, table, breadth, labels)
        hypotheses = _prune_hypotheses(hypotheses, window)
        progress((k + 1) / len(t))
    return _collect_tracklets(hypotheses[0], len(t))


def _empty_hypothesis() -> TrackHypothesis:
    """Make the hypothesis without balls."""
    empty = np.empty(0, np.int64)
    return TrackHypothesis(
        empty, np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), empty, empty, empty
    )


def _advance_hypotheses(
    hypotheses: list[TrackHypothesis],
    detections: TableDetections,
    now: IntArray,
    dt: float,
    early: bool,
    table: Table,
    breadth: int,
    labels: int,
) -> tuple[list[TrackHypothesis], int]:
    """Extend the hypotheses by one frame and return the best ones, best first."""
    all_costs = [evaluate_assignment_costs(hypothesis, detections, now, dt, table) for hypothesis in hypotheses]
    choices: list[tuple[float, int, IntArray]] = []
    for index, (hypothesis, hypothesis_costs) in enumerate(zip(hypotheses, all_costs, strict=True)):
        for cost, chosen in _list_assignments(hypothesis, hypothesis_costs, breadth):
            choices.append((hypothesis.cost + cost, index, chosen))
    choices.sort(key=lambda choice: choice[:2])
    limit = choices[0][0] + 25.0
    children = []
    for cost, index, chosen in choices[:breadth]:
        if cost <= limit:
            child = _update_hypothesis(
                hypotheses[index], all_costs[index], chosen, detections, now, dt, early, table, labels
            )
            child.cost += cost
            children.append(child)
    children.sort(key=lambda hypothesis: hypothesis.cost)
    return children, max([labels] + [int(r.label.max()) + 1 for r in children if len(r.label)])


def _list_assignments(
    hypothesis: TrackHypothesis, costs: AssignmentCosts, breadth: int
) -> list[tuple[float, IntArray]]:
    """List the cheapest assignment (N,) of detections (-1 for none), and the cheapest swaps of two balls beside it."""
    n, k = costs.cost.shape
    if not n:
        return [(0.0, np.empty(0, np.int64))]
    full = np.full((n, k + n), _IMPOSSIBLE)
    full[:, :k] = np.minimum(costs.cost, _IMPOSSIBLE)
    full[np.arange(n), k + np.arange(n)] = costs.missed_cost
    rows, columns = linear_sum_assignment(full)
    chosen = np.where(columns < k, columns, -1)
    cost = float(full[rows, columns].sum())
    result = [(cost, chosen)]
    if breadth > 1:
        result += _list_departures(hypothesis, costs, chosen, cost)
    detected = np.flatnonzero((chosen >= 0) & hypothesis.is_confirmed)
    if breadth > 1 and len(detected) > 1:
        swap = costs.cost[np.ix_(detected, chosen[detected])]
        own = np.diag(swap)
        delta = swap + swap.T - own[:, None] - own[None]
        delta[np.tril_indices(len(detected))] = np.inf
        for flat in np.argsort(delta, axis=None, kind="stable")[:4]:
            i, j = divmod(int(flat), len(detected))
            if delta[i, j] > MAX_BRANCH_COST:
                break
            other = chosen.copy()
            other[detected[i]], other[detected[j]] = chosen[detected[j]], chosen[detected[i]]
            result.append((cost + float(delta[i, j]), other))
    return result


def _list_departures(
    hypothesis: TrackHypothesis, costs: AssignmentCosts, chosen: IntArray, cost: float
) -> list[tuple[float, IntArray]]:
    """List rare alternatives to an assignment: an undetected ball takes a detection that no ball took.

    Two may do so: a ball that was struck behind a hand, and the one that it sent off before it was detected again.
    """
    undetected = np.flatnonzero((chosen < 0) & hypothesis.is_confirmed & (hypothesis.miss_count <= 3))
    free = np.setdiff1d(np.arange(costs.cost.shape[1]), chosen)
    if not len(undetected) or not len(free):
        return []
    delta = costs.cost[np.ix_(undetected, free)] - costs.missed_cost[undetected, None]
    options = [divmod(int(flat), len(free)) for flat in np.argsort(delta, axis=None, kind="stable")[:4]]
    options = [option for option in options if delta[option] < MAX_BRANCH_COST]
    pairs = [(p, q) for p, q in combinations(options, 2) if p[0] != q[0] and p[1] != q[1]]
    result = []
    for departure in [*((option,) for option in options[:2]), *pairs[:1]]:
        other = chosen.copy()
        for i, j in departure:
            other[undetected[i]] = free[j]
        result.append((cost + float(sum(delta[option] for option in departure)), other))
    return result


def _update_hypothesis(
    hypothesis: TrackHypothesis,
    costs: AssignmentCosts,
    chosen: IntArray,
    detections: TableDetections,
    now: IntArray,
    dt: float,
    early: bool,
    table: Table,
    labels: int,
) -> TrackHypothesis:
    """Return the hypothesis one frame later."""
    is_detected = chosen >= 0
    rows = np.arange(len(chosen))
    mode = np.where(
        is_detected,
        costs.mode[rows, chosen] if costs.mode.shape[1] else FREE,
        np.where(costs.prediction.contact_count > 0, PREDICTED_CONTACT, FREE),
    )
    contact = mode == PREDICTED_CONTACT
    xy = np.where(contact[:, None], costs.prediction.xy, costs.prediction.free)
    v = np.where(contact[:, None], costs.prediction.v, costs.prediction.free_v)
    p = np.where(contact[:, None], costs.p_contact, costs.p_free)
    # no sign of a predicted contact: it may only be late, so the velocity stays uncertain
    p[:, 2] += np.where(mode == FREE, (LATE_CONTACT_SHARE * costs.prediction.velocity_change) ** 2, 0.0)
    colour, spread = hypothesis.colour.copy(), hypothesis.colour_sigma.copy()
    for i in np.flatnonzero(is_detected):
        d = now[chosen[i]]
        xy[i], v[i], p[i] = _correct_state(
            hypothesis.xy[i],
            xy[i],
            v[i],
            p[i],
            int(mode[i]),
            detections,
            int(d),
            dt,
            table.ball_radius,
            float(costs.nearby_speed[i]),
        )
        share = max(1 / (hypothesis.hit_count[i] + 1), 0.05)
        colour[i] += share * (detections.colour[d] - colour[i])
    is_active = _select_active_balls(hypothesis, is_detected, xy, table)
    births = _find_births(chosen, detections, now, xy[is_detected], table)
    is_confirmed_now = is_detected & (hypothesis.hit_count == CONFIRMED_HITS - 1)
    cost = LATE_BIRTH_COST * float(np.sum(is_confirmed_now) + np.sum(detections.is_still[births])) * (not early)
    z = detections.xy[births]
    one = np.ones(len(births))
    speed = np.where(detections.is_still[births], 0.01, NEW_BALL_SPEED_SIGMA)
    return TrackHypothesis(
        np.concatenate([hypothesis.label[is_active], labels + np.arange(len(births))]),
        np.concatenate([xy[is_active], z]),
        np.concatenate([v[is_active], np.zeros_like(z)]),
        np.concatenate([p[is_active], np.stack([detections.sigma[births] ** 2, 0 * one, speed**2], axis=1)]),
        np.concatenate([colour[is_active], detections.colour[births]]),
        np.concatenate([spread[is_active], 8.0 * one]),
        np.concatenate(
            [(hypothesis.hit_count + is_detected)[is_active], np.where(detections.is_still[births], CONFIRMED_HITS, 1)]
        ),
        np.concatenate(
            [np.where(is_detected, 0, hypothesis.miss_count + 1)[is_active], np.zeros(len(births), np.int64)]
        ),
        np.concatenate([np.where(is_detected, now[chosen] if len(now) else -1, -1)[is_active], births]),
        cost,
        hypothesis,
    )


def _correct_state(
    start: FloatArray,
    xy: FloatArray,
    v: FloatArray,
    p: FloatArray,
    mode: int,
    detections: TableDetections,
    d: int,
    dt: float,
    radius: float,
    nearby_speed: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Update place, velocity and variances of one ball with detection d; `nearby_speed` is the speed near it, m/s."""
    z, r2 = detections.xy[d], detections.sigma[d] ** 2 + (mode == OUTLIER) * (OUTLIER_RADII * radius) ** 2
    if mode in (UNPREDICTED_CONTACT, STRUCK):
        velocity = (z - start) / dt  # for a contact at the start of the interval; on average it is in its middle
        velocity_sigma = 0.7 * float(np.hypot(*velocity)) + 0.2 + (mode == UNPREDICTED_CONTACT) * 0.4 * nearby_speed
        return z.copy(), 1.3 * velocity, np.array([r2, 0.0, velocity_sigma**2])
    u = unit_vectors(detections.streak[d : d + 1])[0]
    innovation = z - xy
    ahead = float(innovation @ u) * u
    across = innovation - ahead
    total, total_along = p[0] + r2, p[0] + max(detections.sigma_along[d] ** 2, r2)
    scaled = across / total + ahead / total_along
    gain = p[:2] / total
    corrected = np.array([p[0] * (1 - gain[0]), p[1] * (1 - gain[0]), p[2] - gain[1] * p[1]])
    corrected[0] = max(corrected[0], 0.02 * detections.sigma[d] ** 2)
    # a ball that departs from its prediction moves otherwise: a larger velocity variance lets the track catch up
    distance = float(across @ across / (p[0] + detections.sigma[d] ** 2))
    distance += float((innovation @ u) ** 2 / (p[0] + detections.sigma_along[d] ** 2))
    if distance > SUSPICIOUS_CHI2:
        corrected[2] += 0.1 * float(innovation @ innovation) / dt**2
        corrected[0] += 0.1 * float(innovation @ innovation)
    return xy + p[0] * scaled, v + p[1] * scaled, corrected


def _select_active_balls(
    hypothesis: TrackHypothesis, is_detected: NDArray[np.bool_], xy: FloatArray, table: Table
) -> NDArray[np.bool_]:
    """Mark the balls that stay active: not those potted, run off, or never confirmed."""
    miss_count = np.where(is_detected, 0, hypothesis.miss_count + 1)
    hit_count = hypothesis.hit_count + is_detected
    speed = np.hypot(*hypothesis.v.T)
    inside = (xy > 0).all(axis=1) & (xy[:, 0] < table.length) & (xy[:, 1] < table.width)
    patience = np.where(hit_count < 4, 2, np.where(speed > 0.05, 10, 10_000))
    if table.pockets and len(xy):
        gap = np.hypot(*np.moveaxis(xy[:, None] - table.pocket_centres[None], 2, 0)).min(axis=1)
        patience = np.where((gap < 3 * table.ball_radius) & (speed > 0.05), np.minimum(patience, 4), patience)
    return (miss_count <= patience) & (inside | is_detected | (miss_count <= 2))


def _find_births(
    chosen: IntArray, detections: TableDetections, now: IntArray, balls: FloatArray, table: Table
) -> IntArray:
    """Find detections that no ball took and that overlap no detected ball."""
    free = np.setdiff1d(np.arange(len(now)), chosen)
    if len(free) and len(balls):
        gap = np.hypot(*np.moveaxis(detections.xy[now[free]][:, None] - balls[None], 2, 0)).min(axis=1)
        free = free[gap > 1.3 * table.ball_radius]
    return now[free]


def _prune_hypotheses(hypotheses: list[TrackHypothesis], window: int) -> list[TrackHypothesis]:
    """Keep the hypotheses that agree with the best one about the frame `window` frames ago."""
    if len(hypotheses) == 1:
        return hypotheses
    roots = [_find_ancestor(hypothesis, window) for hypothesis in hypotheses]
    return [hypothesis for hypothesis, root in zip(hypotheses, roots, strict=True) if root is roots[0]]


def _find_ancestor(hypothesis: TrackHypothesis, generations: int) -> TrackHypothesis:
    for _ in range(generations):
        if hypothesis.parent is None:
            break
        hypothesis = hypothesis.parent
    return hypothesis


def _collect_tracklets(hypothesis: TrackHypothesis, frame_count: int) -> list[tuple[IntArray, IntArray]]:
    tracklets: dict[int, tuple[list[int], list[int]]] = {}
    node: TrackHypothesis | None = hypothesis
    k = frame_count - 1
    while node is not None and k >= 0:
        for label, detection in zip(node.label.tolist(), node.last_detection.tolist(), strict=True):
            if detection >= 0:
                times, rows = tracklets.setdefault(label, ([], []))
                times.append(k)
                rows.append(detection)
        node, k = node.parent, k - 1
    return [(np.array(tracklets[label][0][::-1]), np.array(tracklets[label][1][::-1])) for label in sorted(tracklets)]
