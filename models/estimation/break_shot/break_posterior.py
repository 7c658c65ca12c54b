"""Posterior of a break shot: its contacts, each with its probability, and the states in which balls leave it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.shot import BreakContact, BreakExit, SimulatedBreak
from models.core.typing import FloatArray
from models.estimation.break_shot.break_data import BreakShot
from models.estimation.break_shot.break_search import BreakEnsemble
from models.estimation.break_shot.break_simulation import BreakModel
from models.physics.billiards.simulation.event_engine import (
    BALL,
    EVENT_FIRST,
    EVENT_KIND,
    EVENT_SECOND,
    EVENT_SPEED,
    EVENT_TIME,
)
from models.physics.billiards.simulation.parametrised_shot import convert_to_starts
from models.physics.billiards.simulation.simulated_shot import STATE_SIZE, SimulatedShot

LULL_RADII = 6.0
"""Ball radii that the incoming ball would go on without any contact: then the break is over."""
MIN_SPEED = 0.02
"""m/s of closing; slower contacts change nothing."""
MIN_PROBABILITY = 0.5
"""Least weighted share of the samples with a contact that is listed."""
MAX_PROBABILITY = 0.96
"""Share of contacts common to all samples that were true on breaks simulated by other code; see
`benchmarks/tracking/breaks.py`.
"""
MIN_TIME_SIGMA = 1e-4
"""s: balls in contact for a third of a millisecond do not touch at one moment."""
PLACE_SIGMA, SPEED_SIGMA, SLIP_SIGMA = 1e-4, 0.01, 0.03
"""m, and shares of the speed of a ball: errors of the contact laws."""
TIME_EPSILON = 1e-9
"""s after a contact, when the balls have separated."""


def summarize_break(ensemble: BreakEnsemble) -> SimulatedBreak:
    """Summarize the contacts from the first to the last before a lull, and the states in which balls leave.

    Args:
        ensemble: Posterior samples of a break.

    Returns:
        The best sample, with the spread of the others.
    """
    break_shot, best = ensemble.break_shot, ensemble.samples[0].run
    rows = _list_ball_contacts(best)
    last = _break_end(break_shot, rows)
    rows = rows[rows[:, EVENT_TIME] <= last]
    others = [_list_ball_contacts(one.run) for one in ensemble.samples]
    directions = BreakModel(break_shot, break_shot.end).state_directions(ensemble.samples[0].parameters)
    contact_summaries = [_summarize_contact(ensemble, directions, others, rows, k) for k in range(len(rows))]
    exits = []
    for number in range(len(break_shot.balls)):
        mine = rows[(rows[:, EVENT_FIRST] == number) | (rows[:, EVENT_SECOND] == number), EVENT_TIME]
        if len(mine):
            exits.append(_summarize_exit(ensemble, directions, number, float(mine[0]), float(mine[-1])))
    return SimulatedBreak(
        break_shot.balls, break_shot.start, break_shot.hit, break_shot.interval,
        tuple(contact for contact in contact_summaries if contact.probability > MIN_PROBABILITY), tuple(exits),
        best.to_trajectory(),
    )  # fmt: skip


def _list_ball_contacts(run: SimulatedShot) -> FloatArray:
    """List the engine's contacts of two balls that approach fast enough."""
    events = run.contacts
    return np.asarray(events[(events[:, EVENT_KIND] == BALL) & (events[:, EVENT_SPEED] > MIN_SPEED)])


def _break_end(break_shot: BreakShot, contacts: FloatArray) -> float:
    """Return the time of the last contact before a lull, s of the simulation; at least a frame shows its result."""
    lull = max(break_shot.interval, LULL_RADII * break_shot.table.ball_radius / break_shot.speed)
    latest = break_shot.end - break_shot.start - 1.5 * break_shot.interval
    times = contacts[contacts[:, EVENT_TIME] <= latest, EVENT_TIME]
    if not len(times):
        return 0.0
    pause = np.flatnonzero(np.diff(times) > lull)
    return float(times[pause[0]] if len(pause) else times[-1])


def _summarize_contact(
    ensemble: BreakEnsemble, directions: FloatArray, others: list[FloatArray], contacts: FloatArray, k: int
) -> BreakContact:
    """Summarize contact k of the best sample; others share it where the same balls meet as often, about then."""
    break_shot, best = ensemble.break_shot, ensemble.samples[0].run
    row = contacts[k]
    a, b, t = int(row[EVENT_FIRST]), int(row[EVENT_SECOND]), float(row[EVENT_TIME])
    mine = np.flatnonzero(_is_same_pair(contacts, a, b))
    occurrence = int(np.searchsorted(mine, k))
    moments = np.full(len(others), np.nan)
    for m, other in enumerate(others):
        other_times = other[_is_same_pair(other, a, b), EVENT_TIME]
        if occurrence < len(other_times) and abs(other_times[occurrence] - t) < break_shot.interval:
            moments[m] = other_times[occurrence]
    is_shared = np.isfinite(moments)
    share = ensemble.weight[is_shared] / ensemble.weight[is_shared].sum()
    spread = float(
        np.hypot(np.sqrt(share @ (moments[is_shared] - t) ** 2), _contact_time_sigma(ensemble, directions, a, b, t))
    )
    return BreakContact(
        break_shot.start + t,
        max(spread, MIN_TIME_SIGMA),
        break_shot.balls[a],
        break_shot.balls[b],
        best.states_at(t)[a, :2],
        float(row[EVENT_SPEED]),
        MAX_PROBABILITY * float(ensemble.weight[is_shared].sum()),
    )


def _is_same_pair(contacts: FloatArray, a: int, b: int) -> NDArray[np.bool_]:
    """Mark the contacts of balls a and b."""
    one, two = contacts[:, EVENT_FIRST], contacts[:, EVENT_SECOND]
    return np.asarray(((one == a) & (two == b)) | ((one == b) & (two == a)))


def _summarize_exit(
    ensemble: BreakEnsemble, directions: FloatArray, number: int, first: float, last: float
) -> BreakExit:
    """Summarize the state in which a ball leaves the break."""
    break_shot = ensemble.break_shot
    arrival, arrival_covariance = _state_with_covariance(ensemble, directions, number, first - TIME_EPSILON)
    state, covariance = _state_with_covariance(ensemble, directions, number, last + TIME_EPSILON)
    return BreakExit(
        break_shot.balls[number], break_shot.start + first, break_shot.start + last, state, covariance,
        arrival[:2], arrival_covariance[:2, :2],
    )  # fmt: skip


def _state_with_covariance(
    ensemble: BreakEnsemble, directions: FloatArray, number: int, t: float
) -> tuple[FloatArray, FloatArray]:
    """Return place, velocity and slip (6,) of a ball at t, s of the simulation, and their covariance (6, 6).

    It includes the errors of the parameters, the spread of other samples, and errors of the contact laws.
    """
    states = np.array(
        [convert_to_starts(one.run.states_at(t), one.run.balls.radius)[number, :6] for one in ensemble.samples]
    )
    (jacobian,), other = _state_derivatives(ensemble, directions, (number,), t), states - states[0]
    speed = float(np.hypot(*states[0, 2:4]))
    floor = np.repeat([PLACE_SIGMA, SPEED_SIGMA * speed + MIN_SPEED, SLIP_SIGMA * speed + MIN_SPEED], 2)
    return states[0], jacobian @ ensemble.covariance @ jacobian.T + (other.T * ensemble.weight) @ other + np.diag(
        floor**2
    )


def _state_derivatives(
    ensemble: BreakEnsemble, directions: FloatArray, numbers: tuple[int, ...], t: float
) -> FloatArray:
    """Return derivatives (K, 6, P) of the states of K balls at t, s of the simulation, by the best parameters.

    `directions` are those of `BreakModel.state_directions`.
    """
    run, chosen = ensemble.samples[0].run, list(numbers)
    place = np.full((1, len(ensemble.break_shot.balls)), -1)
    place[0, chosen] = np.arange(len(chosen))
    derivatives = run.directional_derivatives(np.array([t]), place, directions, STATE_SIZE)
    return convert_to_starts(derivatives.transpose(2, 0, 1), run.balls.radius[chosen]).transpose(1, 2, 0)[:, :6]


def _contact_time_sigma(ensemble: BreakEnsemble, directions: FloatArray, a: int, b: int, t: float) -> float:
    """Return the effect of parameter errors on the time of a contact, s: change of the gap over closing speed."""
    before = t - TIME_EPSILON
    states = convert_to_starts(ensemble.samples[0].run.states_at(before), ensemble.samples[0].run.balls.radius)
    separation = states[b, :2] - states[a, :2]
    line = separation / np.hypot(*separation)
    closing = max(float((states[a, 2:4] - states[b, 2:4]) @ line), MIN_SPEED)
    one, two = _state_derivatives(ensemble, directions, (a, b), before)
    gap = line @ (two[:2] - one[:2])
    return float(np.hypot(np.sqrt(max(gap @ ensemble.covariance @ gap, 0.0)), PLACE_SIGMA)) / closing
