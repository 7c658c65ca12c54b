"""pooltool, the billiards engine, as a simulator under diagnosis: in a process of its own, in the Python that has it.

That is this Python, or the one that TRUEROLL_POOLTOOL_PYTHON names: pooltool pins packages that need not suit ours.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import Any

import numpy as np

from models.core.constants import GRAVITY
from models.core.errors import OptionError
from models.core.fit_result import Parameter
from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.contact_model import NOSE_HEIGHT_PARAMETER
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from pipeline.io.profile_export import build_pooltool_parameters

POOLTOOL_NAME = "pooltool"
PYTHON_VARIABLE = "TRUEROLL_POOLTOOL_PYTHON"
_SCRIPT = Path(__file__).with_name("pooltool_process.py")
# s: the first answer waits for imports and their compilation, any other for one shot.
_START_S, _SHOT_S = 120.0, 20.0
# Our contact models of pooltool's names: equal ones, and for those that we lack the nearest.
_CUSHION_FORMS = {
    "unrealistic": "mirror", "impulse_frictional_inelastic": "mirror", "han_2005": "han_2005",
    "mathavan_2010": "mathavan_2010", "stronge_compliant": "stronge",
}  # fmt: skip
_BALL_FORMS = {"frictionless_elastic": "elastic", "frictional_inelastic": "inelastic"}
_CLOTH = ("rolling_resistance.mu", "sliding_friction.mu", "spin_decay.rate")


class PooltoolSimulator:
    """pooltool; see `models.estimation.gap_scenes.foreign_shots.BilliardsSimulator`."""

    name = POOLTOOL_NAME

    def __init__(self, command: tuple[str, ...]) -> None:
        """Start a process."""
        self._command = command
        models = self._start()
        cushion, ball = _CUSHION_FORMS.get(models["cushion"], "mirror"), _BALL_FORMS.get(models["ball"], "inelastic")
        self.laws = ContactModels(cushion, "alciatore" if models["friction"] == "alciatore" else ball)
        self.nose_height = float(models["cushion_height"])
        params = models["params"]
        restitution = params["e_b"]
        self.stated: Mapping[str, float] = {
            "rolling_resistance.mu": params["u_r"], "sliding_friction.mu": params["u_s"],
            "spin_decay.rate": params["u_sp_proportionality"] * 5 * GRAVITY / 2,
            "cushion_restitution.e": params["e_c"], "cushion_friction.mu": params["f_c"],
            "ball_restitution.e": restitution,
            "ball_friction.mu": params["u_b"] * 2 * restitution / (1 + restitution),
        }  # fmt: skip
        self._has_rubbing_cushion = models["cushion"] != "unrealistic"

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle how to start it again, once in each process of ours that it is sent to."""
        return _start_once, (self._command,)

    @property
    def process_id(self) -> int:
        """Number of its process."""
        return self._process.pid

    def close(self) -> None:
        """End its process, which also ends when this object goes."""
        self._end()

    def _start(self) -> Any:
        """Start a process and return what its models are."""
        self._process, self._answers, models = _start(self._command)
        self._end = weakref.finalize(self, _stop, self._process)
        return models

    def holds(self, laws: ContactModels) -> frozenset[str]:
        """Name the parameters that it can hold with these contact models."""
        is_own_mirror = laws.cushion == self.laws.cushion == "mirror"
        rubs = laws.cushion != "mirror" or (is_own_mirror and self._has_rubbing_cushion)
        return frozenset(
            (*_CLOTH, "cushion_restitution.e")
            + (("ball_restitution.e",) if laws.ball != "elastic" else ())
            + (("ball_friction.mu",) if laws.ball == "inelastic" else ())
            + (("cushion_friction.mu",) if rubs else ())
            + ((NOSE_HEIGHT_PARAMETER,) if laws.cushion != "mirror" else ())
        )

    def simulate(
        self, states: FloatArray, table: Table, values: Mapping[str, float], laws: ContactModels, t: FloatArray
    ) -> FloatArray | None:
        """Simulate a shot; see `BilliardsSimulator.simulate`."""
        fitted = [Parameter(name, value, 0.0, "", False) for name, value in values.items()]
        document = build_pooltool_parameters(fitted, laws.cushion, laws.ball, table)
        resolver: dict[str, Any] = {}
        if laws.cushion != self.laws.cushion:
            resolver |= {"cushion": document["ball_cushion"], "cushion_options": document["ball_cushion_options"]}
        if laws.ball != self.laws.ball:
            resolver |= {"ball": document["ball_ball"], "friction": document["ball_ball_friction"]}
        request = {"states": states.tolist(), "t": t.tolist(), "params": document["ball_params"],
                   "table": document["table_specs"], "resolver": resolver}  # fmt: skip
        answer = self._ask(request)
        return None if "error" in answer else np.array(answer["xy"], np.float64)

    def _ask(self, request: Mapping[str, Any]) -> Any:
        """Send a request and wait for its answer; a process that hangs or dies is replaced."""
        assert self._process.stdin is not None
        try:
            print(json.dumps(request), file=self._process.stdin, flush=True)
            line = self._answers.get(timeout=_SHOT_S)
        except (OSError, Empty):
            line = ""
        if line:
            return json.loads(line)
        self.close()
        self._start()
        return {"error": "no answer"}


@cache
def _start_once(command: tuple[str, ...]) -> PooltoolSimulator:
    """Start a simulator, or return the one that this process has: a fit is sent to a helper process in many parts."""
    return PooltoolSimulator(command)


def open_pooltool() -> PooltoolSimulator:
    """Open pooltool in this Python, or in the one that the environment names.

    Raises:
        OptionError: It is not installed there, or does not start.
    """
    python = os.environ.get(PYTHON_VARIABLE, "")
    if not python and importlib.util.find_spec("pooltool") is None:
        raise OptionError(
            "pooltool is not installed here: pip install pooltool-billiards, or name the Python that has it in"
            f" {PYTHON_VARIABLE}"
        )
    return PooltoolSimulator((python or sys.executable, str(_SCRIPT)))


def _start(command: tuple[str, ...]) -> tuple[subprocess.Popen[str], Queue[str], dict[str, Any]]:
    """Start a process and read what its models are; its answers come through a queue, so that one can stop waiting."""
    try:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
    except OSError as error:
        raise OptionError(f"{command[0]} ({PYTHON_VARIABLE}) does not start: {error.strerror}") from error
    answers: Queue[str] = Queue()
    Thread(target=_collect, args=(process, answers), daemon=True).start()
    try:
        first = answers.get(timeout=_START_S)
        return process, answers, json.loads(first)
    except (Empty, json.JSONDecodeError) as error:
        _stop(process)
        raise OptionError(
            f"{command[0]} has no pooltool that starts; expected: the Python of an environment with pooltool-billiards"
        ) from error


def _collect(process: subprocess.Popen[str], answers: Queue[str]) -> None:
    """Collect the lines of a process; an empty one is its end."""
    assert process.stdout is not None
    with process.stdout:
        for line in process.stdout:
            answers.put(line)
    answers.put("")


def _stop(process: subprocess.Popen[str]) -> None:
    """End a process."""
    assert process.stdin is not None
    process.kill()
    with suppress(OSError):  # what it has not read
        process.stdin.close()
    process.wait()
