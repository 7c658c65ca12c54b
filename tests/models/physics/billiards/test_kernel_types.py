"""Kernels of the engine are compiled once per type of number: a first simulation waits for every one of them."""

from __future__ import annotations

import sys

import numpy as np
from numba import types
from numba.core.dispatcher import Dispatcher

from models.physics.billiards.simulation.simulate_shot import BallSet, simulate
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.billiards.tables import TABLE_PRESETS

ENGINE = "models.physics.billiards."


def _simulate_slope() -> None:
    """Simulate and differentiate three balls that meet each other and cushions of a table with a slope."""
    table = TABLE_PRESETS["pool-9ft"]
    state = np.zeros((3, 7))
    state[:, :2] = (0.6, 0.6), (1.2, 0.62), (2.0, 0.3)
    state[0, 2:4] = 4.0, 0.1
    balls = BallSet(("cue", "1", "2"), state, np.full(3, table.ball_radius), np.full(3, table.ball_mass))
    shot = simulate(
        balls, table, Physics.from_effects({"sliding_friction": {"mu": 0.2}, "slope": {"slope_x": 1.0}}), 2.0
    )
    assert len(shot.contacts) > 2
    shot.jacobian(np.linspace(0.0, 2.0, 5))


def test_no_kernel_is_compiled_for_the_value_of_an_integer_or_for_a_read_only_array() -> None:
    _simulate_slope()
    found = [one for name, module in sys.modules.items() if name.startswith(ENGINE) for one in vars(module).values()]
    kernels = {id(one): one for one in found if isinstance(one, Dispatcher)}
    signatures = [
        (one.py_func.__name__, argument) for one in kernels.values() for s in one.signatures for argument in s
    ]
    assert len(signatures) > 100
    special = [
        (name, argument)
        for name, argument in signatures
        if isinstance(argument, types.Literal) or (isinstance(argument, types.Array) and not argument.mutable)
    ]
    assert not special
