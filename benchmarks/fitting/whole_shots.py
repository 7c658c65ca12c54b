"""Fit whole simulated shots: accuracy of the table parameters, and selection of the right cushion model.

    python -m benchmarks.fitting.whole_shots [SEEDS] [FIRST] [--quick]

The truth is worlds/billiards.py, run as a process: a random table per seed, three shots of three balls, 62.5 fps, noise
of 0.3 and 1 px at 350 px per metre. Printed per seed: the true and the selected cushion model, chi2 per degree of
freedom, and the normalised error (estimate - truth) / sigma of every parameter; at the end, over all seeds with the
right model, median and RMS of these errors, and the number within 3. The fit uses the tracks alone, including the
initial guesses. In the simulator, Mathavan's model has its own cloth friction of 0.21 under a pressed ball:
`cushion_cloth.factor` is its ratio to the friction of the cloth. Takes about a minute per seed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.fitting.foreign_shots import PX_PER_M, draw_shot, draw_table, film_shot, fit_table, simulate_shot
from benchmarks.support.figures import Figure, add_quick_option, estimate_rms, estimate_share, run_quick
from models.estimation.whole_shot.table_fit import TableFit
from models.physics.billiards.simulation.parametrised_shot import ContactModels

SECONDS, SHOTS = 2.0, 3
LAWS = ("mirror", "mathavan_2010")
QUICK_SEEDS, QUICK_NOISE_PX = range(20, 25), 0.3
# Parameters that the shots of every table of `--quick` determine.
QUICK_PARAMETERS = (
    "sliding_friction.mu", "rolling_resistance.mu", "cushion_restitution.e", "cushion_friction.mu",
    "ball_restitution.e",
)  # fmt: skip
# Cloth friction of worlds/billiards.py under a ball that a nose presses down.
PRESSED_CLOTH_MU = 0.21


def normalise_errors(fitted: TableFit, effects: dict[str, dict[str, float]]) -> dict[str, float]:
    """Return (estimate - truth) / sigma of every parameter that the data determine."""
    truth = {f"{effect}.{name}": value for effect, numbers in effects.items() for name, value in numbers.items()}
    truth |= {"ball_friction.mu": 0.0, "collision_radius.factor": 1.0}
    truth["cushion_cloth.factor"] = PRESSED_CLOTH_MU / truth["sliding_friction.mu"]
    return {
        p.name: (p.value - truth.get(p.name, 0.0)) / p.sigma
        for p in fitted.parameters if not p.prior_only and p.name != "ball_friction.mu"
    }  # fmt: skip


def fit_case(seed: int, law: str, noise_px: float) -> tuple[TableFit, dict[str, float]]:
    """Simulate the shots of one table and fit them with all cushion models."""
    rng = np.random.default_rng([2022, seed])
    effects = draw_table(rng)
    with tempfile.TemporaryDirectory() as folder:
        paths = [simulate_shot(draw_shot(rng, effects, law, SECONDS), Path(folder), SECONDS)[0] for _ in range(SHOTS)]
    segments = tuple(film_shot(xy, k, noise_px / PX_PER_M, rng) for k, xy in enumerate(paths))
    fitted = fit_table(segments, tuple(ContactModels(one, "inelastic") for one in LAWS))
    return fitted, normalise_errors(fitted, effects)


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation: tables with the cushions of Mathavan."""
    law = "mathavan_2010"
    fits = [fit_case(seed, law, QUICK_NOISE_PX) for seed in QUICK_SEEDS]
    right = [(fitted, errors) for fitted, errors in fits if fitted.laws.cushion == law]
    return [
        estimate_share("model named", len(right), len(fits)),
        estimate_share("chi2 below 1.2", sum(fitted.chi2_per_dof < 1.2 for fitted, _ in fits), len(fits)),
        *(
            estimate_rms(
                f"{name}: error over stated sigma", [errors[name] for _, errors in right if name in errors], ""
            )
            for name in QUICK_PARAMETERS
        ),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", nargs="?", type=int, default=20, help="number of tables per cushion model and noise")
    parser.add_argument("first", nargs="?", type=int, default=0, help="first seed")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"Mathavan's cushions, noise of {QUICK_NOISE_PX:g} px, tables {QUICK_SEEDS[0]} to {QUICK_SEEDS[-1]}"
        run_quick("fitting.whole_shots", measure_figures, inputs)
        return
    seeds, first = arguments.seeds, arguments.first
    for noise_px in (0.3, 1.0):
        for law in LAWS:
            errors_by_name: dict[str, list[float]] = {}
            right, good, seconds = 0, 0, time.process_time()
            for seed in range(first, first + seeds):
                fitted, errors = fit_case(seed, law, noise_px)
                right += fitted.laws.cushion == law
                good += fitted.chi2_per_dof < 1.2
                print(f"{noise_px} px {law:14} seed {seed:2} selected {fitted.laws.cushion:14}"
                      f" chi2 {fitted.chi2_per_dof:6.2f} " + " ".join(f"{k} {v:+.1f}" for k, v in errors.items()),
                      flush=True)  # fmt: skip
                if fitted.laws.cushion == law:
                    for name, pull in errors.items():
                        errors_by_name.setdefault(name, []).append(pull)
            print(f"{noise_px} px {law}: model right {right} of {seeds}, chi2 below 1.2 {good} of {seeds},"
                  f" {(time.process_time() - seconds) / seeds:.1f} CPU s per table")  # fmt: skip
            for name, values in errors_by_name.items():
                some = np.array(values)
                print(f"  {name:26} median {np.median(some):+6.2f} rms {np.sqrt(np.mean(some**2)):7.2f}"
                      f" within 3: {int((abs(some) < 3).sum())} of {len(some)}")  # fmt: skip


if __name__ == "__main__":
    main()
