"""Score `trueroll diagnose --simulator pooltool` on tables that pooltool plays, with one change that it does not know.

    python -m benchmarks.diagnosis.pooltool_gap [KIND...] [--seeds 1] [--first 0]

Twelve shots of two or three balls, 2 s at 60 fps, noise of 0.3 px at 350 px per metre; coefficients of cloth, cushions
and balls are drawn, so that those of the user's pooltool are wrong in all kinds. pooltool runs in an environment of its
own (`benchmarks.physics.pooltool_contacts`). Half a minute to a few minutes per case.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.diagnosis.pooltool_worlds import play_shots
from benchmarks.physics.foreign_engines import POOLTOOL
from diagnosis.diagnose import diagnose
from models.core.typing import FloatArray
from models.estimation.gap_scenes.billiards_scene import BilliardsScene
from pipeline.io.simulators.pooltool_simulator import PYTHON_VARIABLE
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene
from pipeline.simulator_diagnosis import describe_coefficients, pair_with_pooltool

SHOTS, SECONDS, FPS, NOISE = 12, 2.0, 60.0, 0.3 / 350
LENGTH, WIDTH, RADIUS = 2.54, 1.27, 0.028575
# By kind: the names that are right.
KINDS = {
    "none": set[str](),
    "cushion model": {"cushion_law"},
    "ball model": {"ball_law", "ball_friction"},
    "slope": {"slope"},
    "lens": {"lens_distortion"},
    "dropped frames": {"dropped_frames"},
}


def draw_shots(rng: np.random.Generator) -> FloatArray:
    """Draw states (S, N, 4): the first ball is struck, most often at another one."""
    shots = np.zeros((SHOTS, 3, 4))
    for shot in shots:
        while True:
            shot[:, :2] = rng.uniform([0.2, 0.2], [LENGTH - 0.2, WIDTH - 0.2], (3, 2))
            gaps = [np.linalg.norm(shot[a, :2] - shot[b, :2]) for a, b in ((0, 1), (0, 2), (1, 2))]
            if min(gaps) > 0.25:
                break
        aim = shot[1, :2] - shot[0, :2]
        side = rng.uniform(-1.3, 1.3) * RADIUS * np.array([-aim[1], aim[0]]) / np.linalg.norm(aim)
        aim = (aim + side) / np.linalg.norm(aim + side)
        shot[0, 2:] = rng.uniform(1.0, 2.5) * aim
    return shots


def film_world(kind: str, seed: int, folder: Path) -> None:
    """Play the shots of a kind with pooltool and write what a camera sees as a track folder."""
    rng = np.random.default_rng([4917, seed, *kind.encode()])
    shots, frames = draw_shots(rng), np.arange(round(SECONDS * FPS))
    times = frames / FPS
    if kind == "dropped frames":
        times = times + np.where(frames >= rng.integers(30, 80), rng.integers(3, 7), 0) / FPS
    params = np.array([rng.uniform(0.16, 0.26), rng.uniform(0.008, 0.015), rng.uniform(0.3, 0.6),
                       0.2 if kind == "ball model" else 0.05, rng.uniform(0.92, 0.97),
                       rng.uniform(0.75, 0.9), rng.uniform(0.12, 0.25)])  # fmt: skip
    angle = rng.uniform(0, 2 * np.pi)
    given = {
        "t": times, "size": np.array([LENGTH, WIDTH, 0.037 / RADIUS]),
        "cushion": np.array("mathavan_2010" if kind == "cushion model" else "stronge_compliant"),
        "friction": np.array("average" if kind == "ball model" else "alciatore"), "params": params,
        "slope": 2e-3 * np.array([np.cos(angle), np.sin(angle)]) * (kind == "slope"),
    }  # fmt: skip
    xy = POOLTOOL.call(play_shots, {"states": shots} | given)["xy"]
    while (failed := np.isnan(xy).any(axis=(1, 2, 3))).any():  # pooltool fails at some grazing contacts
        xy[failed] = POOLTOOL.call(play_shots, {"states": draw_shots(rng)[failed]} | given)["xy"]
    if kind == "lens":
        off = (xy - np.array([LENGTH, WIDTH]) / 2) / (LENGTH / 2)
        xy = np.array([LENGTH, WIDTH]) / 2 + LENGTH / 2 * off * (1 - 0.02 * np.square(off).sum(-1, keepdims=True))
    xy = xy + NOISE * rng.standard_normal(xy.shape)
    rows = [
        f"{shot},{frame},{frame / FPS:.9g},{'abc'[ball]},{x:.6f},{y:.6f}"
        for shot, path in enumerate(xy) for frame, row in enumerate(path) for ball, (x, y) in enumerate(row)
    ]  # fmt: skip
    folder.mkdir()
    (folder / "tracks.csv").write_text("\n".join(["shot,frame,t,id,x,y", *rows]) + "\n")
    scene = {"scene": "billiards", "units": "m", "fps": FPS, "table": {"length": LENGTH, "width": WIDTH},
             "ball_radius": RADIUS, "image": {"px_per_m": 350.0, "origin_px": [0, 0], "width_px": 889,
                                              "height_px": 444}}  # fmt: skip
    (folder / "scene.json").write_text(json.dumps(scene))


def run_case(kind: str, seed: int) -> bool:
    """Film, diagnose and print one case; return whether the name is right."""
    with tempfile.TemporaryDirectory() as scratch:
        film_world(kind, seed, Path(scratch) / "shots")
        read = read_track_folders([Path(scratch) / "shots"])
    begun = time.perf_counter()
    scene = pair_with_pooltool(build_gap_scene(read))
    assert isinstance(scene, BilliardsScene)
    report = diagnose(scene, read.recordings)
    named, closure = set(report.effects), report.gap.closure
    is_right = bool(named) and named <= KINDS[kind] if KINDS[kind] else report.verdict == "none"
    print(f"{'right' if is_right else 'WRONG'}  {kind} {seed}: {report.verdict} {', '.join(report.effects)}"
          f" ({report.probability:.2f}; group {', '.join(report.candidates[0].group)});"
          f" {1e3 * report.gap.as_stated:.2f} as stated, {1e3 * closure.before:.2f} ->"
          f" {1e3 * closure.after:.2f} mm, attainable {1e3 * closure.floor:.2f}, closed {closure.closed:.3f};"
          f" {time.perf_counter() - begun:.0f} s", flush=True)  # fmt: skip
    for note in describe_coefficients(report):
        print("      ", note)
    return is_right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", help=f"default: {', '.join(KINDS)}")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    os.environ.setdefault(PYTHON_VARIABLE, str(POOLTOOL.prepare()))
    seeds = range(options.first, options.first + options.seeds)
    right = [run_case(kind, seed) for kind in options.kinds or KINDS for seed in seeds]
    print(f"{sum(right)} of {len(right)} right")


if __name__ == "__main__":
    main()
