"""Kernels of the engine are compiled once per type of number: a first simulation waits for every one of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import types
from numba.core.dispatcher import Dispatcher
from support.shot_inputs import differentiate_states

from models.physics.billiards.simulation.simulate_shot import BallSet, simulate
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.billiards.tables import TABLE_PRESETS

ROOT = Path(__file__).resolve().parents[4]


def list_special_types() -> list[str]:
    """Simulate and differentiate balls on a slope; list arguments that a kernel was compiled for in particular."""
    table = TABLE_PRESETS["pool-9ft"]
    state = np.zeros((3, 7))
    state[:, :2] = (0.6, 0.6), (1.2, 0.62), (2.0, 0.3)
    state[0, 2:4] = 4.0, 0.1
    balls = BallSet(("cue", "1", "2"), state, np.full(3, table.ball_radius), np.full(3, table.ball_mass))
    physics = Physics.from_effects({"sliding_friction": {"mu": 0.2}, "slope": {"slope_x": 1.0}})
    shot = simulate(balls, table, physics, 2.0)
    assert len(shot.contacts) > 2
    differentiate_states(shot, np.linspace(0.0, 2.0, 5))
    modules = [module for name, module in sys.modules.items() if name.startswith("models.")]
    kernels = {id(one): one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher)}
    arguments = [(one.py_func.__name__, each) for one in kernels.values() for s in one.signatures for each in s]
    assert len(arguments) > 300
    return [
        f"{name}: {each}"
        for name, each in arguments
        if isinstance(each, types.Literal) or (isinstance(each, types.Array) and not each.mutable)
    ]


@pytest.mark.slow
def test_no_kernel_is_compiled_for_the_value_of_an_integer_or_for_a_read_only_array(tmp_path: Path) -> None:
    """In a process of its own without compiled code: from the cache, only the outermost kernels have types."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
    done = subprocess.run([sys.executable, __file__], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


if __name__ == "__main__":
    print("\n".join(list_special_types()), end="")
