"""Is the effect named that a MuJoCo file lacks, and what is said where nothing is missing?

    python -m benchmarks.diagnosis.outside_simulators [-o DIR] [--questions one,two] [--seeds 1] [--first 0]
        [--worlds arm] [--effects delay] [--noise white] [--runs 8] [--length 3] [--laws]

Worlds are pendulums of one to three links, a Furuta pendulum, carts with a pole that a motor or a servo drives, an arm
of two driven joints, masses in a chain of springs, and a thrown ball. The truth is MuJoCo with one or two effects, or
with a force of a form that no effect has, played at 100 Hz with noise of 1 mrad or 1 mm; the simulator is the same file
without them. Effects that MuJoCo does not have (delay, lag, drag, foreign forces) act step by step outside of it. Noise
is white, correlated (0.8 from sample to sample) or quantised (steps of 2 mrad or mm). Each question has its effects,
noise, number and length of runs, which the other options replace. Prints the answer to every case, the counts with
Wilson's intervals, and the cases that were sure and wrong. A run with the same DIR continues. One process; a case takes
2 to 150 CPU seconds.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.signal import lfilter

from benchmarks.support.row_files import append_row, read_rows
from benchmarks.support.run_folder import ROOT
from diagnosis.fitting.diagnosis_windows import fit_initial_windows
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem
from diagnosis.fitting.shot_preparation import apply_noise_estimate, estimate_noise, split_shots
from diagnosis.unexplained.force_law import ForceLaw, find_force_law, measure_resolved_acceleration
from models.core.typing import FloatArray
from models.estimation.gap_scenes.simulator_scene import build_simulator_scene
from pipeline.experiments.gapcheck.blind_case import Proportion
from pipeline.io.simulators.mechanism_recordings import read_mechanism_shots
from pipeline.simulator_diagnosis import diagnose_mechanism

RATE, STEP, NOISE = 100, 0.002, 1e-3
NOISE_KINDS = ("white", "correlated", "quantised")
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
    unmeasured: int = 0
    """Number of last joints that have no sensor."""

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


FOREIGN = ("foreign_angle", "foreign_time", "foreign_speed")
LOWER = hang("elbow", 0.25, 0.3, place="0 0 -0.3")
CART = (
    '<body><joint name="cart" type="slide" axis="1 0 0"@/><geom type="box" size="0.1 0.05 0.05" mass="{}" contype="0"'
    f' conaffinity="0"/>{hang("pole", 0.4, 0.2)}</body>'
)
MASS = (
    '<body pos="{0} 0 0"><joint name="mass_{0}" type="slide" axis="1 0 0"@/><geom type="box" size="0.1 0.05 0.05"'
    ' mass="0.3" contype="0" conaffinity="0"/></body>'
)
SPRINGS = (
    '<tendon><fixed stiffness="8"><joint joint="mass_0" coef="1"/></fixed>'
    '<fixed stiffness="6"><joint joint="mass_1" coef="1"/><joint joint="mass_0" coef="-1"/></fixed></tendon>'
)
WORLDS = {
    "pendulum": World(hang("hinge", 0.4, 0.5), "", 1.2, ()),
    "double pendulum": World(hang("shoulder", 0.3, 0.5, LOWER), "", 0.7, ()),
    "arm": World(hang("shoulder", 0.3, 0.5, LOWER), DRIVEN, 0.5, (0.3, 0.1)),
    "cart": World(CART.format(1), '<actuator><motor name="motor_1" joint="cart"/></actuator>', 0.5, (2.0,)),
    "three links": World(
        hang("shoulder", 0.3, 0.5, hang("elbow", 0.25, 0.3, hang("wrist", 0.2, 0.2, place="0 0 -0.25"), "0 0 -0.3")),
        "", 0.5, (),
    ),
    "furuta": World(
        '<body><joint name="arm" axis="0 0 1"@/><geom type="capsule" fromto="0 0 0 0 0.2 0" size="0.02" mass="0.4"'
        f' contype="0" conaffinity="0"/>{hang("pendulum", 0.3, 0.3, place="0 0.2 0")}</body>',
        '<actuator><motor name="motor_1" joint="arm"/></actuator>', 0.7, (0.2,),
    ),
    "crane": World(
        CART.format(0.5), '<actuator><position name="motor_1" joint="cart" kp="20" kv="4"/></actuator>', 0.3, (0.3,),
        False, ("none", "joint_friction", "delay", "actuator_lag", "sensor_offset", "delay+joint_friction"),
    ),
    "chain": World(
        MASS.format(0) + MASS.format(1), SPRINGS, 0.3, (), False,
        ("none", "joint_friction", "spring", "sensor_offset", "joint_friction+spring"),
    ),
    "arm without elbow sensor": World(
        hang("shoulder", 0.3, 0.5, LOWER), DRIVEN, 0.5, (0.3, 0.1), False,
        ("none", "joint_friction", "delay", "actuator_gain"), 1,
    ),
    "slider": World(
        '<body><joint name="slider" type="slide" axis="1 0 0" stiffness="8"@/><geom type="box" size="0.1 0.05 0.05"'
        ' mass="0.3" contype="0" conaffinity="0"/></body>', "", 0.5, (), False, ("none", *FOREIGN),
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
    foreign: Callable[[float, float, float], float] | None = None
    """Force on the first joint, N m or N, of a form that no effect has: by time (s), position in spreads of the starts,
    and velocity in five of these per second."""
    variable: str = ""
    """What the foreign force varies with."""


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
    "armature+joint_friction": lambda rng: Withheld(
        EFFECTS["joint_friction"](rng).joint + f' armature="{rng.uniform(0.003, 0.01):.5f}"'
    ),
    "joint_friction+spring": lambda rng: Withheld(
        EFFECTS["joint_friction"](rng).joint + f' stiffness="{rng.uniform(0.1, 0.4):.3f}"'
    ),
    "actuator_gain+joint_friction": lambda rng: replace(
        EFFECTS["joint_friction"](rng), gain=1 - rng.uniform(0.1, 0.3), needs_input=True
    ),
    "foreign_angle": lambda rng: draw_foreign(rng, "position"),
    "foreign_time": lambda rng: draw_foreign(rng, "time"),
    "foreign_speed": lambda rng: draw_foreign(rng, "speed"),
}


@dataclass(frozen=True)
class Question:
    """Cases of one row of the table."""

    effects: tuple[str, ...]
    noise: tuple[str, ...] = ("white",)
    runs: int = 8
    length: float = 3.0
    """s per run."""


QUESTIONS = {
    "one": Question(tuple(one for one in EFFECTS if one not in ("none", *FOREIGN) and "+" not in one)),
    "two": Question(tuple(one for one in EFFECTS if "+" in one)),
    "none": Question(("none",), NOISE_KINDS, 6, 1.0),
    "foreign": Question(FOREIGN),
}
# Worlds of one joint, which a foreign force accelerates by force over a constant inertia.
FOREIGN_WORLDS = ("pendulum", "slider")


def draw_foreign(rng: np.random.Generator, variable: str) -> Withheld:
    """Draw a force that varies with position (teeth of a motor), time (a pump nearby) or speed (a belt that drives)."""
    size, rate, phase = rng.uniform(0.05, 0.15), rng.uniform(4.0, 6.0), rng.uniform(0, 2 * np.pi)
    start = rng.uniform(0.5, 0.8)
    laws: dict[str, Callable[[float, float, float], float]] = {
        "position": lambda t, q, v: size * np.sin(rate * q + phase),
        "time": lambda t, q, v: size * np.sin(rate * t + phase),
        "speed": lambda t, q, v: size * v * (1 - (v / start) ** 2) / start,
    }
    return Withheld(foreign=laws[variable], variable=variable)


@dataclass(frozen=True)
class OutsideRow:
    """Result of one case."""

    case: str
    truth: str
    noise: str
    verdict: str
    named: str
    probability: float
    closed: float
    law: str
    """Of a foreign force: what the drawn curve varies with; empty where none is drawn."""
    curve_error: float
    """rms of the drawn curve minus the true force, over that of the force, in the range of the data."""
    seconds: float
    """CPU s of one process."""

    @property
    def is_right(self) -> bool:
        """Whether exactly the withheld effect is named; `unknown` for a foreign force, nothing where none is missing.

        Where nothing is missing, `undecidable` is no false alarm, but no right answer either.
        """
        if self.truth == "none" or self.truth in FOREIGN:
            return self.verdict == ("none" if self.truth == "none" else "unknown")
        return self.named == self.truth

    @property
    def is_alarm(self) -> bool:
        """Whether something is said to be missing."""
        return self.verdict not in ("none", "undecidable")

    @property
    def is_in_group(self) -> bool:
        """Whether it is named, perhaps with others that these runs cannot separate from it."""
        return self.is_right or set(self.truth.split("+")) <= set(self.named.split("+"))


def add_noise(places: FloatArray, kind: str, rng: np.random.Generator) -> FloatArray:
    """Add noise of a kind to positions (T, N)."""
    white = NOISE * rng.standard_normal(places.shape)
    if kind == "correlated":
        return places + lfilter([0.6], [1.0, -0.8], white, axis=0)
    if kind == "quantised":
        return 2 * NOISE * np.round((places + 0.3 * white) / (2 * NOISE))
    return places + white


def play(
    world: World, hidden: Withheld, rng: np.random.Generator, noise: str, runs: int, length: float
) -> tuple[list[str], FloatArray]:
    """Play the runs of a truth; return the lines of their table, and true accelerations by a foreign force.

    These are rows (M, 4): time, position, velocity and acceleration of the first joint.
    """
    model = mujoco.MjModel.from_xml_string(world.write(hidden.joint))
    model.opt.gravity[:] += hidden.gravity
    joints = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k) for k in range(model.njnt)]
    joints = ["ball.x", "ball.y", "ball.z"] if world.flies else joints[: model.njnt - world.unmeasured]
    lines = [",".join(["shot", "t", *joints, *(f"motor_{k + 1}" for k in range(model.nu))])]
    inertia = measure_inertia(model)
    foreign: list[tuple[float, float, float, float]] = []
    for shot in range(runs):
        data: Any = mujoco.MjData(model)
        if world.flies:
            data.qvel[:3] = rng.uniform((4, -2, 2), (9, 2, 6))
        else:
            data.qpos[:] = rng.uniform(-world.spread, world.spread, model.nq)
        rates, phases = rng.uniform(2.0, 9.0, model.nu), rng.uniform(0, 2 * np.pi, model.nu)
        waiting = [np.zeros(model.nu)] * hidden.delay
        acting = np.zeros(model.nu)
        times = np.arange(round(length * RATE)) / RATE
        given, places = (
            np.array(world.push) * np.sin(np.outer(times, rates) + phases),
            np.empty((len(times), len(joints))),
        )
        for row, told in enumerate(given):
            places[row] = data.qpos[: len(joints)]
            for _ in range(round(1 / (RATE * STEP))):
                waiting.append(told)
                now = waiting.pop(0)
                acting = acting + (now - acting) * (1 - np.exp(-STEP / hidden.lag)) if hidden.lag else now
                data.ctrl[:] = hidden.gain * acting
                speed = np.linalg.norm(data.qvel[:3]) if world.flies else np.abs(data.qvel)
                data.qfrc_applied[:] = -hidden.drag * speed * data.qvel
                if hidden.foreign is not None:
                    place, velocity = data.qpos[0] / world.spread, data.qvel[0] / (5 * world.spread)
                    force = hidden.foreign(data.time, place, velocity)
                    data.qfrc_applied[0] += force
                    foreign.append((data.time, data.qpos[0], data.qvel[0], force / inertia))
                mujoco.mj_step(model, data)
        seen = add_noise(hidden.scale * places + hidden.offset, noise, rng)
        lines += [
            ",".join(f"{x:.6f}" for x in (shot, t, *row, *told))
            for t, row, told in zip(times, seen, given, strict=True)
        ]
    return lines, np.array(foreign)


def measure_inertia(model: Any) -> float:
    """Measure the inertia of the first joint by its acceleration under a unit force."""
    accelerations = []
    for force in (0.0, 1.0):
        data: Any = mujoco.MjData(model)
        data.qfrc_applied[0] = force
        mujoco.mj_forward(model, data)
        accelerations.append(float(data.qacc[0]))
    return 1 / (accelerations[1] - accelerations[0])


def measure_curve_error(law: ForceLaw, true: FloatArray) -> float:
    """Measure the error of a drawn curve, relative to the true accelerations (M, 4), where both are known.

    The curve is compared at every true sample within its range: the component and the variable are those of the law.
    """
    t, q, v, a = true.T
    values = np.sign(v) * a if law.direction == "along" else a
    at = {"time": t, "speed": np.abs(v)}.get(law.variable, q)
    inside = (at >= law.curve[0, 0]) & (at <= law.curve[0, -1])
    missed = np.interp(at[inside], *law.curve) - values[inside]
    return float(np.sqrt(np.square(missed).mean() / np.square(values[inside]).mean()))


def run_case(
    world: str, truth: str, noise: str, seed: int, runs: int, length: float, folder: Path, laws: bool
) -> OutsideRow:
    """Diagnose one case, or, with `laws`, only draw the law of what the fitted simulator lacks."""
    rng = np.random.default_rng([seed, *f"{world} {truth} {noise}".encode()])
    name = name_case(world, truth, noise, seed, runs, length)
    real, simulator = folder / f"{name}.csv", folder / f"{world.replace(' ', '_')}.xml"
    simulator.write_text(WORLDS[world].write())
    lines, foreign = play(WORLDS[world], EFFECTS[truth](rng), rng, noise, runs, length)
    real.write_text("\n".join(lines) + "\n")
    start = time.process_time()
    if laws:
        own = draw_law(real, simulator)
        return OutsideRow(
            name, truth, noise, "", "", float("nan"), float("nan"), *score_law(own, foreign),
            time.process_time() - start,
        )  # fmt: skip
    report = diagnose_mechanism([real], str(simulator), seed)[0]
    seconds = time.process_time() - start
    names = report.effects or (report.candidates[0].group if report.verdict == "group" else ())
    return OutsideRow(
        name, truth, noise, report.verdict, "+".join(sorted(names)), report.probability, report.gap.closure.closed,
        *score_law(report.unexplained.law, foreign), seconds,
    )  # fmt: skip


def draw_law(real: Path, simulator: Path) -> ForceLaw | None:
    """Draw the law of the force that a simulator lacks, without a search for effects."""
    shots = read_mechanism_shots([real], str(simulator))
    split = split_shots(shots.recordings)
    used = (*split.fitting, *split.selection)
    noise = estimate_noise(used)
    problem = build_diagnosis_problem(build_simulator_scene(shots.simulator, shots.recordings, shots.histories), noise)
    fitted = fit_initial_windows(problem, apply_noise_estimate(used, noise))
    return find_force_law(measure_resolved_acceleration(problem, fitted), used[0].reference.coordinates)


def score_law(law: ForceLaw | None, foreign: FloatArray) -> tuple[str, float]:
    """Return what a law varies with, and the error of its curve; NaN where no foreign force acts."""
    if law is None:
        return "", float("nan")
    error = measure_curve_error(law, foreign) if len(foreign) else float("nan")
    return f"{law.direction} over {law.variable}", error


def name_case(world: str, truth: str, noise: str, seed: int, runs: int, length: float) -> str:
    """Name a case."""
    return f"{world.replace(' ', '_')}-{truth}-{noise}-{runs}x{length:g}-{seed}"


def summarize(rows: list[OutsideRow]) -> Iterator[str]:
    """Summarize all cases in a table with Wilson's intervals."""
    yield "| question | count |"
    yield "|---|---|"
    single = [row for row in rows if row.truth != "none" and row.truth not in FOREIGN and "+" not in row.truth]
    double = [row for row in rows if "+" in row.truth]
    for words, cases in (("one effect withheld", single), ("two effects withheld", double)):
        yield f"| {words}: named | {Proportion(sum(row.is_right for row in cases), len(cases))} |"
        yield f"| or in a group | {Proportion(sum(row.is_in_group for row in cases), len(cases))} |"
    for noise in NOISE_KINDS:
        cases = [row for row in rows if row.truth == "none" and row.noise == noise]
        alarms = Proportion(sum(row.is_alarm for row in cases), len(cases))
        undecided = sum(row.verdict == "undecidable" for row in cases)
        yield f"| nothing withheld, {noise} noise: false alarms | {alarms}; undecidable {undecided} |"
    foreign = [row for row in rows if row.truth in FOREIGN]
    asked = [row for row in foreign if row.verdict]
    yield f"| a force of no library form: unknown | {Proportion(sum(row.is_right for row in asked), len(asked))} |"
    near = sum(row.curve_error <= 0.1 for row in foreign)
    errors = [row.curve_error if math.isfinite(row.curve_error) else math.inf for row in foreign] or [math.nan]
    yield f"| its curve within 10 % | {Proportion(near, len(foreign))}; median error {np.median(errors):.0%} |"
    sure = [row for row in rows if row.probability >= 0.9 and row.verdict != "undecidable"]
    yield f"| probability of at least 0.9: true | {Proportion(sum(row.is_right for row in sure), len(sure))} |"
    seconds = [row.seconds for row in rows]
    spent = f"{np.median(seconds):.0f}, {max(seconds):.0f}, {sum(seconds):.0f}" if rows else "none"
    yield f"| CPU seconds: median, largest, all | {spent} |"
    for row in sure:
        if not row.is_right:
            yield f"sure and wrong: {row.case}: {row.verdict} {row.named} {row.probability:.3f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "outside_simulators", help="folder of results")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--questions", default=",".join(QUESTIONS), help="rows of the table, separated by commas")
    parser.add_argument("--worlds", default=",".join(WORLDS), help="worlds, separated by commas")
    parser.add_argument("--effects", help="withheld effects, separated by commas, of those of the questions")
    parser.add_argument("--noise", help=f"kinds of noise, separated by commas: {NOISE_KINDS}")
    parser.add_argument("--laws", action="store_true", help="only draw the laws of foreign forces, without a search")
    parser.add_argument("--runs", type=int, help="runs per case")
    parser.add_argument("--length", type=float, help="s per run")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    table = options.out / "rows.csv"
    rows = {row.case: row for row in read_rows(table, OutsideRow)}
    seeds = range(options.first, options.first + options.seeds)
    for seed, question in product(seeds, (QUESTIONS[one] for one in options.questions.split(","))):
        noises = options.noise.split(",") if options.noise else question.noise
        effects = [one for one in question.effects if not options.effects or one in options.effects.split(",")]
        runs, length = options.runs or question.runs, options.length or question.length
        for world, truth, noise in product(options.worlds.split(","), effects, noises):
            name = name_case(world, truth, noise, seed, runs, length)
            if name in rows or not can_withhold(world, truth):
                continue
            rows[name] = run_case(world, truth, noise, seed, runs, length, options.out, options.laws)
            append_row(rows[name], table)
            print(rows[name], file=sys.stderr, flush=True)
    print("\n".join(summarize(list(rows.values()))))
    return 0


def can_withhold(world: str, truth: str) -> bool:
    """Return whether a world may lack an effect."""
    own = WORLDS[world]
    if own.effects:
        return truth in own.effects
    is_driven = bool(own.push) or not EFFECTS[truth](np.random.default_rng(0)).needs_input
    return is_driven and (truth not in FOREIGN or world in FOREIGN_WORLDS)


if __name__ == "__main__":
    sys.exit(main())
