"""pooltool in a process of its own: what is sent to it, and what happens where it is missing, fails, dies or hangs."""

from __future__ import annotations

import importlib.util
import json
import os
import pickle
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.simulated_shots import TABLE

from models.core.errors import OptionError
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from pipeline.io.simulators import pooltool_simulator
from pipeline.io.simulators.pooltool_simulator import PYTHON_VARIABLE, PooltoolSimulator, open_pooltool
from pipeline.simulator_diagnosis import pair_with_pooltool

# Balls that move straight on; the first one's place tells what goes wrong.
STAND_IN = """#!{python}
import json, os, sys, time
models = {{"version": "0", "cushion": "{cushion}", "ball": "frictional_inelastic", "friction": "alciatore",
          "params": dict(u_s=0.2, u_r=0.01, u_sp_proportionality=0.4, u_b=0.05, e_b=0.95, e_c=0.85, f_c=0.2),
          "cushion_height": 1.29}}
print(json.dumps(models), flush=True)
for line in sys.stdin:
    request = json.loads(line)
    open({log!r}, "w").write(line)
    first = request["states"][0][0]
    if first < 0:
        print(json.dumps({{"error": "off the table"}}), flush=True)
        continue
    if first > 100:
        os._exit(1)
    if first > 10:
        time.sleep(60)
    xy = [[[x + vx * t, y + vy * t] for x, y, vx, vy, *_ in request["states"]] for t in request["t"]]
    print(json.dumps({{"xy": xy}}), flush=True)
"""
VALUES = {"rolling_resistance.mu": 0.02, "sliding_friction.mu": 0.3, "cushion_restitution.e": 0.7}


def write_stand_in(folder: Path, cushion: str = "stronge_compliant") -> Path:
    """Write an executable that answers as pooltool's side does."""
    script = folder / "pooltool.py"
    log = str(folder / "request.json")
    script.write_text(STAND_IN.format(python=sys.executable, log=log, cushion=cushion))
    script.chmod(0o755)
    return script


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[PooltoolSimulator]:
    monkeypatch.setenv(PYTHON_VARIABLE, str(write_stand_in(tmp_path)))
    simulator = open_pooltool()
    yield simulator
    simulator.close()


def play(simulator: PooltoolSimulator, x: float, laws: ContactModels | None = None) -> np.ndarray | None:
    """Play two balls, the first at x."""
    states = np.zeros((2, 7))
    states[:, :4] = [[x, 0.5, 1.0, 0.0], [2.0, 0.5, 0.0, 0.0]]
    return simulator.simulate(states, TABLE, VALUES, laws or simulator.laws, np.array([0.0, 0.5]))


def test_its_models_and_values_are_those_of_its_user(opened: PooltoolSimulator) -> None:
    assert opened.laws == ContactModels("stronge", "alciatore")
    assert opened.stated["rolling_resistance.mu"] == 0.01
    assert opened.stated["spin_decay.rate"] == pytest.approx(0.4 * 2.5 * 9.81, rel=1e-3)
    assert opened.stated["ball_friction.mu"] == pytest.approx(0.05 * 2 * 0.95 / 1.95)
    # Alciatore's law has a friction of its own, a mirror has none and no height
    assert "ball_friction.mu" not in opened.holds(opened.laws)
    assert "ball_friction.mu" in opened.holds(ContactModels("stronge", "inelastic"))
    assert not {"cushion_friction.mu", "cushion_height.ratio"} & opened.holds(ContactModels("mirror", "alciatore"))


def test_a_shot_is_sent_in_its_names_and_other_laws_as_its_models(opened: PooltoolSimulator, tmp_path: Path) -> None:
    path = play(opened, 1.0)
    assert path is not None
    np.testing.assert_allclose(path, [[[1.0, 0.5], [2.0, 0.5]], [[1.5, 0.5], [2.0, 0.5]]])
    request = json.loads((tmp_path / "request.json").read_text())
    assert (request["params"]["u_r"], request["params"]["u_s"], request["params"]["e_c"]) == (0.02, 0.3, 0.7)
    assert request["resolver"] == {}  # its own models, with the options that its user gave them
    assert request["table"]["l"] == TABLE.length
    play(opened, 1.0, ContactModels("han_2005", "inelastic"))
    assert json.loads((tmp_path / "request.json").read_text())["resolver"] == {
        "cushion": "han_2005", "cushion_options": {}, "ball": "frictional_inelastic", "friction": "average",
    }  # fmt: skip


def test_shots_that_fail_are_lost_and_a_process_that_dies_or_hangs_is_replaced(
    opened: PooltoolSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pooltool_simulator, "_SHOT_S", 1.0)
    for x in (-1.0, 200.0, 20.0):
        assert play(opened, x) is None
        assert play(opened, 1.0) is not None


def test_another_process_of_ours_starts_its_own_and_only_one(opened: PooltoolSimulator) -> None:
    sent = pickle.dumps(opened)
    again, once_more = pickle.loads(sent), pickle.loads(sent)
    assert once_more is again
    assert again.process_id != opened.process_id
    assert play(again, 1.0) is not None
    again.close()


def test_a_cushion_that_rubs_and_has_no_equal_here_keeps_its_friction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PYTHON_VARIABLE, str(write_stand_in(tmp_path, "impulse_frictional_inelastic")))
    simulator = open_pooltool()
    assert simulator.laws.cushion == "mirror"
    assert "cushion_friction.mu" in simulator.holds(simulator.laws)
    simulator.close()


def test_a_missing_package_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(PYTHON_VARIABLE, raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(OptionError, match="pip install pooltool-billiards"):
        open_pooltool()
    monkeypatch.setenv(PYTHON_VARIABLE, str(tmp_path / "no_python"))
    with pytest.raises(OptionError, match="does not start: No such file"):
        open_pooltool()
    empty = tmp_path / "empty"
    empty.write_text("#!/bin/sh\nexit 1\n")
    empty.chmod(0o755)
    monkeypatch.setenv(PYTHON_VARIABLE, str(empty))
    with pytest.raises(OptionError, match="has no pooltool that starts"):
        open_pooltool()


def test_pooltool_is_asked_for_billiards_alone() -> None:
    with pytest.raises(OptionError, match="these recordings are of the scene flight"):
        pair_with_pooltool(build_flight_scene(2, 9.81, (), False))


@pytest.mark.skipif(
    not os.environ.get(PYTHON_VARIABLE) and importlib.util.find_spec("pooltool") is None,
    reason=f"pooltool is not installed, and {PYTHON_VARIABLE} names no Python that has it",
)
def test_pooltool_itself_rolls_a_ball_along_x_as_theory_says() -> None:
    simulator = open_pooltool()
    states = np.zeros((1, 7))
    states[0] = 0.5, 0.4, 1.0, 0.5, -0.5 / TABLE.ball_radius, 1.0 / TABLE.ball_radius, 0.0
    t = np.array([0.0, 0.5, 1.0])
    path = simulator.simulate(states, TABLE, VALUES, simulator.laws, t)
    simulator.close()
    assert path is not None
    way = np.hypot(1.0, 0.5) * t - 0.02 * 9.81 * t**2 / 2
    np.testing.assert_allclose(path[:, 0], [0.5, 0.4] + way[:, None] * np.array([2.0, 1.0]) / np.sqrt(5), atol=1e-4)
