"""Check the claims of Chen 2022 and the goals of the physics fits; every line also compares with a cubic spline.

    python -m benchmarks.neural.thesis [net] [constraint] [springs] [boxes] [real] [--quick] [--seeds 5]
        [--first 200] [--data FOLDER] [--effort 1] [--seconds S]

Every other frame is withheld; mse is in px^2 over the withheld frames, mean over points and coordinates, medians over
the seeds. The CPU seconds of a physics fit are compared with the length of its scene; code is compiled before. Parts:

- net: the network of the thesis on the stiff springs, 30 Hz, 2.5 s, without noise.
- constraint: ConstraintNet on the double pendulum and the boxes, from the visible samples and trained on other
  simulated motions.
- springs: ten seconds of the double pendulum, fitted without prior knowledge (`benchmarks/neural/spring_fits.py`).
- boxes: a ball thrown into fifty boxes, simulated by pymunk (extra `check`), 2.5 s without noise; the fit knows which
  corners belong to one box.
- real: a recorded double pendulum, every 13th and 26th sample of its 200 Hz; needs `--data`.

Without names all parts run, which takes hours; a line that misses its goal ends in `missed`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.neural.spring_fits import CASES, FUTURE_SECONDS, SpringFitScore, score_fit, simulate_truth
from benchmarks.support.figures import Figure, add_quick_option, estimate_median, run_quick
from models.core.recording import record_points
from models.estimation.springs.latent_inference import infer_springs
from models.neural.common.method_interface import AKIMA, CUBIC, LINEAR, MotionMethod, TrainingBudget
from pipeline.experiments.thesis.compared_methods import (
    CONSTRAINT_NET,
    PHYSICS,
    PRETRAINED_NET,
    build_methods,
)
from pipeline.experiments.thesis.thesis_scenes import (
    SPEEDS,
    STARTS,
    ExperimentCase,
    WithheldSeries,
    build_boxes_series,
    build_pendulum_series,
    mean_squared_error,
    read_recorded_series,
)

RATES = (60.0, 30.0, 15.0)
# Length of the scenes of networks and boxes, and of springs, s; a fit may take as many CPU seconds as its scene.
SECONDS, FIT_SECONDS = 2.5, 10.0
# Goals: factors below cubic, by rate and noise, for soft and medium springs.
SPRINGS_GOALS = {(30, 0.1): 300.0, (30, 0.5): 30.0, (15, 0.1): 100.0}
# Seeds of `--quick`, the network with two of them, and the share of its training.
QUICK_SEEDS, QUICK_EFFORT = range(960, 963), 0.25
QUICK_SPRINGS, QUICK_SPRINGS_SEEDS = (("soft", 30, 0.5), ("stiff", 30, 0.1)), range(960, 968)
STIFF_GOAL, NETWORK_GOAL, BOXES_GOAL, AKIMA_GOAL, REAL_GOAL = 5.0, 100.0, 3.0, 6, 10.0


@dataclass(frozen=True)
class MethodScores:
    """Factors by which the error of a method is below that of other methods."""

    linear: float
    cubic: float
    akima: float
    seconds: float


@dataclass(frozen=True)
class ThesisOptions:
    """Options of the parts."""

    seeds: range
    data: Path | None
    """Folder of the recorded double pendulum."""
    budget: TrainingBudget
    """Training budget of networks."""


def score_method(method: MotionMethod, series: WithheldSeries, budget: TrainingBudget | None = None) -> MethodScores:
    t, true = series.withheld_samples
    linear, cubic, akima = (
        mean_squared_error(rival.fit(*series.visible_samples).at(t), true) for rival in (LINEAR, CUBIC, AKIMA)
    )
    began = time.process_time()
    error = mean_squared_error(
        method.fit(*series.visible_samples, series.case.seed, budget or TrainingBudget()).at(t), true
    )
    return MethodScores(linear / error, cubic / error, akima / error, time.process_time() - began)


def median(rows: list[MethodScores], name: str) -> float:
    return float(np.median([getattr(row, name) for row in rows]))


def print_line(name: str, text: str, reached: bool | None) -> None:
    verdict = "" if reached is None else "reached" if reached else "missed"
    print(f"{name:30} {text:84} {verdict}", flush=True)


def format_scores(rows: list[MethodScores]) -> str:
    values = " ".join(f"x {name} {median(rows, name):9.1f}" for name in ("linear", "cubic", "akima"))
    return f"{values}  least x linear {min(row.linear for row in rows):7.1f}  {median(rows, 'seconds'):5.1f} CPU s"


def print_thesis_network(options: ThesisOptions) -> None:
    """Check the claim of the thesis, figure 6; variants of its network with the first seed alone."""
    from models.neural.method_catalogue import THESIS_METHODS
    from models.neural.networks.neural_runge_kutta import RUNGE_KUTTA_NET

    for method in (RUNGE_KUTTA_NET, *(method for method in THESIS_METHODS if method is not RUNGE_KUTTA_NET)):
        seeds = options.seeds if method is RUNGE_KUTTA_NET else options.seeds[:1]
        cases = [ExperimentCase("double-pendulum", "stiff", 30.0, 0.0, seed) for seed in seeds]
        rows = [score_method(method, build_pendulum_series(case, SECONDS), options.budget) for case in cases]
        print_line(
            method.name,
            format_scores(rows),
            median(rows, "linear") >= NETWORK_GOAL if method is RUNGE_KUTTA_NET else None,
        )


def print_constraint_networks(options: ThesisOptions) -> None:
    """Score ConstraintNet on the double pendulum, and on the boxes, which the thesis did not."""
    for scene, variant, series in (
        ("double-pendulum", "stiff", build_pendulum_series),
        ("boxes", "800", build_boxes_series),
    ):
        cases = [ExperimentCase(scene, variant, 30.0, 0.0, seed) for seed in options.seeds]
        for method in build_methods(scene, variant):
            if method.name in (CONSTRAINT_NET, PRETRAINED_NET):
                rows = [score_method(method, series(case, SECONDS), options.budget) for case in cases]
                print_line(f"{method.name}, {scene}", format_scores(rows), None)


def score_springs(kind: str, fps: int, noise: float, seeds: range) -> list[SpringFitScore]:
    frames = int(FIT_SECONDS * fps) // 2 * 2 + 1
    t = np.arange(frames + int(FUTURE_SECONDS * fps)) / fps
    x = simulate_truth(kind, t)
    return [score_fit(x, t, frames, noise, seed) for seed in seeds]


def score_boxes(speed: str, fps: float, seeds: range) -> list[MethodScores]:
    cases = [ExperimentCase("boxes", speed, fps, 0.0, seed) for seed in seeds]
    return [score_method(PHYSICS["boxes"], build_boxes_series(case, SECONDS)) for case in cases]


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation: factors below linear interpolation, or below a cubic."""
    from models.neural.networks.neural_runge_kutta import RUNGE_KUTTA_NET

    cases = [ExperimentCase("double-pendulum", "stiff", 30.0, 0.0, seed) for seed in QUICK_SEEDS[:2]]
    budget = TrainingBudget(QUICK_EFFORT)
    nets = [score_method(RUNGE_KUTTA_NET, build_pendulum_series(case, SECONDS), budget) for case in cases]
    figures = [
        estimate_median("thesis' network, stiff springs: error below linear's by", [r.linear for r in nets], "times")
    ]
    for kind, fps, noise in QUICK_SPRINGS:
        rows = score_springs(kind, fps, noise, QUICK_SPRINGS_SEEDS)
        gains = [row.cubic / row.mse for row in rows]
        figures.append(
            estimate_median(f"fit of {kind} springs, {noise:g} px: error below a cubic's by", gains, "times")
        )
    boxes = [row.linear for row in score_boxes("800", 30.0, QUICK_SEEDS)]
    return [*figures, estimate_median("fit of boxes, 800 px/s: error below linear's by", boxes, "times")]


def print_springs(options: ThesisOptions) -> None:
    """Score the fit of springs."""
    t = np.arange(20) / 15
    infer_springs(record_points(t, simulate_truth("soft", t)))  # compiled before the clock starts
    for kind, fps, noise in CASES:
        rows = score_springs(kind, fps, noise, options.seeds)
        gain = float(np.median([row.cubic / row.mse for row in rows]))
        horizon = float(np.median([row.horizon for row in rows]))
        least = SPRINGS_GOALS.get((fps, noise), STIFF_GOAL) if kind != "stiff" else STIFF_GOAL
        text = (
            f"x cubic {gain:8.1f} of {least:5.0f}, least {min(row.cubic / row.mse for row in rows):8.1f}, "
            f"accepted {sum(row.accepted for row in rows)}/{len(rows)}, joined {sum(row.joined for row in rows)}, "
            f"m s g {max(row.worst_parameter for row in rows):.1%}, "
            f"k {max(row.stiffness for row in rows):.1%}, {horizon:.1f} s ahead, "
            f"{max(row.seconds for row in rows):.1f} CPU s"
        )
        is_identified = (
            all(row.accepted and row.joined for row in rows) and max(row.worst_parameter for row in rows) < 0.02
        )
        is_fast = max(row.seconds for row in rows) < FIT_SECONDS
        is_exact = kind == "stiff" or max(row.stiffness for row in rows) < 0.05
        is_far = kind == "stiff" or noise > 0.1 or horizon >= 3
        print_line(
            f"{kind} {fps} Hz {noise} px", text, gain >= least and is_identified and is_exact and is_far and is_fast
        )


def print_boxes(options: ThesisOptions) -> None:
    """Score the contact-aware fit of rigid bodies."""
    cells = []
    score_method(
        PHYSICS["boxes"], build_boxes_series(ExperimentCase("boxes", SPEEDS[0], 30.0, 0.0, 0), 0.5)
    )  # compiled before the clock starts
    for speed in SPEEDS:
        for fps in RATES:
            rows = score_boxes(speed, fps, options.seeds)
            cells.append(rows)
            print_line(f"boxes {speed} px/s {fps:.0f} Hz", format_scores(rows), None)
    gains = [median(rows, "linear") for rows in cells]
    better = sum(median(rows, "akima") > 1 for rows in cells)
    slowest = max(row.seconds for rows in cells for row in rows)
    text = (
        f"x linear {np.median(gains):.1f} in the median cell, below Akima in {better} of {len(cells)}, "
        f"at most {slowest:.1f} CPU s"
    )
    reached = bool(np.median(gains) >= BOXES_GOAL) and better >= AKIMA_GOAL and slowest < SECONDS
    print_line("boxes", text, reached)


def print_real_pendulum(options: ThesisOptions) -> None:
    """Score the fit of a real double pendulum."""
    if options.data is None:
        print_line("real pendulum", "not run: give --data the folder of double_freeswing_200Hz.npz", None)
        return
    for apart in (13, 26):
        rows = [
            score_method(
                PHYSICS["real"], read_recorded_series(ExperimentCase("real", start, 200 / apart, 0.0, 0), options.data)
            )
            for start in STARTS
        ]
        print_line(
            f"real, {apart} samples apart",
            format_scores(rows),
            median(rows, "cubic") >= REAL_GOAL if apart == 26 else None,
        )


PARTS: dict[str, Callable[[ThesisOptions], None]] = {
    "net": print_thesis_network, "constraint": print_constraint_networks, "springs": print_springs,
    "boxes": print_boxes, "real": print_real_pendulum,
}  # fmt: skip


def select_parts(names: list[str]) -> Iterator[Callable[[ThesisOptions], None]]:
    yield from (PARTS[name] for name in names or PARTS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="parts to run; default: all")
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds")
    parser.add_argument("--first", type=int, default=200, help="first seed")
    parser.add_argument("--data", type=Path, help="folder of the recorded double pendulum")
    parser.add_argument("--effort", type=float, default=1.0, help="share of the full training of networks")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="CPU seconds after which training stops")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"30 Hz, seeds from {QUICK_SEEDS[0]}, the network with {QUICK_EFFORT:.0%} of its training"
        run_quick("neural.thesis", measure_figures, inputs)
        return
    budget = TrainingBudget(arguments.effort, arguments.seconds)
    for part in select_parts(arguments.parts):
        part(ThesisOptions(range(arguments.first, arguments.first + arguments.seeds), arguments.data, budget))


if __name__ == "__main__":
    main()
