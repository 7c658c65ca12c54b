"""Prediction of the rest of a shot: paths with uncertainty, and events with probabilities.

While the motion depends on its start by less than `MAX_SENSITIVITY` and every probable ensemble member has the same
events in the same order, exact derivatives of the simulation carry mean and covariance. Beyond, contacts multiply
errors and members diverge: an ensemble, drawn from all uncertainties, represents the future.

The level of a place is the share of the probability that is denser than there; the region of 90 % holds all places of a
level of at most 0.9, and is the smallest of this probability (Hyndman 1996, doi:10.1080/00031305.1996.10474359). In an
ensemble, the distance to the k-th nearest member stands for the density (Loftsgaarden and Quesenberry 1965,
doi:10.1214/aoms/1177700079): it follows several branches at once, and needs no bandwidth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from models.core.scene import CUSHIONS, POCKETS
from models.core.typing import FloatArray
from models.estimation.forecast.state_estimate import PARAMETERS_PER_BALL, StateEstimate
from models.estimation.multiple_shooting.shooting_windows import MAX_SENSITIVITY
from models.physics.billiards.contact_models import CUSHION_MODELS
from models.physics.billiards.simulation.event_engine import (
    BALL,
    EVENT_FIRST,
    EVENT_GENTLE,
    EVENT_KIND,
    EVENT_SECOND,
    EVENT_TIME,
    HOLE,
    LINE,
)
from models.physics.billiards.simulation.shot_derivatives import BALL_COLUMNS
from models.physics.billiards.simulation.simulate_shot import DISTURBED, SimulatedShot

# Kind (ball, cushion, pocket, rest), ball, and what it meets; empty for a rest.
EventKey = tuple[str, str, str]

# Members of the ensemble: probabilities are known to 3 %.
ENSEMBLE_SIZE = 256
# Share of members with other events below which one order of contacts counts as certain.
MAX_DIVERGED_SHARE = 0.01
# Step of the derivatives of paths, in the units of the state. It exceeds the micrometre by which gentle contacts part
# balls.
_DIFFERENCE_STEP = 1e-5
# Cushion contacts of a shot, of all balls together, whose deviations from the model are drawn; later ones follow the
# model.
DISTURBED_CONTACTS = 64
# Probability below which an event is not listed.
MIN_EVENT_PROBABILITY = 0.02


# Standard deviations between the 5 % and the 95 % quantile of a normal distribution.
NORMAL_WIDTH = 3.2897


@dataclass(frozen=True, slots=True)
class PredictedEvent:
    """An event that may happen."""

    event: EventKey
    probability: float
    t: float
    """s, median of its first time where it happens; the others are its 5 % and 95 % quantiles."""
    t_low: float
    t_high: float

    @property
    def t_sigma(self) -> float:
        """Standard deviation of `t`, s, of the normal distribution with these quantiles."""
        return (self.t_high - self.t_low) / NORMAL_WIDTH


@dataclass(frozen=True, slots=True)
class ShotPrediction:
    """Prediction of N balls at T moments with M ensemble members."""

    state: StateEstimate
    t: FloatArray
    """(T,) s."""
    path: FloatArray
    """(T, N, 2) m: the path of the mean state, then the mean of the ensemble; NaN where all members have potted the
    ball.
    """
    velocity: FloatArray
    """(T, N, 2) m/s."""
    covariance: FloatArray
    """(T, N, 2, 2) m^2."""
    is_ensemble: NDArray[np.bool_]
    """(T,) True where the ensemble represents the future."""
    members: FloatArray
    """(M, T, N, 2) m; NaN once a ball is potted."""
    events: tuple[PredictedEvent, ...]
    """In the order of time."""
    first_contacts: tuple[tuple[tuple[EventKey, float], ...], ...]
    """(N,) first events of each ball with probabilities; the most probable first."""

    @property
    def sigma(self) -> FloatArray:
        """(T, N) m per axis."""
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=2, axis2=3) / 2), np.float64)

    @property
    def on_table(self) -> FloatArray:
        """(T, N) probability that a ball has not been potted."""
        return np.asarray(np.isfinite(self.members[..., 0]).mean(axis=0), np.float64)

    def level(self, row: int, ball: int, xy: FloatArray, noise: FloatArray | None = None) -> float:
        """Return the probability that is denser than at `xy` (2,), measured with covariance `noise` (2, 2).

        The region of 90 % holds the places of at most 0.9. NaN where the ball should be in a pocket.
        """
        if not self.is_ensemble[row]:
            total = self.covariance[row, ball] + (0.0 if noise is None else noise)
            return level_of_normal(xy - self.path[row, ball], total)
        places = self.members[:, row, ball]
        return level_by_neighbours(xy, places[np.isfinite(places[:, 0])], noise)


def forecast_shot(state: StateEstimate, t: FloatArray, seed: int = 0, draws: int = ENSEMBLE_SIZE) -> ShotPrediction:
    """Predict the rest of a shot.

    Args:
        state: State estimate of N balls.
        t: (T,) s, ascending and not before the state.
        seed: Random seed of the ensemble.
        draws: Number M of ensemble members.

    Returns:
        Paths with covariance, ensemble members and events.

    Raises:
        ValueError: If `t` is empty, not ascending, or before the state.
    """
    if len(t) == 0 or np.any(np.diff(t) < 0) or t[0] < state.t - 1e-9:
        raise ValueError(f"moments to predict ascend from {state.t:g} s on; got {t[:3]} ...")
    after = np.maximum(t - state.t, 0.0)
    seconds = float(max(after[-1], 1e-3)) + 1e-6
    law = state.most_probable_law
    central = state.simulate_ahead(state.simulation_inputs(state.mean, law), law, seconds)
    runs = [
        state.simulate_ahead(inputs, law, seconds, deviations)
        for inputs, law, deviations in draw_members(state, np.random.default_rng(seed), draws)
    ]
    states = np.stack([run.states_at(after) for run in runs])
    places, covariance, sensitive = _propagate_linearly(state, central, after, seconds)
    order = [list_contacts(run) for run in runs]
    divergence_times = np.array([_divergence_time(list_contacts(central), other) for other in order])
    until = float(np.quantile(divergence_times, MAX_DIVERGED_SHARE, method="lower"))
    if state.learned is not None:  # the derivatives do not contain the scatter of contacts
        until = min([until, *(t for ball in list_contacts(central) for t, _ in ball[:1])])
    ensemble = np.asarray(np.maximum.accumulate(sensitive | (after > until)))
    mean, spread = _ensemble_moments(states[..., :4])
    use_ensemble = ensemble[:, None, None]
    return ShotPrediction(
        state,
        t,
        np.where(use_ensemble, mean[..., :2], places[..., :2]),
        np.where(use_ensemble, mean[..., 2:], places[..., 2:]),
        np.where(use_ensemble[..., None], spread, covariance),
        ensemble,
        states[..., :2],
        summarize_events(state.ids, state.t, order, _find_rest_times(state, after, states, order)),
        tuple(_rank_first_contacts(order, ball) for ball in range(len(state.ids))),
    )


def draw_members(
    state: StateEstimate, rng: np.random.Generator, draws: int
) -> list[tuple[FloatArray, str, FloatArray]]:
    """Draw the members of an ensemble from all uncertainties, including the cushion law.

    Args:
        state: State estimate of N balls.
        rng: Random generator.
        draws: Number of members.

    Returns:
        Simulation inputs (9N + 17,), cushion law, and disturbances (D, 5) of cushion contacts of each member.
    """
    value, vectors = np.linalg.eigh(state.covariance)
    root = vectors * np.sqrt(np.maximum(value, 0.0))
    laws = rng.choice(len(CUSHION_MODELS), draws, p=state.laws)
    numbers = state.mean + rng.standard_normal((draws, len(value))) @ root.T
    for ball, spin in enumerate(state.spins):
        if spin is not None:
            numbers[:, PARAMETERS_PER_BALL * (ball + 1) - 1] = spin.draw(rng, draws)
    # deviations of cushion contacts from the model of a learned table
    disturbances = np.zeros((draws, 0, len(DISTURBED)))
    if state.learned is not None:
        disturbances = state.learned.scatter.draw(rng, (draws, DISTURBED_CONTACTS))
    inputs = [state.simulation_inputs(one, CUSHION_MODELS[law]) for one, law in zip(numbers, laws, strict=True)]
    if state.learned is not None:
        first = len(BALL_COLUMNS) * len(state.ids)
        for own, values in zip(inputs, state.learned.draw_physics(rng, draws), strict=True):
            own[first + state.learned.uncertain] = values
    return [
        (own, CUSHION_MODELS[law], deviations) for own, law, deviations in zip(inputs, laws, disturbances, strict=True)
    ]


def _propagate_linearly(
    state: StateEstimate, central: SimulatedShot, after: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return states (T, N, 4), covariance of places (T, N, 2, 2), and where (T,) the motion is sensitive.

    The path is the mean over the cushion laws; their differences add to the propagated covariance.
    """
    states = central.states_at(after)[..., :4]
    jacobian = _differentiate_paths(state, after, seconds)
    covariance = jacobian @ state.covariance @ np.swapaxes(jacobian, 2, 3)
    possible = np.flatnonzero(state.laws)  # a learned table has one
    weights, laws = state.laws[possible], [CUSHION_MODELS[k] for k in possible]
    runs = [state.simulate_ahead(state.simulation_inputs(state.mean, law), law, seconds) for law in laws]
    each = np.stack([run.states_at(after)[..., :4] for run in runs])
    path = np.einsum("l,ltnk->tnk", weights, each)
    deviations = (each - path)[..., :2]
    covariance = covariance + np.einsum("l,ltni,ltnj->tnij", weights, deviations, deviations)
    place_jacobian = np.nan_to_num(jacobian[..., state.place_columns], nan=0.0)
    sensitivity = np.linalg.norm(place_jacobian, axis=(2, 3), ord=2).max(axis=1, initial=0.0)
    is_unreliable = ~np.isfinite(covariance).all(axis=(2, 3)) & np.isfinite(states[..., 0])
    is_unreliable |= np.isfinite(path[..., 0]) != np.isfinite(states[..., 0])
    return path, covariance, (sensitivity > MAX_SENSITIVITY) | is_unreliable.any(axis=1)


def _differentiate_paths(state: StateEstimate, after: FloatArray, seconds: float) -> FloatArray:
    """Return the derivatives (T, N, 2, D) of places by the state, as differences; NaN from where its contacts differ.

    Exact ones would have to be compiled first, which takes longer than some hundred simulations.
    """
    law, columns = state.most_probable_law, []
    for step in _DIFFERENCE_STEP * np.eye(len(state.mean)):
        ahead, behind = (
            state.simulate_ahead(state.simulation_inputs(state.mean + side * step, law), law, seconds)
            for side in (1, -1)
        )
        slope = (ahead.states_at(after) - behind.states_at(after))[..., :2] / (2 * _DIFFERENCE_STEP)
        slope[after > _divergence_time(list_contacts(ahead), list_contacts(behind))] = np.nan
        columns.append(slope)
    return np.stack(columns, axis=-1)


def _ensemble_moments(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (T, N, 4), and covariance (T, N, 2, 2) of places, over members (M, T, N, 4) with the ball."""
    is_on_table = np.isfinite(states[..., 0])
    count = is_on_table.sum(axis=0)
    share = np.where(count > 0, count, np.nan)[..., None]
    mean = np.where(is_on_table[..., None], states, 0.0).sum(axis=0) / share
    deviations = np.where(is_on_table[..., None], states[..., :2] - mean[..., :2], 0.0)
    return mean, np.einsum("mtni,mtnj->tnij", deviations, deviations) / np.maximum(share - 1, 1.0)[..., None]


def list_contacts(run: SimulatedShot) -> list[list[tuple[float, EventKey]]]:
    """List the contacts of each ball with their times, without gentle ones of balls that lie together.

    Args:
        run: A simulated shot of N balls.

    Returns:
        (N,) time (s) and event of each contact, in the order of time.
    """
    ids = run.balls.ids
    contacts: list[list[tuple[float, EventKey]]] = [[] for _ in ids]
    sides = {0: run.rails.lines[:, 5], 1: run.rails.arcs[:, 3] if len(run.rails.arcs) else np.empty(0)}
    for event in run.contacts[run.contacts[:, EVENT_GENTLE] == 0]:
        t = float(event[EVENT_TIME])
        kind, a, other = event[[EVENT_KIND, EVENT_FIRST, EVENT_SECOND]].astype(int).tolist()
        if kind == BALL:
            contacts[a].append((t, ("ball", ids[a], ids[other])))
            contacts[other].append((t, ("ball", ids[other], ids[a])))
        elif kind == HOLE:
            contacts[a].append((t, ("pocket", ids[a], POCKETS[other])))
        else:
            contacts[a].append((t, ("cushion", ids[a], CUSHIONS[int(sides[int(kind != LINE)][other])])))
    return contacts


def _divergence_time(one: list[list[tuple[float, EventKey]]], other: list[list[tuple[float, EventKey]]]) -> float:
    """Return the time (s) of the first event of some ball that differs between two simulations."""
    earliest = np.inf
    for a, b in zip(one, other, strict=True):
        for (t, event), (s, other_event) in zip(a, b, strict=False):
            if event != other_event:
                earliest = min(earliest, t, s)
                break
        else:
            rest = a[len(b) :] or b[len(a) :]
            if rest:
                earliest = min(earliest, rest[0][0])
    return earliest


def _find_rest_times(
    state: StateEstimate, after: FloatArray, states: FloatArray, order: list[list[list[tuple[float, EventKey]]]]
) -> dict[EventKey, list[float]]:
    """Find when (s after the state) balls come to rest for good, one time per member, rounded up to the moments.

    A ball that rests at first comes to rest in the members alone in which something touches it, by `order`.
    """
    is_moving = (states[..., 2] != 0) | (states[..., 3] != 0)  # a potted ball, NaN, never rests
    rest_times: dict[EventKey, list[float]] = {}
    for ball, name in enumerate(state.ids):
        was_moved = np.array([state.moving[ball] or bool(contacts[ball]) for contacts in order], bool)
        ball_moves = is_moving[..., ball] & was_moved[:, None]
        stopped = ball_moves.any(axis=1) & ~ball_moves[:, -1]
        first = ball_moves.shape[1] - np.argmax(ball_moves[stopped][:, ::-1], axis=1)
        if stopped.any():
            rest_times[("rest", name, "")] = after[first].tolist()
    return rest_times


def summarize_events(
    ids: Sequence[str], begin: float, order: list[list[list[tuple[float, EventKey]]]],
    rests: dict[EventKey, list[float]],
) -> tuple[PredictedEvent, ...]:  # fmt: skip
    """Summarize events in at least `MIN_EVENT_PROBABILITY` of the members.

    Args:
        ids: (N,) balls in the order of the clip; a pair of balls is named in this order.
        begin: s, start of the simulations.
        order: Contacts of each ball in each member, see `list_contacts`.
        rests: When balls come to rest, s after `begin`, one time per member in which they do.

    Returns:
        The events in the order of time.
    """
    times = dict(rests)
    for member in order:
        first_times: dict[EventKey, float] = {}
        for t, event in (meeting for ball in member for meeting in ball):
            kind, a, b = event
            if kind != "ball" or ids.index(a) < ids.index(b):
                first_times.setdefault(event, t)
        for event, t in first_times.items():
            times.setdefault(event, []).append(t)
    events = [
        PredictedEvent(event, len(t) / len(order), *(begin + float(q) for q in np.quantile(t, (0.5, 0.05, 0.95))))
        for event, t in times.items()
        if len(t) >= MIN_EVENT_PROBABILITY * len(order)
    ]
    return tuple(sorted(events, key=lambda one: one.t))


# Quantiles of tables, by the ends of the names of their columns.
QUANTILES = {"05": 0.05, "25": 0.25, "50": 0.5, "75": 0.75, "95": 0.95}


def compute_quantiles(places: FloatArray) -> FloatArray:
    """Compute the quantiles (Q, T, N) over the members (M, T, N) with the ball on the table; NaN where none has it."""
    drawn = np.ma.masked_invalid(places).filled(np.nan)
    gone = np.isnan(drawn).all(axis=0)
    shares = np.nanquantile(np.where(gone, 0.0, drawn), list(QUANTILES.values()), axis=0)
    shares[:, gone] = np.nan
    return np.asarray(shares)


def _rank_first_contacts(
    order: list[list[list[tuple[float, EventKey]]]], ball: int
) -> tuple[tuple[EventKey, float], ...]:
    """Rank the first contacts of a ball by probability."""
    counts = Counter(member[ball][0][1] for member in order if member[ball])
    return tuple((event, count / len(order)) for event, count in counts.most_common())


# m: smaller distances count as one place.
MIN_DISTANCE = 1e-7
# rad: golden angle, which spreads points evenly.
_GOLDEN = np.pi * (3 - np.sqrt(5))


def level_of_normal(offset: FloatArray, covariance: FloatArray) -> float:
    """Return the level of a place `offset` (2,) m from the mean of a normal distribution with covariance (2, 2)."""
    regularized = covariance + MIN_DISTANCE**2 * np.eye(2)
    return float(1 - np.exp(-0.5 * offset @ np.linalg.solve(regularized, offset)))


def level_by_neighbours(xy: FloatArray, draws: FloatArray, noise: FloatArray | None = None) -> float:
    """Return the level of `xy` (2,), with error covariance `noise` (2, 2), among draws (M, 2); NaN below two."""
    if len(draws) < 2:
        return float("nan")
    spread = draws
    if noise is not None:
        spread = draws + _normal_pattern(len(draws)) @ np.linalg.cholesky(noise + MIN_DISTANCE**2 * np.eye(2)).T
    far, own = _neighbour_distances(spread, np.vstack([xy[None], spread]))
    # each draw counts itself as one of its neighbours, so its next distance is compared
    return float(np.mean(own[1:] < far[0]))


def _neighbour_distances(draws: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances of places (K, 2) to the k-th nearest draw, and to the next one, for places that are draws.

    k is the square root of the number of draws.
    """
    k = min(max(round(np.sqrt(len(draws))), 1), len(draws) - 1)
    distances, _ = cKDTree(draws).query(places, k=[k, k + 1])
    return distances[:, 0] + MIN_DISTANCE, distances[:, 1] + MIN_DISTANCE


def _normal_pattern(count: int) -> FloatArray:
    """Return (M, 2) quasi-random points of a standard normal distribution, in random order."""
    k = np.arange(count)
    radius = np.sqrt(-2 * np.log((np.random.default_rng(0).permutation(count) + 0.5) / count))
    return np.column_stack([radius * np.cos(_GOLDEN * k), radius * np.sin(_GOLDEN * k)])
