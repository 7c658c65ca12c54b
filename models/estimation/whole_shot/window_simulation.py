"""Simulation of one window and of the derivatives of its observations, with little more than compiled code.

A fit simulates windows a hundred thousand times, each for some 0.05 ms of arithmetic. What `simulate_start` and
`SimulatedShot` do for any use takes three times as long, so that the windows of a fit take this shorter way to the same
numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import Table
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.whole_shot.shot_segments import ShotSegment
from models.numerics.jit import compile_kernel
from models.physics.billiards.cushion_geometry import CUSHION_NORMALS, Rails, build_rails
from models.physics.billiards.parameter_vector import NAP_MU, PARAMETER_NAMES, ROLLING_MU
from models.physics.billiards.simulation.event_engine import EVENT_FIRST, EVENT_KIND, EVENT_SECOND, EVENT_TIME, HOLE
from models.physics.billiards.simulation.parametrised_shot import (
    MASS_RATIO,
    MOVING_BALL_SIZE,
    NOSE_OFFSETS,
    RADIUS_FACTOR,
    RADIUS_RATIO,
    build_directions,
    fill_balls,
)
from models.physics.billiards.simulation.shot_derivatives import differentiate_shot
from models.physics.billiards.simulation.simulate_shot import log_events
from models.physics.billiards.simulation.simulated_shot import STATE_SIZE, fill_states

# m or m/s: largest number of a start state, far beyond the place of a ball that was never observed.
_MAX_START = 1e6
# s, shortest simulation.
_LEAST_SECONDS = 1e-6


@dataclass(frozen=True, slots=True)
class WindowRun:
    """A simulated window, N balls."""

    state: FloatArray
    """(N, 7) at its start."""
    radius: FloatArray
    """(N,) m."""
    mass: FloatArray
    """(N,) kg."""
    physics: FloatArray
    """(P,) in the order of `PARAMETER_NAMES`."""
    model_codes: tuple[int, int]
    """Codes of the cushion model and the ball model."""
    rails: Rails
    seconds: float
    contacts: FloatArray
    """(E, EVENT_WIDTH)"""
    segments: FloatArray
    """(L, SEGMENT_WIDTH) by ball, then by time."""

    @property
    def contact_order(self) -> bytes:
        """Kinds and partners of all contacts, in their order."""
        return self.contacts[:, [EVENT_KIND, EVENT_FIRST, EVENT_SECOND]].tobytes()


@dataclass(frozen=True, slots=True)
class ObservedStates:
    """A simulated window at its K observations."""

    xy: FloatArray
    """(K, 2) m, positions."""
    v: FloatArray
    """(K, 2) m/s, velocities."""
    t: FloatArray
    """(M,) s since the start of the window, distinct observation times, none of them before it."""
    place: IntArray
    """(K,) index of each observation's time."""
    residual: FloatArray
    """(K, 2) standard deviations by which `xy` exceeds the observations."""
    end: FloatArray
    """(1, N, 7) states at the handover to the next window, (0, N, 7) where none follows."""
    pocket_times: FloatArray
    """(N,) s, when each ball fell into a pocket; infinite where it did not."""


def simulate_window_run(
    start: FloatArray, moving: BoolArray, table: Table, values: FloatArray, model_codes: tuple[int, int], seconds: float
) -> WindowRun | None:
    """Simulate a window.

    Args:
        start: (S,) start state, as in `parametrised_shot`.
        moving: (N,) whether a ball moves at the start.
        table: Table with the usual radius and mass of a ball.
        values: (Q,) values of `SHOT_PARAMETERS`.
        model_codes: Codes of the cushion model and the ball model.
        seconds: Duration, s.

    Returns:
        The run; None where start and parameters are not finite or unphysical, or the balls touch endlessly.
    """
    possible, state, radius, mass = _build_possible_balls(start, moving, table.ball_radius, table.ball_mass, values)
    if not possible:
        return None
    physics = values[: len(PARAMETER_NAMES)]
    rails = build_rails(table, values[NOSE_OFFSETS : NOSE_OFFSETS + 4])
    seconds = max(seconds, _LEAST_SECONDS)
    try:
        contacts, segments = log_events(state, radius, mass, physics, model_codes, rails, seconds)
    except ArithmeticError:
        return None
    return WindowRun(state, radius, mass, physics, model_codes, rails, seconds, contacts, segments)


def observe_run(run: WindowRun, segment: ShotSegment, at: FloatArray, place: IntArray, end: float) -> ObservedStates:
    """Evaluate a simulated window at its observations and at its end.

    Before its start a ball moves with its first velocity; a pocketed ball stays where it was observed last.

    Args:
        run: Simulated window.
        segment: Its observations.
        at: (M,) s since the start of the window, distinct observation times.
        place: (K,) index of each observation's time.
        end: s, handover to the next window; infinite where none follows.

    Returns:
        The states and residuals.
    """
    xy, v, inside, residual, ends, pocket_times = _observe_segments(
        run.segments, run.contacts, run.radius, run.physics, run.seconds, at, place, segment.observation_indices[1],
        end, segment.observations, segment.observation_whitening,
    )  # fmt: skip
    return ObservedStates(xy, v, inside, place, residual, ends, pocket_times)


def differentiate_observations(
    run: WindowRun, observed: ObservedStates, segment: ShotSegment, table: Table, values: FloatArray,
    numbers: IntArray, end: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Differentiate the observed positions of a window, and the states at its end.

    Args:
        run: Simulated window.
        observed: Its states at the observations.
        segment: Its observations.
        table: Table with the usual mass of a ball.
        values: (Q,) values of `SHOT_PARAMETERS`.
        numbers: (A,) indices in `SHOT_PARAMETERS` of parameters that change the motion.
        end: s, handover to the next window; infinite where none follows.

    Returns:
        Derivatives (K, 2, S + A) of positions and (N, 7, S + A) of states at `end`, by the start and the parameters;
        NaN for a ball in a pocket, and where `end` is infinite.
    """
    balls, moving = segment.observation_indices[1], segment.moving
    directions = build_directions(run.state, run.radius, moving, table, values, numbers)
    active = np.sort(numbers[numbers < len(PARAMETER_NAMES)])
    t, at_times, derivatives, at_end = _allocate_derivatives(
        observed.t, observed.place, balls, len(moving), directions.shape[1]
    )
    differentiate_shot(
        run.segments, run.contacts, observed.pocket_times, run.radius, run.mass, run.physics, run.model_codes,
        run.rails.lines, run.rails.arcs, CUSHION_NORMALS, t, at_times, float(end), directions, active,
        derivatives, at_end,
    )  # fmt: skip
    return derivatives, at_end


@compile_kernel
def _build_possible_balls(start, moving, usual_radius, usual_mass, values):  # type: ignore[no-untyped-def]
    """Build state (N, 7), radius and mass (N,) of the balls, and whether `is_possible` holds, which comes first."""
    count = len(moving)
    state, radius, mass = np.zeros((count, MOVING_BALL_SIZE)), np.empty(count), np.empty(count)
    possible = is_possible(start, values)
    if possible:
        fill_balls(start, moving, usual_radius, usual_mass, values, state, radius, mass)
    return possible, state, radius, mass


@compile_kernel
def is_possible(start, values):  # type: ignore[no-untyped-def]
    """Return whether a start state (S,) and parameters (Q,) are finite and physically possible."""
    for number in start:
        if not abs(number) < _MAX_START:
            return False
    for value in values:
        if not np.isfinite(value):
            return False
    if not (values[MASS_RATIO] > 0 and values[RADIUS_RATIO] * values[RADIUS_FACTOR] > 0):
        return False
    return abs(values[NAP_MU]) < values[ROLLING_MU] or values[NAP_MU] == 0


@compile_kernel
def _observe_segments(segments, contacts, radius, p, seconds, at, place, balls, end, observations, whitening):  # type: ignore[no-untyped-def]
    """Evaluate what `observe_run` returns; arguments as of `WindowRun` and `observe_run`.

    Returns:
        xy, v (K, 2), times (M,), residual (K, 2), ends (E, N, 7) and pocket times (N,).
    """
    n, m, count = len(radius), len(at), len(place)
    pocket_times = np.full(n, np.inf)
    for k in range(len(contacts)):
        if contacts[k, EVENT_KIND] == HOLE:
            pocket_times[int(contacts[k, EVENT_FIRST])] = contacts[k, EVENT_TIME]
    inside = np.maximum(at, 0.0)
    last = 0 if end == np.inf else 1
    times = np.empty(m + last)
    times[:m] = inside
    if last:
        times[m] = end
    order = _order_times(times)
    ordered = np.full((m + last, n, STATE_SIZE), np.nan)
    fill_states(segments, pocket_times, radius, p, seconds, times[order], ordered)
    states = np.empty((m + last, n, STATE_SIZE))
    for i in range(m + last):
        states[order[i]] = ordered[i]
    last_places = states[:m, :, :2].copy()
    for i in range(1, m):
        for a in range(n):
            for j in range(2):
                if np.isnan(last_places[i, a, j]):
                    last_places[i, a, j] = last_places[i - 1, a, j]
    xy, v, residual = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2))
    for k in range(count):
        i, a = place[k], balls[k]
        before = at[i] - inside[i]
        for j in range(2):
            v[k, j] = states[i, a, 2 + j] if np.isfinite(states[i, a, 2 + j]) else 0.0
            xy[k, j] = last_places[i, a, j] + v[k, j] * before
        x, y = xy[k, 0] - observations[k, 0], xy[k, 1] - observations[k, 1]
        residual[k, 0] = whitening[k, 0, 0] * x + whitening[k, 0, 1] * y
        residual[k, 1] = whitening[k, 1, 0] * x + whitening[k, 1, 1] * y
    return xy, v, inside, residual, states[m:].copy(), pocket_times


@compile_kernel
def _order_times(times):  # type: ignore[no-untyped-def]
    """Return the order (M,) that sorts times (M,), which are usually sorted; equal ones keep theirs."""
    order = np.arange(len(times))
    for i in range(1, len(times)):
        j = i
        while j > 0 and times[order[j - 1]] > times[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
    return order


@compile_kernel
def _allocate_derivatives(times, place, balls, n, columns):  # type: ignore[no-untyped-def]
    """Sort times (M,), number the observations of each ball at each (M, N), and make room for derivatives of NaN."""
    order = _order_times(times)
    numbers = np.full((len(times), n), -1, np.int64)
    for k in range(len(place)):
        numbers[place[k], balls[k]] = k
    derivatives = np.full((len(place), 2, columns), np.nan)
    return times[order], numbers[order], derivatives, np.full((n, STATE_SIZE, columns), np.nan)


@compile_kernel
def convert_ends(ends, radius, indices):  # type: ignore[no-untyped-def]
    """Convert states at the end of a window, or their derivatives, to the start of the next one.

    Args:
        ends: (N, 7, C) states or derivatives by C numbers.
        radius: (N,) m.
        indices: (S',) which of the 7 N numbers of `convert_to_starts` start the next window.

    Returns:
        (S', C) numbers of a start or their derivatives.
    """
    converted = np.empty((len(indices), ends.shape[2]))
    for k in range(len(indices)):
        ball, number = divmod(indices[k], MOVING_BALL_SIZE)
        one, r = ends[ball], radius[ball]
        for c in range(ends.shape[2]):
            if number == 4:
                converted[k, c] = one[2, c] - r * one[5, c]
            elif number == 5:
                converted[k, c] = one[3, c] + r * one[4, c]
            elif number == 6:
                converted[k, c] = one[6, c] * r
            else:
                converted[k, c] = one[number, c]
    return converted
