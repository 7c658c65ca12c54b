"""Is the effect named that a MuJoCo file lacks, and what is said where nothing is missing?

    python -m benchmarks.diagnosis.outside_simulators [-o DIR] [--seeds 1] [--first 0] [--worlds arm] [--effects delay]

Worlds are pendulums of one and two links, a cart with a pole, an arm of two driven joints, and a thrown ball. The
truth is MuJoCo with one or two effects, played at 100 Hz with noise of 1 mrad or 1 mm; the simulator is the same file
without them. Eight runs of three seconds each. Effects that MuJoCo does not have (delay, lag, drag) act step by step
outside of it. Prints verdict and gap of every case, and the counts. A run with the same DIR continues. Takes about a
minute per case on two idle cores.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.support.row_files import append_row, read_rows
from benchmarks.support.run_folder import ROOT
from models.core.typing import FloatArray
from pipeline.engine.helper_executor import open_executor
from pipeline.simulator_diagnosis import diagnose_mechanism

RATE, SECONDS, RUNS, STEP, NOISE = 100, 3.0, 8, 0.002, 1e-3
HINGE = '<joint name="{}" type="hinge" axis="0 1 0"{}/>'
LINK = '<geom type="capsule" fromto="0 0 0 0 0 -{0}" size="0.02" mass="{1}" contype="0" conaffinity="0"/>'
DRIVEN = '<actuator><motor name="motor_1" joint="shoulder"/><motor name="motor_2" joint="elbow"/></actuator>'


@dataclass(frozen=True)
class World:
    """A mechanism: its bodies, its actuators, and the size of start positions and inputs."""

    bodies: str
    actuators: str
    spread: float
    push: tuple[float, ...]
    flies: bool = False
    """Whether a body flies freely."""
    effects: tuple[str, ...] = ()
    """Effects that are withheld in it; all where there are none."""

    def write(self, joint: str = "") -> str:
        """Write the file, with attributes for every joint."""
        bodies = self.bodies.replace("@", f" {joint}")
        return (
            f'<mujoco><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast"/>'
            f"<worldbody>{bodies}</worldbody>{self.actuators}</mujoco>"
        )


def hang(name: str, length: float, mass: float, below: str = "", place: str = "0 0 0") -> str:
    """Write a link with what hangs from it; `@` stands for attributes of its joint."""
    return f'<body pos="{place}">{HINGE.format(name, "@")}{LINK.format(length, mass)}{below}</body>'


LOWER = hang("elbow", 0.25, 0.3, place="0 0 -0.3")
WORLDS = {
    "pendulum": World(hang("hinge", 0.4, 0.5), "", 1.2, ()),
    "double pendulum": World(hang("shoulder", 0.3, 0.5, LOWER), "", 0.7, ()),
    "arm": World(hang("shoulder", 0.3, 0.5, LOWER), DRIVEN, 0.5, (0.3, 0.1)),
    "cart": World(
        '<body><joint name="cart" type="slide" axis="1 0 0"@/><geom type="box" size="0.1 0.05 0.05" mass="1"'
        f' contype="0" conaffinity="0"/>{hang("pole", 0.4, 0.2)}</body>',
        '<actuator><motor name="motor_1" joint="cart"/></actuator>', 0.5, (2.0,),
    ),
    "thrown ball": World(
        '<body name="ball"><freejoint/><geom type="sphere" size="0.05" mass="0.1"/></body>', "", 0.0, (), True,
        ("none", "air_drag", "gravity"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Withheld:
    """What the truth has and the simulator lacks."""

    joint: str = ""
    """Attributes of every joint in its file."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay: int = 0
    """Steps by which inputs act later."""
    lag: float = 0.0
    """s"""
    gain: float = 1.0
    drag: float = 0.0
    """N m/(rad/s)2"""
    offset: float = 0.0
    scale: float = 1.0
    needs_input: bool = False


Draw = Callable[[np.random.Generator], Withheld]
EFFECTS: dict[str, Draw] = {
    "none": lambda rng: Withheld(),
    "joint_friction": lambda rng: Withheld(
        f'damping="{rng.uniform(0.005, 0.03):.4f}" frictionloss="{rng.uniform(0.01, 0.05):.4f}"'
    ),
    "armature": lambda rng: Withheld(f'armature="{rng.uniform(0.003, 0.01):.5f}"'),
    "spring": lambda rng: Withheld(f'stiffness="{rng.uniform(0.1, 0.4):.3f}"'),
    "air_drag": lambda rng: Withheld(drag=rng.uniform(0.002, 0.008)),
    "gravity": lambda rng: Withheld(gravity=(rng.uniform(0.4, 1.2), 0.0, rng.uniform(-0.5, 0.5))),
    "sensor_offset": lambda rng: Withheld(offset=rng.uniform(0.02, 0.06)),
    "sensor_scale": lambda rng: Withheld(scale=1 + rng.uniform(0.02, 0.06)),
    "delay": lambda rng: Withheld(delay=int(rng.integers(8, 20)), needs_input=True),
    "actuator_lag": lambda rng: Withheld(lag=rng.uniform(0.02, 0.06), needs_input=True),
    "actuator_gain": lambda rng: Withheld(gain=1 - rng.uniform(0.1, 0.3), needs_input=True),
    # two at once, in the order of their names
    "air_drag+joint_friction": lambda rng: replace(EFFECTS["joint_friction"](rng), drag=rng.uniform(0.003, 0.008)),
    "delay+joint_friction": lambda rng: replace(
        EFFECTS["joint_friction"](rng), delay=int(rng.integers(8, 20)), needs_input=True
    ),
}


@dataclass(frozen=True)
class OutsideRow:
    """Result of one case."""

    case: str
    truth: str
    verdict: str
    named: str
    probability: float
    closed: float
    seconds: float

    @property
    def is_right(self) -> bool:
        """Whether exactly the withheld effect is named, or nothing where nothing is missing."""
        return self.verdict == "none" if self.truth == "none" else self.named == self.truth

    @property
    def is_in_group(self) -> bool:
        """Whether it is named, perhaps with others that these runs cannot separate from it."""
        return self.is_right or set(self.truth.split("+")) <= set(self.named.split("+"))


def play(world: World, hidden: Withheld, rng: np.random.Generator) -> list[str]:
    """Play the runs of a truth, and return the lines of their table."""
    model = mujoco.MjModel.from_xml_string(world.write(hidden.joint))
    model.opt.gravity[:] += hidden.gravity
    joints = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k) for k in range(model.njnt)]
    joints = ["ball.x", "ball.y", "ball.z"] if world.flies else joints
    lines = [",".join(["shot", "t", *joints, *(f"motor_{k + 1}" for k in range(model.nu))])]
    for shot in range(RUNS):
        data: Any = mujoco.MjData(model)
        if world.flies:
            data.qvel[:3] = rng.uniform((4, -2, 2), (9, 2, 6))
        else:
            data.qpos[:] = rng.uniform(-world.spread, world.spread, model.nq)
        rates, phases = rng.uniform(2.0, 9.0, model.nu), rng.uniform(0, 2 * np.pi, model.nu)
        waiting = [np.zeros(model.nu)] * hidden.delay
        acting = np.zeros(model.nu)
        for row in range(round(SECONDS * RATE)):
            t = row / RATE
            told: FloatArray = np.array(world.push) * np.sin(rates * t + phases)
            place = data.qpos[: len(joints)]
            seen = hidden.scale * place + hidden.offset + NOISE * rng.standard_normal(len(joints))
            lines.append(",".join(f"{x:.6f}" for x in (shot, t, *seen, *told)))
            for _ in range(round(1 / (RATE * STEP))):
                waiting.append(told)
                now = waiting.pop(0)
                acting = acting + (now - acting) * (1 - np.exp(-STEP / hidden.lag)) if hidden.lag else now
                data.ctrl[:] = hidden.gain * acting
                speed = np.linalg.norm(data.qvel[:3]) if world.flies else np.abs(data.qvel)
                data.qfrc_applied[:] = -hidden.drag * speed * data.qvel
                mujoco.mj_step(model, data)
    return lines


def run_case(world: str, truth: str, seed: int, folder: Path) -> OutsideRow:
    """Diagnose one case."""
    rng = np.random.default_rng([seed, list(WORLDS).index(world), list(EFFECTS).index(truth)])
    name = f"{world.replace(' ', '_')}-{truth}-{seed}"
    real, simulator = folder / f"{name}.csv", folder / f"{world.replace(' ', '_')}.xml"
    simulator.write_text(WORLDS[world].write())
    real.write_text("\n".join(play(WORLDS[world], EFFECTS[truth](rng), rng)) + "\n")
    start = time.monotonic()
    with open_executor() as executor:
        report = diagnose_mechanism([real], str(simulator), seed, executor=executor)[0]
    names = report.effects or (report.candidates[0].group if report.verdict == "group" else ())
    return OutsideRow(
        name, truth, report.verdict, "+".join(sorted(names)), report.probability, report.gap.closure.closed,
        time.monotonic() - start,
    )  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "outside_simulators", help="folder of results")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--worlds", default=",".join(WORLDS), help="worlds, separated by commas")
    parser.add_argument("--effects", default=",".join(EFFECTS), help="withheld effects, separated by commas")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    table = options.out / "rows.csv"
    rows = {row.case: row for row in read_rows(table, OutsideRow)}
    rng = np.random.default_rng(0)
    for seed in range(options.first, options.first + options.seeds):
        for world in options.worlds.split(","):
            for truth in options.effects.split(","):
                name = f"{world.replace(' ', '_')}-{truth}-{seed}"
                own = WORLDS[world]
                if name in rows or (EFFECTS[truth](rng).needs_input and not own.push):
                    continue
                if own.effects and truth not in own.effects:
                    continue
                rows[name] = run_case(world, truth, seed, options.out)
                append_row(rows[name], table)
                print(rows[name], file=sys.stderr, flush=True)
    done = list(rows.values())
    print("| cases | named | named or in a group | false alarms of cases without | median s |")
    print("|---|---|---|---|---|")
    missing, sound = [row for row in done if row.truth != "none"], [row for row in done if row.truth == "none"]
    counts = [len(done), sum(r.is_right for r in missing), sum(r.is_in_group for r in missing)]
    alarms = f"{sum(not row.is_right for row in sound)} of {len(sound)}"
    print("|", " | ".join(map(str, [*counts, alarms, round(float(np.median([r.seconds for r in done])))])), "|")
    return 0


if __name__ == "__main__":
    sys.exit(main())
