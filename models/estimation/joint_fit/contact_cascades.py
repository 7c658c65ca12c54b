"""Contacts that follow from one another within a frame interval, predicted roughly and inserted into a graph.

A ball that runs into a row sends off the last of it, and those between hardly move: none of them shows a velocity
change, so that the contacts are proposed together, from the first on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.contact_graph import ClothFriction, Contact, ContactGraph, Observations, index_after_merge
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_solution import evaluate_path

# Ball against ball, 0.92 to 0.98 (Alciatore, TP A-6).
RESTITUTION = 0.95
# Contacts of one cascade: a longer one is too uncertain to be proposed.
MAX_CASCADE_CONTACTS = 8
# m/s: slower contacts are ignored.
MIN_CONTACT_SPEED = 0.03
# Samples on either side of a contact that give the velocities before and after.
VELOCITY_SAMPLES = 6
# s between two contacts of a ball.
MIN_CONTACT_INTERVAL = 2e-4


@dataclass(frozen=True, slots=True)
class CascadeContact:
    """Balls a and b meet at t, s, and have states (6,) of place, velocity and slip after it."""

    t: float
    a: int
    b: int
    after_a: FloatArray
    after_b: FloatArray


def predict_cascade(
    graph: ContactGraph, friction: ClothFriction, a: int, b: int, t: float, horizon: float, radius: float
) -> list[CascadeContact]:
    """Predict the contacts that follow if balls a and b meet at t.

    Balls go straight meanwhile; masses are equal. The balls arrive without the unexplained velocity changes within
    `horizon` of t, which the contact explains.

    Args:
        graph: The contact graph.
        friction: Friction of the cloth.
        a: One ball.
        b: The other ball.
        t: Time of the first contact, s.
        horizon: Duration of the prediction, s.
        radius: Ball radius, m.

    Returns:
        The contacts in order; only the first one if the balls already separate.
    """
    balls = sorted({segment.ball for segment in graph.segments})
    state = np.array(
        [evaluate_state(graph, friction, _find_incoming_segment(graph, ball, t, horizon), t) for ball in balls]
    )
    i, j = balls.index(a), balls.index(b)
    contacts: list[CascadeContact] = []
    now = t
    while len(contacts) < MAX_CASCADE_CONTACTS:
        _collide_balls(state, i, j)
        contacts.append(CascadeContact(now, balls[i], balls[j], state[i].copy(), state[j].copy()))
        wait, i, j = _find_next_pair(state[:, :2], state[:, 2:4], 2 * radius)
        now += max(wait, MIN_CONTACT_INTERVAL)
        if now - t > horizon:
            break
        state[:, :2] += max(wait, MIN_CONTACT_INTERVAL) * state[:, 2:4]
    return contacts


def _collide_balls(state: FloatArray, i: int, j: int) -> None:
    """Exchange velocity along the line of centres of equal masses; the slip changes as the velocity does."""
    line = state[j, :2] - state[i, :2]
    line = line / max(float(np.hypot(*line)), 1e-9)
    push = (1 + RESTITUTION) / 2 * max(float((state[i, 2:4] - state[j, 2:4]) @ line), MIN_CONTACT_SPEED) * line
    for part in (slice(2, 4), slice(4, 6)):
        state[i, part] -= push
        state[j, part] += push


def _find_next_pair(x: FloatArray, v: FloatArray, reach: float) -> tuple[float, int, int]:
    """Find the time until the next two balls meet, s, and which; those that overlap meet at once."""
    d, u = x[None] - x[:, None], v[None] - v[:, None]
    du, uu, dd = (d * u).sum(axis=2), (u * u).sum(axis=2), (d * d).sum(axis=2)
    root = du**2 - uu * np.maximum(dd - reach**2, 0.0)
    near = (du < -MIN_CONTACT_SPEED * np.sqrt(dd)) & (root >= 0)
    near[np.tril_indices(len(x))] = False
    if not near.any():
        return np.inf, 0, 0
    wait = np.where(
        near, np.maximum(dd - reach**2, 0.0) / np.where(near, -du + np.sqrt(np.maximum(root, 0)), 1), np.inf
    )
    i, j = divmod(int(np.argmin(wait)), len(x))
    return float(wait[i, j]), i, j


def insert_cascade(
    graph: ContactGraph,
    observations: Observations,
    owner: IntArray,
    contacts: list[CascadeContact],
    time_tolerance: float,
) -> ContactGraph | None:
    """Insert all `contacts` into a contact graph.

    An unexplained velocity change within `time_tolerance` of a ball's last contact becomes that contact.

    Args:
        graph: The contact graph.
        observations: K observations.
        owner: (K,) segment of each observation.
        contacts: Contacts from `predict_cascade`.
        time_tolerance: s.

    Returns:
        The extended graph; None if it cannot take the contacts.
    """
    contact_numbers: dict[tuple[int, float], int] = {}  # contact numbers by ball and time
    for ball in sorted({contact.a for contact in contacts} | {contact.b for contact in contacts}):
        own_contacts = [contact for contact in contacts if ball in (contact.a, contact.b)]
        unexplained = find_unexplained_change(graph, ball, own_contacts[-1].t, time_tolerance)
        if unexplained is None:
            k = find_segment_at(graph, ball, own_contacts[0].t)
            cuts, end = own_contacts, graph.end_time(k)
        else:  # an unexplained velocity change moves to the contact
            k = graph.contacts[unexplained].before[0]
            cuts, end = own_contacts[:-1], own_contacts[-1].t
        if any(not graph.start_time(k) + MIN_CONTACT_INTERVAL < contact.t < end for contact in cuts):
            return None
        if unexplained is None or len(own_contacts) > 1:
            graph = _refit_short_segment(graph, observations, owner, k, own_contacts[0].t)
        for contact in cuts:
            after = contact.after_a if contact.a == ball else contact.after_b
            state = np.concatenate([after, np.zeros(2)])
            if unexplained is None and contact is own_contacts[-1]:
                state = _match_observed_velocity(state, observations, owner, k, contact.t)
            graph = graph.insert_contact(Contact("free", contact.t, (k,), ()), (state,))
            contact_numbers[ball, contact.t] = len(graph.contacts) - 1
            k = len(graph.segments) - 1
        if unexplained is not None:
            if not own_contacts[-1].t < graph.end_time(graph.contacts[unexplained].after[0]):
                return None
            contact_numbers[ball, own_contacts[-1].t] = unexplained
    for contact in contacts:
        keep, drop = sorted((contact_numbers[contact.a, contact.t], contact_numbers[contact.b, contact.t]))
        first, second = (graph.contacts[contact_numbers[ball, contact.t]] for ball in (contact.a, contact.b))
        if first.before == second.before or all(graph.segments[c.before[0]].static for c in (first, second)):
            return None
        joined = Contact("ball", contact.t, (*first.before, *second.before), (*first.after, *second.after))
        graph = graph.merge_contacts(keep, drop, replace(joined, gain=first.gain + second.gain))
        contact_numbers = {place: index_after_merge(number, keep, drop) for place, number in contact_numbers.items()}
    return graph


def find_unexplained_change(graph: ContactGraph, ball: int, t: float, time_tolerance: float) -> int | None:
    """Find the velocity change of a ball without a cause that is nearest to t.

    Args:
        graph: The contact graph.
        t: s.
        time_tolerance: Largest distance in time, s.

    Returns:
        Index of the contact; None if there is none.
    """
    candidates = [
        (abs(c.t - t), number) for number, c in enumerate(graph.contacts)
        if c.kind in ("free", "strike") and graph.segments[c.before[0]].ball == ball and abs(c.t - t) < time_tolerance
    ]  # fmt: skip
    return min(candidates)[1] if candidates else None


def find_segment_at(graph: ContactGraph, ball: int, t: float) -> int:
    """Find the segment of a ball at a time.

    Args:
        graph: The contact graph.
        t: s.

    Returns:
        Index of the segment; the first one before the track begins.
    """
    segments = graph.segments_of_ball(ball)
    return next((k for k in reversed(segments) if graph.start_time(k) <= t), segments[0])


def _find_incoming_segment(graph: ContactGraph, ball: int, t: float, time_tolerance: float) -> int:
    """Find the segment in which a ball arrives at a contact at t, s."""
    unexplained = find_unexplained_change(graph, ball, t, time_tolerance)
    return find_segment_at(graph, ball, t) if unexplained is None else graph.contacts[unexplained].before[0]


def _refit_short_segment(
    graph: ContactGraph, observations: Observations, owner: IntArray, k: int, t: float
) -> ContactGraph:
    """Refit segment k to its samples before t if these are few: the others belong to what follows."""
    rows = np.flatnonzero((owner == k) & (observations.t < t))
    v = _fit_velocity(observations, rows)
    if graph.segments[k].static or v is None or len(rows) > VELOCITY_SAMPLES:
        return graph
    state = graph.segments[k].state.copy()
    state[:2] = observations.xy[rows].mean(axis=0) - v * (observations.t[rows].mean() - graph.start_time(k))
    state[2:4], state[4:8] = v, 0.0
    return graph.replace_segment(k, replace(graph.segments[k], state=state))


def _match_observed_velocity(
    state: FloatArray, observations: Observations, owner: IntArray, k: int, t: float
) -> FloatArray:
    """Replace the velocity of a predicted state (8,) by that of the samples of segment k after t."""
    v = _fit_velocity(observations, np.flatnonzero((owner == k) & (observations.t >= t))[:VELOCITY_SAMPLES])
    if v is None:
        return state
    matched = state.copy()
    matched[4:6] += v - matched[2:4]
    matched[2:4] = v
    return matched


def _fit_velocity(observations: Observations, rows: IntArray) -> FloatArray | None:
    """Fit the velocity (2,) of a line through samples; None for fewer than two."""
    if len(rows) < 2:
        return None
    tau = observations.t[rows] - observations.t[rows].mean()
    v: FloatArray = tau @ (observations.xy[rows] - observations.xy[rows].mean(axis=0)) / (tau @ tau)
    return v


def evaluate_state(graph: ContactGraph, friction: ClothFriction, k: int, t: float) -> FloatArray:
    """Evaluate the state (6,) of a segment at a time, s: position, velocity and slip, m and m/s."""
    state: FloatArray = evaluate_path(graph, friction, k, np.array([t]))[0]
    return state
