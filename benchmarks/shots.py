"""Whole shots of a foreign world: what a fit by shooting tells of the table, and whether it names the right law.

    PYTHONPATH=. python benchmarks/shots.py [SEEDS] [FIRST]

The truth is worlds/billiards.py, run as a process: a table of its own per seed, three shots of three balls, 62.5
pictures a second, noise of 0.3 and 1 px at 350 px to the metre. Printed per seed: the law of the truth and the one that
is named, chi2 per degree of freedom, and (found - true) / sigma of every number; at the end, over all seeds in which
the right law was named, the median and the root mean square of these pulls, and how many lie within 3. Nothing but the
tracks is used: first guesses come from them. In the world of Mathavan's law the cloth under a pressed ball has a
friction of its own, 0.21: `cushion_cloth.factor` is this over the friction of the cloth.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from foreign_shots import PX_PER_M, TABLE, filmed, played, shot_of, table_of

from models.estimation.whole_shot.table_fit import TableFit, fit_table
from models.physics.billiards.simulation.parametrised_shot import Laws

SECONDS, SHOTS = 2.0, 3
LAWS = ("mirror", "mathavan_2010")
PRESSED_CLOTH_MU = 0.21
"""of the foreign world, under a ball that a nose presses down."""


def pulls(fitted: TableFit, effects: dict[str, dict[str, float]]) -> dict[str, float]:
    """(found - true) / sigma of every number that the data determined."""
    truth = {f"{effect}.{name}": value for effect, numbers in effects.items() for name, value in numbers.items()}
    truth |= {"ball_friction.mu": 0.0, "collision_radius.factor": 1.0}
    truth["cushion_cloth.factor"] = PRESSED_CLOTH_MU / truth["sliding_friction.mu"]
    return {
        p.name: (p.value - truth.get(p.name, 0.0)) / p.sigma
        for p in fitted.parameters if not p.prior_only and p.name != "ball_friction.mu"
    }  # fmt: skip


def case(seed: int, law: str, noise_px: float) -> tuple[TableFit, dict[str, float]]:
    """One table, its shots filmed and fitted under all laws."""
    rng = np.random.default_rng([2022, seed])
    effects = table_of(rng)
    with tempfile.TemporaryDirectory() as folder:
        paths = [played(shot_of(rng, effects, law, SECONDS), Path(folder), SECONDS)[0] for _ in range(SHOTS)]
    stretches = tuple(filmed(xy, k, noise_px / PX_PER_M, rng) for k, xy in enumerate(paths))
    fitted = fit_table(stretches, TABLE, tuple(Laws(one, "inelastic") for one in LAWS))
    return fitted, pulls(fitted, effects)


def main(seeds: int = 20, first: int = 0) -> None:
    for noise_px in (0.3, 1.0):
        for law in LAWS:
            found: dict[str, list[float]] = {}
            right, good, seconds = 0, 0, time.process_time()
            for seed in range(first, first + seeds):
                fitted, told = case(seed, law, noise_px)
                right += fitted.laws.cushion == law
                good += fitted.chi2_per_dof < 1.2
                print(f"{noise_px} px {law:14} seed {seed:2} named {fitted.laws.cushion:14}"
                      f" chi2 {fitted.chi2_per_dof:6.2f} " + " ".join(f"{k} {v:+.1f}" for k, v in told.items()),
                      flush=True)  # fmt: skip
                if fitted.laws.cushion == law:
                    for name, pull in told.items():
                        found.setdefault(name, []).append(pull)
            print(f"{noise_px} px {law}: law right {right} of {seeds}, chi2 below 1.2 {good} of {seeds},"
                  f" {(time.process_time() - seconds) / seeds:.1f} CPU s a table")  # fmt: skip
            for name, values in found.items():
                some = np.array(values)
                print(f"  {name:26} median {np.median(some):+6.2f} rms {np.sqrt(np.mean(some**2)):7.2f}"
                      f" within 3: {int((abs(some) < 3).sum())} of {len(some)}")  # fmt: skip


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
