"""Fit single simulated shots with a complete model: does the fit find the truth, and what does it cost?

    python -m benchmarks.fitting.one_shot [SEEDS] [FIRST] [SECONDS] [--quick]

The truth is worlds/billiards.py, run as a process: three balls, 62.5 fps, noise of 1 px at 350 px per metre, a random
table per seed. Printed per seed: contacts of the truth, the selected cushion model, chi2 per degree of freedom, whether
the fit converged and explains the shot, parameters on a bound other than their neutral value, the error of the cue
ball's side spin in standard deviations, and CPU seconds of all models together; then the number of explained shots, and
medians. Takes seconds per seed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.fitting.foreign_shots import PX_PER_M, TABLE, draw_shot, draw_table, film_shot, fit_table, simulate_shot
from benchmarks.support.figures import (
    Figure,
    add_quick_option,
    estimate_median,
    estimate_rms,
    estimate_share,
    run_quick,
)
from models.estimation.whole_shot.table_fit import table_priors
from models.physics.billiards.simulation.parametrised_shot import (
    NEUTRAL_SHOT_PARAMETERS,
    SHOT_PARAMETERS,
    ContactModels,
)

NOISE = 1.0 / PX_PER_M
# Seeds per cushion model, and length of a shot (s), of `--quick`.
QUICK_SEEDS, QUICK_SECONDS = range(20, 26), 4.0
LAWS = ("mirror", "mathavan_2010")
CANDIDATE_MODELS = tuple(ContactModels(cushion, "inelastic") for cushion in LAWS)


def fit_case(seed: int, law: str, seconds: float) -> tuple[float, bool, float, float, bool]:
    """Fit one shot.

    Returns:
        chi2 per degree of freedom, success, normalised error of the side spin, CPU seconds, whether the model is right.
    """
    rng = np.random.default_rng([1907, seed])
    effects = draw_table(rng)
    shot = draw_shot(rng, effects, law, seconds)
    with tempfile.TemporaryDirectory() as folder:
        xy, kinds = simulate_shot(shot, Path(folder), seconds)
    segment = film_shot(xy, 0, NOISE, rng)
    begun = time.process_time()
    fit = fit_table((segment,), CANDIDATE_MODELS)
    cost = time.process_time() - begun
    bounds = {prior.name: prior.bounds for prior in table_priors(fit.laws)}
    at_bound = [
        p.name
        for p in fit.parameters
        if any(
            abs(p.value - edge) < 1e-9 and edge != NEUTRAL_SHOT_PARAMETERS[SHOT_PARAMETERS.index(p.name)]
            for edge in bounds[p.name]
        )
    ]
    side = float(shot["balls"][0]["wz"]) * TABLE.ball_radius  # type: ignore[index]
    pull = (fit.states[0][0, 6] - side) / np.sqrt(fit.covariances[0][0, 6, 6])
    contacts = sum(kind in ("ball", "cushion") for kind in kinds)
    print(
        f"{law:14} seed {seed:2} contacts {contacts:2} selected {fit.laws.cushion:14} chi2 {fit.chi2_per_dof:6.2f}"
        f" {'explained' if fit.is_explained else 'not explained'} {' '.join(at_bound)} side spin {pull:+.1f} sigma"
        f" {cost:.2f} CPU s",
        flush=True,
    )
    return fit.chi2_per_dof, fit.is_explained and not at_bound, pull, cost, fit.laws.cushion == law


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation."""
    figures = []
    for law in LAWS:
        rows = np.array([fit_case(seed, law, QUICK_SECONDS) for seed in QUICK_SEEDS], float)
        chi2, well, pull, _, right = rows.T
        figures += [
            estimate_share(f"{law}: explained, inside bounds", int(well.sum()), len(rows)),
            estimate_share(f"{law}: model named", int(right.sum()), len(rows)),
            estimate_median(f"{law}: chi2 per degree of freedom", chi2, ""),
            estimate_rms(f"{law}: side spin, error over stated sigma", pull, ""),
        ]
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", nargs="?", type=int, default=20, help="number of shots per cushion model")
    parser.add_argument("first", nargs="?", type=int, default=0, help="first seed")
    parser.add_argument("seconds", nargs="?", type=float, default=10.0, help="length of a shot, s")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"shots of {QUICK_SECONDS:g} s, seeds {QUICK_SEEDS[0]} to {QUICK_SEEDS[-1]} per cushion model"
        run_quick("fitting.one_shot", measure_figures, inputs)
        return
    seeds, first, seconds = arguments.seeds, arguments.first, arguments.seconds
    for law in LAWS:
        rows = np.array([fit_case(seed, law, seconds) for seed in range(first, first + seeds)])
        chi2, well, pull, cost, _ = rows.T
        print(
            f"{law}: explained, inside bounds {int(well.sum())} of {seeds}; chi2 median {np.median(chi2):.2f}, worst"
            f" {chi2.max():.2f}; side spin within 3 sigma {int((abs(pull) < 3).sum())};"
            f" CPU s median {np.median(cost):.2f}, worst {cost.max():.2f}"
        )


if __name__ == "__main__":
    main()
