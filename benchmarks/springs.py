"""What a fit of springs is worth against splines, on the double pendulum of Chen 2022, section 3.1.1.

    python benchmarks/springs.py [--seeds 5] [--seconds 10] [--first 100] [--real FOLDER]

Truth: first ball held at (200, 190), the others 80 px apart in a row, masses 1, g 981 px/s^2, from rest, DOP853 at
1e-10. Every other frame is withheld; the rest has noise. mse is in px^2 over withheld midpoints, mean over points and
coordinates; cubic is the not-a-knot spline through the visible samples. The fit is told neither the noise nor who is
joined to whom. Horizon: seconds after the last frame until a ball is 10 px off (at most 5). Medians over the seeds.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline, interp1d, make_interp_spline

from models.estimation.pendulum.pendulum_fit import swing
from models.estimation.springs.latent_inference import Latent, infer
from pipeline.experiments.thesis.scenes.double_pendulum_scene import KINDS, swung

CASES = [
    *((kind, fps, noise) for kind in ("soft", "medium") for fps, noise in ((30, 0.1), (30, 0.5), (15, 0.1))),
    ("stiff", 30, 0.1),
]
PAIRS = [[0, 1], [1, 2]]
FUTURE = 5.0
"""s."""
LOST = 10.0
"""px."""


@dataclass(frozen=True)
class Row:
    """One seed."""

    mse: float
    cubic: float
    rivals: dict[str, float]
    """mse of other splines."""
    worst: float
    """largest relative error of masses, rest lengths and gravity."""
    stiffness: float
    """relative error of the springs' stiffness; NaN where they became rods."""
    horizon: float
    seconds: float
    accepted: bool
    joined: bool
    """who is joined to whom was found, and nobody else."""


def truth(kind: str, t: np.ndarray) -> np.ndarray:
    """(T, 3, 2) px."""
    return swung(kind, tuple(t))


def measure(x: np.ndarray, t: np.ndarray, frames: int, noise: float, seed: int) -> Row:
    seen = x + noise * np.random.default_rng(seed).standard_normal(x.shape)
    shown, hidden, later = slice(0, frames, 2), slice(1, frames, 2), slice(frames, None)
    began = time.process_time()
    latent = infer(t[shown], seen[shown])
    seconds = time.process_time() - began

    def mse(guess: np.ndarray) -> float:
        return float(np.mean((guess - x[hidden]) ** 2))

    rivals = {
        "linear": mse(interp1d(t[shown], seen[shown], axis=0)(t[hidden])),
        "quintic": mse(make_interp_spline(t[shown], seen[shown], k=5)(t[hidden])),
        "akima": mse(Akima1DInterpolator(t[shown], seen[shown])(t[hidden])),
    }
    off = np.linalg.norm(latent.at(t[later])[:, 0] - x[later], axis=2).max(axis=1)
    lost = np.flatnonzero(off > LOST)
    horizon = float(t[later][lost[0]] - t[frames - 1]) if len(lost) else FUTURE
    return Row(
        mse(latent.at(t[hidden])[:, 0]), mse(CubicSpline(t[shown], seen[shown])(t[hidden])), rivals, worst(latent),
        stiffness_error(latent), horizon, seconds, latent.accepted,
        latent.graph.pairs.tolist() == PAIRS,
    )  # fmt: skip


def worst(latent: Latent) -> float:
    graph = latent.graph
    return float(max(
        np.abs(graph.mass[~graph.held] - 1).max(), np.abs(graph.rest / 80 - 1).max(initial=0.0),
        abs(float(np.hypot(*graph.gravity)) / 981 - 1),
    ))  # fmt: skip


def stiffness_error(latent: Latent) -> float:
    """Against the kind of springs that is nearest."""
    known = latent.graph.stiffness[np.isfinite(latent.graph.stiffness)]
    true = np.array([stiffness for stiffness, _ in KINDS.values()])
    return float(np.abs(known[:, None] / true - 1).min(axis=1).max()) if len(known) else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--first", type=int, default=100, help="first seed")
    parser.add_argument("--real", type=Path, help="folder of double_freeswing_200Hz.npz")
    arguments = parser.parse_args()
    if arguments.real:
        real(arguments.real)
        return
    print(
        "springs fps noise | x cubic  (least)  x linear x quintic   x akima "
        "| worst m,s,g   k error  horizon  CPU s  accepted"
    )
    for kind, fps, noise in CASES:
        frames = int(arguments.seconds * fps) // 2 * 2 + 1
        t = np.arange(frames + int(FUTURE * fps)) / fps
        x = truth(kind, t)
        rows = [measure(x, t, frames, noise, arguments.first + seed) for seed in range(arguments.seeds)]
        gain = [row.cubic / row.mse for row in rows]
        others = [np.median([row.rivals[name] / row.mse for row in rows]) for name in ("linear", "quintic", "akima")]
        print(
            f"{kind:7} {fps:3d} {noise:5.1f} | {np.median(gain):8.1f} {min(gain):8.1f} "
            + " ".join(f"{other:9.1f}" for other in others)
            + f" | {max(row.worst for row in rows):9.2%} {max(row.stiffness for row in rows):9.2%} "
            f"{np.median([row.horizon for row in rows]):6.2f} {max(row.seconds for row in rows):7.1f} "
            f"{sum(row.accepted for row in rows)}/{len(rows)}",
            flush=True,
        )


def real(folder: Path) -> None:
    """A real double pendulum at 200 Hz (dynamicslab/MultiArm-Pendulum): every `step`th sample, every other hidden."""
    recorded = np.load(folder / "double_freeswing_200Hz.npz")
    t = recorded["t"]
    angles = np.unwrap(np.stack([recorded["theta1"], recorded["theta2"]], axis=1), axis=0) - np.pi
    print("real pendulum: samples apart, start s | mse cubic  mse fit rad^2  x cubic  CPU s")
    for step in (13, 26):
        for start in (0, 3000, 6000):
            rows = np.arange(start, start + 2001, step)
            rows = rows[: len(rows) - 1 + len(rows) % 2]
            shown, hidden = rows[::2], rows[1::2]
            began = time.process_time()
            fit = swing(t[shown], angles[shown])
            seconds = time.process_time() - began
            cubic = np.mean((CubicSpline(t[shown], angles[shown])(t[hidden]) - angles[hidden]) ** 2)
            ours = np.mean((fit.at(t[hidden])[:, :2] - angles[hidden]) ** 2)
            print(
                f"{step:3d} {t[start]:5.1f} | {cubic:8.1e} {ours:8.1e} {cubic / ours:9.0f} {seconds:6.1f}", flush=True
            )


if __name__ == "__main__":
    main()
