"""Simulation of a shot from its initial state.

>>> state = np.array([[0.6, 0.6, 2.0, 0.1, 0.0, 0.0, 5.0]])
>>> balls = BallSet(("cue",), state, np.array([0.028575]), np.array([0.17]))
>>> physics = Physics.from_effects({"rolling_resistance": {"mu": 0.01}})
>>> shot = simulate(balls, table, physics, seconds=5.0)
>>> shot.states_at(np.linspace(0, 5, 100))  # (100, 1, 7): x, y, vx, vy, wx, wy, wz
"""

from __future__ import annotations

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.cushion_geometry import Rails, build_rails
from models.physics.billiards.simulation.event_engine import EVENT_WIDTH, SEGMENT_BALL, SEGMENT_WIDTH, simulate_events
from models.physics.billiards.simulation.simulated_shot import BallSet, SimulatedShot
from models.physics.billiards.simulation.table_physics import Physics

__all__ = ["BallSet", "Physics", "Rails", "SimulatedShot", "build_rails", "simulate"]


# Number of contacts for which there is room at first.
_FIRST_CAPACITY = 512
# What a disturbance of a cushion contact changes.
DISTURBED = ("velocity_n", "velocity_t", "slip_n", "slip_t", "side_spin")
NO_DISTURBANCES = np.empty((0, len(DISTURBED)))
# A shot with more contacts is an error.
MOST_CONTACTS = 500_000


def simulate(
    balls: BallSet,
    table: Table,
    physics: Physics,
    seconds: float,
    offsets: FloatArray | None = None,
    disturbances: FloatArray = NO_DISTURBANCES,
    correction: FloatArray = NO_CORRECTION,
) -> SimulatedShot:
    """Simulate a shot.

    Args:
        balls: Initial states, radii and masses.
        table: Size and pockets.
        physics: Strengths of the effects, and the contact models.
        seconds: Duration, s.
        offsets: (4,) m, outward offsets of the noses in the order of `CUSHIONS`; None for none.
        disturbances: (D, 5) deviations of cushion contacts from their model, see `simulate_events`.
            Derivatives of the shot do not contain them.
        correction: Weights of `rebound_correction`, which derivatives do not contain either.

    Returns:
        The shot: states, events and derivatives at any time.

    Raises:
        ValueError: The duration is not positive and finite.
        ArithmeticError: The shot has more than `MOST_CONTACTS` contacts.
    """
    if not 0 < seconds < np.inf:
        raise ValueError(f"a shot lasts for some seconds; got {seconds}")
    rails = build_rails(table, offsets)
    contacts, segments = log_events(
        balls.state, balls.radius, balls.mass, physics.values, physics.model_codes, rails, float(seconds), correction,
        disturbances,
    )  # fmt: skip
    return SimulatedShot(balls, rails, physics, float(seconds), contacts, segments)


def log_events(
    state: FloatArray,
    radius: FloatArray,
    mass: FloatArray,
    physics: FloatArray,
    model_codes: tuple[int, int],
    rails: Rails,
    seconds: float,
    correction: FloatArray = NO_CORRECTION,
    disturbances: FloatArray = NO_DISTURBANCES,
) -> tuple[FloatArray, FloatArray]:
    """Log the contacts and segments of a shot.

    Args:
        state: (N, 7) at its start.
        radius: (N,) m.
        mass: (N,) kg.
        physics: (P,) in the order of `PARAMETER_NAMES`.
        model_codes: Codes of the cushion model and the ball model.
        rails: Parts of the table.
        seconds: Duration, s.
        correction: As of `simulate`.
        disturbances: (D, 5) as of `simulate`.

    Returns:
        Contacts (E, EVENT_WIDTH) by time; segments (L, SEGMENT_WIDTH) by ball, then by time.

    Raises:
        ArithmeticError: The shot has more than `MOST_CONTACTS` contacts.
    """
    table = rails.lines, rails.arcs, rails.holes
    capacity = _FIRST_CAPACITY
    while capacity <= MOST_CONTACTS:
        contacts, segments = np.zeros((capacity, EVENT_WIDTH)), np.empty((len(state) + 2 * capacity, SEGMENT_WIDTH))
        event_count, segment_count, complete = simulate_events(
            state, radius, mass, physics, model_codes, table, seconds, correction, disturbances, contacts, segments,
        )  # fmt: skip
        if complete:  # segments are made in the order of time
            order = np.argsort(segments[:segment_count, SEGMENT_BALL], kind="stable")
            return contacts[:event_count], segments[order]
        capacity *= 8
    raise ArithmeticError(f"the balls met more than {MOST_CONTACTS} times; shorten the shot, or part balls that touch")
