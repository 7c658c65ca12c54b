"""What Chen 2022 claims, and what is asked of the fits of the physics: every line also against a cubic spline.

    python benchmarks/thesis.py [net] [constraint] [springs] [boxes] [real] [--seeds 5] [--first 200] [--data FOLDER]
                                [--effort 1] [--seconds S]

Every other frame is withheld; mse is in px^2 over the withheld midpoints, mean over points and coordinates, medians
over the seeds. A fit of the physics may take as long as its scene lasts, which its CPU seconds are held to; code is
compiled before. net: the network of the thesis on the stiff springs, 30 Hz, 2.5 s, without noise. springs: ten seconds
of the double pendulum, the fit told nothing (`benchmarks/springs.py`). boxes: a ball thrown into fifty boxes, moved by
pymunk, 2.5 s without noise, the fit told which corners are of one box. constraint: ConstraintNet on both of these
scenes, from the visible samples and taught by other simulated motions. real: a recorded double pendulum at 13 and 26
samples apart of its 200 Hz. Without names all of them, which takes hours; a line that misses what is asked ends in
`missed`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from springs import CASES, FUTURE, measure, truth

from models.estimation.springs.latent_inference import infer
from models.neural.common.method_interface import Budget, Method
from models.neural.common.spline_methods import AKIMA, CUBIC, LINEAR
from pipeline.experiments.thesis.compared_methods import CONSTRAINT_NET, TAUGHT, methods_for
from pipeline.experiments.thesis.physics_methods import ArmsFit, BoxesFit
from pipeline.experiments.thesis.scenes.boxes_scene import SPEEDS, boxes
from pipeline.experiments.thesis.scenes.double_pendulum_scene import STARTS, double_pendulum, real_pendulum
from pipeline.experiments.thesis.scenes.withheld_series import Case, Series, mean_square

RATES = (60.0, 30.0, 15.0)
SECONDS, FIT_SECONDS = 2.5, 10.0
"""s of the scenes of networks and boxes, and of springs; and CPU s that a fit may take."""
SPRINGS_ASKED = {(30, 0.1): 300.0, (30, 0.5): 30.0, (15, 0.1): 100.0}
"""Times below cubic, by rate and noise, for soft and medium springs."""
STIFF_ASKED, NET_ASKED, BOXES_ASKED, AKIMA_ASKED, REAL_ASKED = 5.0, 100.0, 3.0, 6, 10.0


@dataclass(frozen=True)
class Scores:
    """How many times lower than others the error of a method is."""

    linear: float
    cubic: float
    akima: float
    seconds: float


@dataclass(frozen=True)
class Asked:
    """What is asked for."""

    seeds: range
    data: Path | None
    """Folder of the recorded double pendulum."""
    budget: Budget
    """of networks."""


def scores(method: Method, series: Series, budget: Budget | None = None) -> Scores:
    t, true = series.hidden
    linear, cubic, akima = (mean_square(rival.fit(*series.shown).at(t), true) for rival in (LINEAR, CUBIC, AKIMA))
    began = time.process_time()
    error = mean_square(method.fit(*series.shown, series.case.seed, budget or Budget()).at(t), true)
    return Scores(linear / error, cubic / error, akima / error, time.process_time() - began)


def median(rows: list[Scores], name: str) -> float:
    return float(np.median([getattr(row, name) for row in rows]))


def line(name: str, text: str, reached: bool | None) -> None:
    verdict = "" if reached is None else "reached" if reached else "missed"
    print(f"{name:30} {text:84} {verdict}", flush=True)


def summed(rows: list[Scores]) -> str:
    values = " ".join(f"x {name} {median(rows, name):9.1f}" for name in ("linear", "cubic", "akima"))
    return f"{values}  least x linear {min(row.linear for row in rows):7.1f}  {median(rows, 'seconds'):5.1f} CPU s"


def net(asked: Asked) -> None:
    """The claim of the thesis, figure 6; its network's variants with the first seed alone."""
    from models.neural.method_catalogue import THESIS
    from models.neural.networks.neural_runge_kutta import RUNGE_KUTTA

    for method in (RUNGE_KUTTA, *(method for method in THESIS if method is not RUNGE_KUTTA)):
        seeds = asked.seeds if method is RUNGE_KUTTA else asked.seeds[:1]
        cases = [Case("double-pendulum", "stiff", 30.0, 0.0, seed) for seed in seeds]
        rows = [scores(method, double_pendulum(case, SECONDS), asked.budget) for case in cases]
        line(method.name, summed(rows), median(rows, "linear") >= NET_ASKED if method is RUNGE_KUTTA else None)


def constraint(asked: Asked) -> None:
    """The thesis' rival, on the double pendulum and on the boxes, which the thesis did not."""
    for scene, variant, series in (("double-pendulum", "stiff", double_pendulum), ("boxes", "800", boxes)):
        cases = [Case(scene, variant, 30.0, 0.0, seed) for seed in asked.seeds]
        for method in methods_for(scene, variant):
            if method.name in (CONSTRAINT_NET, TAUGHT):
                rows = [scores(method, series(case, SECONDS), asked.budget) for case in cases]
                line(f"{method.name}, {scene}", summed(rows), None)


def pendulum(asked: Asked) -> None:
    """Springs behind coordinates."""
    t = np.arange(20) / 15
    infer(t, truth("soft", t))  # compiled before the clock starts
    for kind, fps, noise in CASES:
        frames = int(FIT_SECONDS * fps) // 2 * 2 + 1
        t = np.arange(frames + int(FUTURE * fps)) / fps
        x = truth(kind, t)
        rows = [measure(x, t, frames, noise, seed) for seed in asked.seeds]
        gain = float(np.median([row.cubic / row.mse for row in rows]))
        horizon = float(np.median([row.horizon for row in rows]))
        least = SPRINGS_ASKED.get((fps, noise), STIFF_ASKED) if kind != "stiff" else STIFF_ASKED
        text = (
            f"x cubic {gain:8.1f} of {least:5.0f}, least {min(row.cubic / row.mse for row in rows):8.1f}, "
            f"accepted {sum(row.accepted for row in rows)}/{len(rows)}, joined {sum(row.joined for row in rows)}, "
            f"m s g {max(row.worst for row in rows):.1%}, "
            f"k {max(row.stiffness for row in rows):.1%}, {horizon:.1f} s ahead, "
            f"{max(row.seconds for row in rows):.1f} CPU s"
        )
        told = all(row.accepted and row.joined for row in rows) and max(row.worst for row in rows) < 0.02
        quick = max(row.seconds for row in rows) < FIT_SECONDS
        exact = kind == "stiff" or max(row.stiffness for row in rows) < 0.05
        far = kind == "stiff" or noise > 0.1 or horizon >= 3
        line(f"{kind} {fps} Hz {noise} px", text, gain >= least and told and exact and far and quick)


def collisions(asked: Asked) -> None:
    """The contact-aware fit of rigid bodies."""
    cells = []
    scores(BoxesFit(), boxes(Case("boxes", SPEEDS[0], 30.0, 0.0, 0), 0.5))  # compiled before the clock starts
    for speed in SPEEDS:
        for fps in RATES:
            rows = [scores(BoxesFit(), boxes(Case("boxes", speed, fps, 0.0, seed), SECONDS)) for seed in asked.seeds]
            cells.append(rows)
            line(f"boxes {speed} px/s {fps:.0f} Hz", summed(rows), None)
    gains = [median(rows, "linear") for rows in cells]
    better = sum(median(rows, "akima") > 1 for rows in cells)
    slowest = max(row.seconds for rows in cells for row in rows)
    text = (
        f"x linear {np.median(gains):.1f} in the median cell, below Akima in {better} of {len(cells)}, "
        f"at most {slowest:.1f} CPU s"
    )
    reached = bool(np.median(gains) >= BOXES_ASKED) and better >= AKIMA_ASKED and slowest < SECONDS
    line("boxes", text, reached)


def recorded(asked: Asked) -> None:
    """A real double pendulum."""
    if asked.data is None:
        line("real pendulum", "not run: give --data the folder of double_freeswing_200Hz.npz", None)
        return
    for apart in (13, 26):
        rows = [
            scores(ArmsFit(), real_pendulum(Case("real", start, 200 / apart, 0.0, 0), asked.data)) for start in STARTS
        ]
        line(f"real, {apart} samples apart", summed(rows), median(rows, "cubic") >= REAL_ASKED if apart == 26 else None)


PARTS: dict[str, Callable[[Asked], None]] = {
    "net": net, "constraint": constraint, "springs": pendulum, "boxes": collisions, "real": recorded,
}  # fmt: skip


def chosen(names: list[str]) -> Iterator[Callable[[Asked], None]]:
    yield from (PARTS[name] for name in names or PARTS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=200, help="first seed")
    parser.add_argument("--data", type=Path, help="folder of the recorded double pendulum")
    parser.add_argument("--effort", type=float, default=1.0, help="share of their training that networks get")
    parser.add_argument(
        "--seconds", type=float, default=float("inf"), help="CPU s after which a network learns no more"
    )
    given = parser.parse_args()
    budget = Budget(given.effort, given.seconds)
    for part in chosen(given.parts):
        part(Asked(range(given.first, given.first + given.seeds), given.data, budget))


if __name__ == "__main__":
    main()
