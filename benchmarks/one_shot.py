"""One shot of a foreign world at a time, with nothing missing: does the fit end where it should, and what does it cost?

    PYTHONPATH=. python benchmarks/one_shot.py [SEEDS] [FIRST] [SECONDS]

The truth is worlds/billiards.py, run as a process: three balls, 62.5 pictures a second, noise of 1 px at 350 px to the
metre, a table of its own per seed. Printed per seed: contacts of the truth, the law that is named, chi2 per degree of
freedom, whether the fit says that it converged and explains the shot, numbers on a bound where their effect is not just
absent, the error of the side spin of the cue ball in standard deviations, CPU seconds of all laws together; then how
many were explained, and the medians.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from foreign_shots import PX_PER_M, TABLE, filmed, played, shot_of, table_of

from models.estimation.whole_shot.table_fit import fit_table, unknowns_of
from models.physics.billiards.simulation.parametrised_shot import ABSENT, NUMBERS, Laws

NOISE = 1.0 / PX_PER_M
LAWS = ("mirror", "mathavan_2010")
SOUGHT = tuple(Laws(cushion, "inelastic") for cushion in LAWS)


def case(seed: int, law: str, seconds: float) -> tuple[float, bool, float, float]:
    """chi2 per degree of freedom, whether all is well, pull of the side spin, CPU seconds."""
    rng = np.random.default_rng([1907, seed])
    effects = table_of(rng)
    shot = shot_of(rng, effects, law, seconds)
    with tempfile.TemporaryDirectory() as folder:
        xy, kinds = played(shot, Path(folder), seconds)
    stretch = filmed(xy, 0, NOISE, rng)
    begun = time.process_time()
    found = fit_table((stretch,), TABLE, SOUGHT)
    cost = time.process_time() - begun
    bounds = {prior.name: prior.bounds for prior in unknowns_of(found.laws)}
    stuck = [
        p.name
        for p in found.parameters
        if any(abs(p.value - edge) < 1e-9 and edge != ABSENT[NUMBERS.index(p.name)] for edge in bounds[p.name])
    ]
    side = float(shot["balls"][0]["wz"]) * TABLE.ball_radius  # type: ignore[index]
    pull = (found.states[0][0, 6] - side) / np.sqrt(found.covariances[0][0, 6, 6])
    contacts = sum(kind in ("ball", "cushion") for kind in kinds)
    print(
        f"{law:14} seed {seed:2} contacts {contacts:2} named {found.laws.cushion:14} chi2 {found.chi2_per_dof:6.2f}"
        f" {'explained' if found.explained else 'not explained'} {' '.join(stuck)} side spin {pull:+.1f} sigma"
        f" {cost:.2f} CPU s",
        flush=True,
    )
    return found.chi2_per_dof, found.explained and not stuck, pull, cost


def main(seeds: int = 20, first: int = 0, seconds: float = 10.0) -> None:
    for law in LAWS:
        rows = np.array([case(seed, law, seconds) for seed in range(first, first + seeds)])
        chi2, well, pull, cost = rows.T
        print(
            f"{law}: explained, inside bounds {int(well.sum())} of {seeds}; chi2 median {np.median(chi2):.2f}, worst"
            f" {chi2.max():.2f}; side spin within 3 sigma {int((abs(pull) < 3).sum())};"
            f" CPU s median {np.median(cost):.2f}, worst {cost.max():.2f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *map(float, sys.argv[3:4]))
