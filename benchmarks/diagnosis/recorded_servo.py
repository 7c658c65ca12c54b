"""What does a diagnosis say of a real servo, and does it predict what it has not seen?

    python -m benchmarks.diagnosis.recorded_servo [--every 1] [--data FOLDER]

Reads `servo_recorded.csv` and `servo.xml`, the simulator of its owner, in FOLDER (../shared/data/physics/robots), and
takes every Nth of its 32 episodes. Prints what is named, the rms error on held-out episodes with the file as it is,
with fitted coefficients, with the effects, and of a right model; how far episodes differ from each other as long as
they are asked for the same; the CPU time; and the error on two releases that are no part of the diagnosis
(`servo_drop_1.csv`, `servo_drop_2.csv`: without power, the arm sinks), from the release until it meets its stop. One
process; takes minutes. Without the data it says so.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.detection.detector_cases import DATA
from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.recording import Recording
from models.estimation.gap_scenes.gap_scene import neutral_values
from models.estimation.gap_scenes.outside_simulator import InputHistory
from models.estimation.gap_scenes.simulator_scene import SimulatorScene, build_simulator_scene
from pipeline.io.simulators.mechanism_recordings import read_mechanism_shots

DROPS = ("servo_drop_1.csv", "servo_drop_2.csv")
# rad: the arm lies on its stop from there on.
STOP = -0.54
# Rows for which two episodes must be asked for the same, and the difference (rad) up to which they are.
LEAST_REPEATED, SAME_COMMAND = 15, 1e-3


def measure_repeats(recordings: tuple[Recording, ...], histories: Mapping[int, InputHistory]) -> Iterator[float]:
    """Measure the rms difference (rad) of every two episodes that begin alike, while they are asked for the same."""
    for one, other in combinations(recordings, 2):
        rows = min(len(one.t), len(other.t))
        asked = [histories[each.shot].values[:rows, 0] for each in (one, other)]
        differs = np.abs(asked[0] - asked[1]) > SAME_COMMAND
        same = int(np.argmax(differs)) if differs.any() else rows
        if same >= LEAST_REPEATED:
            yield float(np.sqrt(np.square(one.positions[:same] - other.positions[:same]).mean()))


def predict_release(scene: SimulatorScene, recording: Recording, report: DiagnosisReport, has_effects: bool) -> float:
    """Predict an arm without power from its rest, and return the rms error (rad) until it meets its stop."""
    released = np.flatnonzero(np.isnan(scene.histories[recording.shot].values[:, 0]))[0]
    stopped = np.flatnonzero(recording.positions[:, 0, 0] < STOP)[0]
    part, shared = recording.select_rows(int(released), int(stopped)), neutral_values(scene)
    values = {one.name: one.value for one in report.fitted} if has_effects else {}
    names = [f"{effect.name}.{prior.name}" for effect in scene.effects for prior in effect.parameters]
    shared = np.array([values.get(name, neutral) for name, neutral in zip(names, shared, strict=True)])
    path = scene.predict_positions(part, np.array([part.positions[0, 0, 0], 0.0]), shared, ())
    return float(np.sqrt(np.square(path - part.positions).mean()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA / "physics" / "robots", help="folder of the recordings")
    parser.add_argument("--every", type=int, default=1, help="take every Nth episode")
    options = parser.parse_args()
    if not (options.data / "servo_recorded.csv").is_file():
        print(f"there is no servo_recorded.csv in {options.data}; name its folder with --data")
        return 2
    files = [options.data / name for name in ("servo_recorded.csv", *DROPS)]
    shots = read_mechanism_shots(files, str(options.data / "servo.xml"))
    recordings = shots.recordings[: -len(DROPS)][:: options.every]
    scene = build_simulator_scene(
        shots.simulator, recordings, {one.shot: shots.histories[one.shot] for one in recordings}
    )
    start = time.process_time()
    report = diagnose(scene, recordings)
    seconds, closure = time.process_time() - start, report.gap.closure
    print(f"{len(recordings)} episodes, {seconds:.0f} CPU s: {report.verdict} {', '.join(report.effects)}")
    for one in report.candidates[:4]:
        print(f"  {one.effect} {one.probability:.2f}")
    for strength in report.fitted:
        print(f"  {strength.name} = {strength.value:.4g} +- {strength.sigma:.2g} {strength.unit}")
    print("held-out episodes, mrad rms: as stated, fitted, with the effects, of a right model:")
    errors = (report.gap.as_stated, closure.before, closure.after, closure.floor)
    print("  " + ", ".join(f"{1e3 * error:.1f}" for error in errors))
    repeats = [f"{1e3 * one:.1f}" for one in measure_repeats(recordings, shots.histories)]
    print(f"episodes that are asked for the same differ by {', '.join(repeats)} mrad rms")
    whole = replace(scene, histories=shots.histories)
    for name, one in zip(DROPS, shots.recordings[-len(DROPS) :], strict=True):
        before, after = (1e3 * predict_release(whole, one, report, has_effects) for has_effects in (False, True))
        print(f"{name}, mrad rms without and with the effects: {before:.0f}, {after:.0f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
