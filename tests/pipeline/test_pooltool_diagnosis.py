"""A whole diagnosis with an engine of billiards from outside, for which a stand-in of equal physics plays."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from support.pseudo_terminal import Terminal, make_terminal

import trueroll
from pipeline.io.simulators.pooltool_simulator import PYTHON_VARIABLE

terminal = pytest.fixture(make_terminal)
ROOT = Path(__file__).resolve().parents[2]
# It plays by `trueroll.simulate`, and states a rolling resistance of 0.02 where that of the table is 0.01.
STAND_IN = """#!{python}
import json, os, sys
sys.path.insert(0, {root!r})
import numpy as np
import trueroll
answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
print(json.dumps({{"version": "0", "cushion": "stronge_compliant", "ball": "frictional_inelastic",
    "friction": "alciatore", "cushion_height": 1.27,
    "params": dict(u_s=0.2, u_r=0.02, u_sp_proportionality=0.4, u_b=0.05, e_b=0.95, e_c=0.85, f_c=0.2)}}),
    file=answers, flush=True)
for line in sys.stdin:
    request = json.loads(line)
    p, table = request["params"], request["table"]
    names = ("x", "y", "vx", "vy", "wx", "wy", "wz")
    balls = [dict(zip(names, state), id=str(k)) for k, state in enumerate(request["states"])]
    played = trueroll.simulate({{"table": {{"length": table["l"], "width": table["w"]}},
        "seconds": request["t"][-1] + 0.1, "balls": balls, "laws": {{"cushion": "stronge", "ball": "alciatore"}},
        "effects": {{"sliding_friction": {{"mu": p["u_s"]}}, "rolling_resistance": {{"mu": p["u_r"]}},
                     "cushion_restitution": {{"e": p["e_c"]}}, "cushion_friction": {{"mu": p["f_c"]}}}}}})
    xy = played.states_at(np.array(request["t"]))[..., :2].tolist()
    print(json.dumps({{"xy": xy}}), file=answers, flush=True)
"""


def film_sloping_table(folder: Path) -> None:
    """Film eight shots of a ball that rolls freely on a table that slopes by 2 mm/m along x."""
    rng, rows = np.random.default_rng(0), ["shot,frame,t,id,x,y"]
    for shot in range(8):
        vx, vy = 0.5 * np.cos(2 * np.pi * shot / 8), 0.5 * np.sin(2 * np.pi * shot / 8)
        ball = {"id": "cue", "x": 1.27, "y": 0.635, "vx": vx, "vy": vy, "wx": -vy / 0.028575, "wy": vx / 0.028575}
        effects = {"sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.01}, "slope": {"slope_x": 2.0}}
        played = trueroll.simulate(
            {"table": {"length": 2.54, "width": 1.27}, "seconds": 1.6, "balls": [ball], "effects": effects}
        )
        t = np.arange(90) / 60
        xy = played.states_at(t)[:, 0, :2] + rng.normal(0.0, 5e-4, (90, 2))
        rows += [f"{shot},{k},{k / 60:.6f},cue,{x:.6f},{y:.6f}" for k, (x, y) in enumerate(xy)]
    folder.mkdir()
    (folder / "tracks.csv").write_text("\n".join(rows) + "\n")
    scene = {"scene": "billiards", "units": "m", "fps": 60, "table": {"length": 2.54, "width": 1.27},
             "ball_radius": 0.028575}  # fmt: skip
    (folder / "scene.json").write_text(json.dumps(scene))


@pytest.mark.slow
def test_a_slope_that_another_engine_lacks_is_named_and_its_coefficient_is_corrected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, terminal: Terminal
) -> None:
    script = tmp_path / "engine.py"
    script.write_text(STAND_IN.format(python=sys.executable, root=str(ROOT)))
    script.chmod(0o755)
    monkeypatch.setenv(PYTHON_VARIABLE, str(script))
    film_sloping_table(tmp_path / "shots")
    done = terminal("diagnose", str(tmp_path / "shots"), "--simulator", "pooltool", "-o", str(tmp_path / "gap"))
    assert done.status == 0, done.out
    assert "Your simulator lacks slope. Coefficients of your simulator are wrong" in done.out
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    slope = gap["fitted"]["slope.slope_x"]
    assert slope["value"] == pytest.approx(2.0, abs=max(4 * slope["sigma"], 0.1))
    assert gap["gap"]["as_stated"] > 1.2 * gap["gap"]["before"]
    assert any("your rolling resistance" in note and "is 0.02" in note for note in gap["notes"])


def test_a_missing_pooltool_is_one_sentence_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, terminal: Terminal
) -> None:
    film_sloping_table(tmp_path / "shots")
    monkeypatch.setenv(PYTHON_VARIABLE, str(tmp_path / "nothing"))
    done = terminal("diagnose", str(tmp_path / "shots"), "--simulator", "pooltool", "-o", str(tmp_path / "gap"))
    assert done.status == 2
    assert "does not start" in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "gap").exists()
