"""The diagnosis of foreign billiards: is nothing called nothing, and is a missing effect named?

    PYTHONPATH=. python benchmarks/billiards_gap.py [SEEDS] [FIRST] [CASE...]

The truth is worlds/billiards.py, run as a process: nine shots of three balls on a table of its own per seed, 2 s each,
62.5 pictures a second, noise of 0.3 px at 350 px to the metre, the mirror law. The simulator that is diagnosed has
rolling resistance, sliding friction, spin decay and the restitution of cushions and balls; the world has these and, per
case, one more effect or none. Printed per seed: the verdict, the effects named, the p-value of what the simulator
leaves, the strength found of what was missing, CPU seconds; then how many are right per case.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from foreign_shots import FPS, IDS, PX_PER_M, TABLE, played, shot_of, table_of

from diagnosis.diagnose import diagnose
from models.billiards.gap import USUAL_MODEL, billiards_scene
from models.gap_scene import Recording

NOISE, SHOTS, SECONDS = 0.3 / PX_PER_M, 9, 2.0
CASES: dict[str, dict[str, dict[str, float]]] = {
    "none": {},
    "slope": {"slope": {"slope_x": 1.5, "slope_y": 0.0}},
    "cushion_friction": {"cushion_friction": {"mu": 0.17}},
    "cushion_restitution_speed": {"cushion_restitution_speed": {"slope": 0.05}},
}


def recordings(seed: int, missing: dict[str, dict[str, float]]) -> tuple[Recording, ...]:
    """All shots of one table, as a camera sees them."""
    rng = np.random.default_rng([1877, seed])
    effects = {name: numbers for name, numbers in table_of(rng).items() if name in USUAL_MODEL} | missing
    with tempfile.TemporaryDirectory() as folder:
        paths = [played(shot_of(rng, effects, "mirror", SECONDS), Path(folder), SECONDS)[0] for _ in range(SHOTS)]
    return tuple(
        Recording(
            k, np.arange(len(xy)), np.arange(len(xy)) / FPS, IDS, xy + NOISE * rng.normal(size=xy.shape),
            np.full(xy.shape[:2], NOISE),
        )
        for k, xy in enumerate(paths)
    )  # fmt: skip


def case(name: str, seed: int) -> bool:
    """Whether the verdict is right."""
    shots = recordings(seed, CASES[name])
    begun = time.process_time()
    report = diagnose(billiards_scene(TABLE, shots), shots)
    cost = time.process_time() - begun
    strengths = {f"{one.name} {one.value:.3g} +- {one.sigma:.2g}" for one in report.fitted[len(USUAL_MODEL) :]}
    print(
        f"{name:26} seed {seed:2} {report.verdict:8} {' '.join(report.effects):26} p {report.p_value:.2g}"
        f" {', '.join(sorted(strengths))} {cost:.0f} CPU s",
        flush=True,
    )
    return report.verdict == "none" if name == "none" else report.verdict == "effects" and report.effects == (name,)


def main(seeds: int = 12, first: int = 0, *names: str) -> None:
    for name in names or tuple(CASES):
        right = sum(case(name, seed) for seed in range(first, first + seeds))
        print(f"{name}: right {right} of {seeds}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *sys.argv[3:])
