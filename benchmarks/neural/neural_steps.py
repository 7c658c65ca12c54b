"""Compare variants of networks for frame interpolation, one change at a time, on the double pendulum of Chen 2022.

    python -m benchmarks.neural.neural_steps [--quick] [--kind stiff] [--fps 30] [--noise 0] [--seeds 3] [--first 100]
        [--thesis] [--only NAME]

Truth as in benchmarks/neural/spring_fits.py (section 3.1.1 of the thesis), 2.5 s, every other frame withheld. `x
linear` and `x cubic`: factor by which the mean square error at the withheld frames is below that of linear
interpolation and of the not-a-knot spline through the visible ones; median and minimum over the seeds. Horizon: seconds
after the last frame until a ball is 10 px off, at most 1. The seeds are those of the networks and, with noise, of the
noise. `--thesis` adds the networks of 512 x 512 x 512, a minute each.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.neural.spring_fits import LOST_PX, simulate_truth
from benchmarks.support.figures import Figure, add_quick_option, estimate_median, run_quick
from models.core.typing import FloatArray
from models.neural.common.integration_steps import EulerStep
from models.neural.common.method_interface import CUBIC, CURVES, LINEAR, FittedMotion, MotionMethod, TrainingBudget
from models.neural.common.network_training import TrainingSchedule
from models.neural.method_catalogue import COMPETING_METHODS, CONSTRAINT_NET, THESIS_METHODS
from models.neural.networks.hamiltonian_network import HAMILTONIAN
from models.neural.networks.neural_flow import SECOND_ORDER
from models.neural.networks.neural_runge_kutta import FOURIER_NET, SMOOTH_NET

SECONDS, FUTURE = 2.5, 1.0
ADAM = TrainingSchedule(adam_steps=3000)
# Variants with one change each, added to the last one; steps and Fourier features are added to the end correction.
CHANGES: tuple[MotionMethod, ...] = (
    replace(SMOOTH_NET, name="tanh 64, Adam alone", schedule=ADAM, corrects_end_error=False),
    replace(SMOOTH_NET, name="tanh 64, L-BFGS", corrects_end_error=False),
    replace(SMOOTH_NET, name="... end correction"),
    replace(SMOOTH_NET, name="... Euler", step=EulerStep()),
    replace(FOURIER_NET, name="... Fourier features of 4 steps"),
    replace(FOURIER_NET, name="... Fourier features of 2 steps", shortest_period=2.0),
    replace(FOURIER_NET, name="... Fourier features of 1 step", shortest_period=1.0),
    replace(SECOND_ORDER, name="net(x, v), Adam alone", schedule=ADAM),
    SECOND_ORDER,
)
QUICK_METHODS, QUICK_SEEDS = (SMOOTH_NET, HAMILTONIAN), range(100, 102)
CHEAP = tuple(method for method in COMPETING_METHODS if method is not CONSTRAINT_NET)


@dataclass(frozen=True)
class WithheldScene:
    """A series; every other one of the first `frames` frames is visible."""

    t: FloatArray
    x: FloatArray
    frames: int
    noise: float

    def add_noise(self, seed: int) -> FloatArray:
        return self.x + self.noise * np.random.default_rng(seed).standard_normal(self.x.shape)

    def fit_method(self, method: MotionMethod, seed: int) -> FittedMotion:
        shown = slice(0, self.frames, 2)
        return method.fit(self.t[shown], self.add_noise(seed)[shown], seed, TrainingBudget())

    def mse(self, fitted: FittedMotion) -> float:
        hidden = slice(1, self.frames - 1, 2)
        return float(np.mean((fitted.at(self.t[hidden]) - self.x[hidden]) ** 2))

    def horizon(self, fitted: FittedMotion) -> float:
        later = self.t[self.frames :]
        off = np.linalg.norm(fitted.at(later) - self.x[self.frames :], axis=2).max(axis=1)
        lost = np.flatnonzero(~(off <= LOST_PX))
        return float(later[lost[0]] - self.t[self.frames - 1]) if len(lost) else FUTURE


def make_scene(kind: str, fps: int, noise: float) -> WithheldScene:
    frames = int(SECONDS * fps) // 2 * 2 + 1
    t = np.arange(frames + int(FUTURE * fps)) / fps
    return WithheldScene(t, simulate_truth(kind, t), frames, noise)


def format_row(scene: WithheldScene, method: MotionMethod, seeds: range) -> str:
    rivals = [(scene.mse(scene.fit_method(LINEAR, seed)), scene.mse(scene.fit_method(CUBIC, seed))) for seed in seeds]
    fits = [scene.fit_method(method, seed) for seed in seeds]
    errors = np.array([scene.mse(fitted) for fitted in fits])[:, None]
    gains = np.array(rivals) / errors
    loss = np.median([fitted.loss_curve.min(initial=np.inf) for fitted in fits])
    return (
        f"{method.name:28} {np.median(gains[:, 0]):9.1f} {gains[:, 0].min():9.1f} {np.median(gains[:, 1]):8.2f} "
        f"{gains[:, 1].min():8.2f} {np.median([scene.horizon(fitted) for fitted in fits]):7.2f} "
        f"{loss:9.1e} {fits[0].parameter_count:8d} {np.median([fitted.seconds for fitted in fits]):7.1f}"
    )


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation: factors below the cubic."""
    scene = make_scene("stiff", 30, 0.0)
    cubic = scene.mse(scene.fit_method(CUBIC, 0))
    return [
        estimate_median(
            f"{method.name}: error below a cubic's by",
            [cubic / scene.mse(scene.fit_method(method, seed)) for seed in QUICK_SEEDS],
            "times",
        )
        for method in QUICK_METHODS
    ]


def select_methods(thesis: bool, only: str | None) -> Iterator[MotionMethod]:
    candidates = (
        *CURVES,
        *(THESIS_METHODS if thesis else ()),
        *CHANGES,
        *CHEAP,
        *((CONSTRAINT_NET,) if thesis else ()),
    )
    yield from (method for method in candidates if only is None or only in method.name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", default="stiff", choices=("soft", "medium", "stiff"), help="springs")
    parser.add_argument("--fps", type=int, default=30, help="frame rate")
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation, px")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--first", type=int, default=100, help="first seed")
    parser.add_argument("--thesis", action="store_true", help="add the large networks of the thesis")
    parser.add_argument("--only", help="only methods whose name contains this")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"stiff springs, 30 Hz, no noise, seeds {QUICK_SEEDS[0]} and {QUICK_SEEDS[-1]}"
        run_quick("neural.neural_steps", measure_figures, inputs)
        return
    scene = make_scene(arguments.kind, arguments.fps, arguments.noise)
    print(f"{arguments.kind} {arguments.fps} Hz, {arguments.noise} px, {arguments.seeds} seeds")
    print(f"{'':28}  x linear   (least)  x cubic  (least) horizon      loss  weights   CPU s")
    for method in select_methods(arguments.thesis, arguments.only):
        print(format_row(scene, method, range(arguments.first, arguments.first + arguments.seeds)), flush=True)


if __name__ == "__main__":
    main()
