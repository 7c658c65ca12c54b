"""A shot from its initial state.

>>> balls = Balls(("cue",), np.array([[0.6, 0.6, 2.0, 0.1, 0.0, 0.0, 5.0]]), np.array([0.028575]), np.array([0.17]))
>>> run = simulate(balls, table, Physics.of({"rolling_resistance": {"mu": 0.01}}), seconds=5.0)
>>> run.at(np.linspace(0, 5, 100))  # (100, 1, 7): x, y, vx, vy, wx, wy, wz
"""

from __future__ import annotations

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.cloth.forces import curved
from models.physics.billiards.cloth.motion_pieces import CURVED_ROWS, STRAIGHT_ROWS
from models.physics.billiards.cushion_geometry import Rails, rails
from models.physics.billiards.parameters import Physics
from models.physics.billiards.simulation.event_engine import EVENT_WIDTH, LEG_BALL, LEG_WIDTH, play
from models.physics.billiards.simulation.simulated_shot import Balls, Run, energy

__all__ = ["Balls", "Physics", "Rails", "Run", "energy", "rails", "simulate"]


_ROOM = 512
"""Contacts that are made room for at first."""
MOST_CONTACTS = 500_000


def simulate(balls: Balls, table: Table, physics: Physics, seconds: float, offsets: FloatArray | None = None) -> Run:
    """Play a shot for `seconds`; `offsets` (4,) in m move the noses outwards, in the order of `CUSHIONS`.

    ArithmeticError for a shot of more than `MOST_CONTACTS` contacts.
    """
    if not 0 < seconds < np.inf:
        raise ValueError(f"a shot lasts for some seconds; got {seconds}")
    around = rails(table, offsets)
    room = _ROOM
    while room <= MOST_CONTACTS:
        contacts, legs = np.zeros((room, EVENT_WIDTH)), np.empty((len(balls.ids) + 2 * room, LEG_WIDTH))
        done, made, complete = play(
            balls.state, balls.radius, balls.mass, physics.values, physics.codes, around.lines, around.arcs,
            around.holes, float(seconds), CURVED_ROWS if curved(physics.values) else STRAIGHT_ROWS, contacts, legs,
        )  # fmt: skip
        if complete:
            order = np.argsort(legs[:made, LEG_BALL], kind="stable")  # they are made in the order of time
            return Run(balls, around, physics, float(seconds), contacts[:done], legs[order])
        room *= 8
    raise ArithmeticError(f"the balls met more than {MOST_CONTACTS} times; shorten the shot, or part balls that touch")
