"""Compare the fit of springs with splines on the double pendulum of Chen 2022, section 3.1.1.

    python -m benchmarks.physics.spring_fits [--seeds 5] [--seconds 10] [--first 100] [--real FOLDER]

Truth: first ball fixed at (200, 190), the others 80 px apart in a row, masses 1, g 981 px/s^2, from rest, DOP853 at
1e-10. Every other frame is withheld; the visible ones have noise. mse is in px^2 over withheld frames, mean over points
and coordinates; cubic is the not-a-knot spline through the visible samples. The fit knows neither the noise nor which
balls are connected. Horizon: seconds after the last frame until a ball is 10 px off (at most 5). Medians over the
seeds. Takes some minutes.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline, interp1d, make_interp_spline

from models.estimation.pendulum.pendulum_fit import fit_pendulum
from models.estimation.springs.latent_inference import LatentSprings, infer_springs
from pipeline.experiments.thesis.scenes.double_pendulum_scene import SPRING_KINDS, simulate_double_pendulum

CASES = [
    *((kind, fps, noise) for kind in ("soft", "medium") for fps, noise in ((30, 0.1), (30, 0.5), (15, 0.1))),
    ("stiff", 30, 0.1),
]
PAIRS = [[0, 1], [1, 2]]
FUTURE_SECONDS = 5.0
"""Extrapolated time, s."""
LOST_PX = 10.0
"""Error at which an extrapolation counts as lost, px."""


@dataclass(frozen=True)
class SpringFitScore:
    """Scores of one seed."""

    mse: float
    cubic: float
    rivals: dict[str, float]
    """mse of other splines, px^2."""
    worst_parameter: float
    """Largest relative error of masses, rest lengths and gravity."""
    stiffness: float
    """Relative error of the springs' stiffness; NaN where they became rods."""
    horizon: float
    seconds: float
    accepted: bool
    joined: bool
    """Whether exactly the true connections were found."""


def simulate_truth(kind: str, t: np.ndarray) -> np.ndarray:
    """Simulate the double pendulum; returns (T, 3, 2) px."""
    return simulate_double_pendulum(kind, tuple(t))


def score_fit(x: np.ndarray, t: np.ndarray, frames: int, noise: float, seed: int) -> SpringFitScore:
    noisy = x + noise * np.random.default_rng(seed).standard_normal(x.shape)
    shown, hidden, later = slice(0, frames, 2), slice(1, frames, 2), slice(frames, None)
    began = time.process_time()
    latent = infer_springs(t[shown], noisy[shown])
    seconds = time.process_time() - began

    def mse(guess: np.ndarray) -> float:
        return float(np.mean((guess - x[hidden]) ** 2))

    rivals = {
        "linear": mse(interp1d(t[shown], noisy[shown], axis=0)(t[hidden])),
        "quintic": mse(make_interp_spline(t[shown], noisy[shown], k=5)(t[hidden])),
        "akima": mse(Akima1DInterpolator(t[shown], noisy[shown])(t[hidden])),
    }
    off = np.linalg.norm(latent.states_at(t[later])[:, 0] - x[later], axis=2).max(axis=1)
    lost = np.flatnonzero(off > LOST_PX)
    horizon = float(t[later][lost[0]] - t[frames - 1]) if len(lost) else FUTURE_SECONDS
    return SpringFitScore(
        mse(latent.states_at(t[hidden])[:, 0]), mse(CubicSpline(t[shown], noisy[shown])(t[hidden])), rivals,
        largest_parameter_error(latent),
        stiffness_error(latent), horizon, seconds, latent.is_accepted,
        latent.graph.pairs.tolist() == PAIRS,
    )  # fmt: skip


def largest_parameter_error(latent: LatentSprings) -> float:
    graph = latent.graph
    return float(max(
        np.abs(graph.mass[~graph.fixed] - 1).max(), np.abs(graph.rest / 80 - 1).max(initial=0.0),
        abs(float(np.hypot(*graph.gravity)) / 981 - 1),
    ))  # fmt: skip


def stiffness_error(latent: LatentSprings) -> float:
    """Return the largest relative error of the stiffness, against the nearest kind of springs."""
    finite = latent.graph.stiffness[np.isfinite(latent.graph.stiffness)]
    true = np.array([stiffness for stiffness, _ in SPRING_KINDS.values()])
    return float(np.abs(finite[:, None] / true - 1).min(axis=1).max()) if len(finite) else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--first", type=int, default=100, help="first seed")
    parser.add_argument(
        "--real", type=Path, help="folder of double_freeswing_200Hz.npz; scores the recorded pendulum instead"
    )
    arguments = parser.parse_args()
    if arguments.real:
        print_real_pendulum(arguments.real)
        return
    print(
        "springs fps noise | x cubic  (least)  x linear x quintic   x akima "
        "| worst m,s,g   k error  horizon  CPU s  accepted"
    )
    for kind, fps, noise in CASES:
        frames = int(arguments.seconds * fps) // 2 * 2 + 1
        t = np.arange(frames + int(FUTURE_SECONDS * fps)) / fps
        x = simulate_truth(kind, t)
        rows = [score_fit(x, t, frames, noise, arguments.first + seed) for seed in range(arguments.seeds)]
        gain = [row.cubic / row.mse for row in rows]
        others = [np.median([row.rivals[name] / row.mse for row in rows]) for name in ("linear", "quintic", "akima")]
        print(
            f"{kind:7} {fps:3d} {noise:5.1f} | {np.median(gain):8.1f} {min(gain):8.1f} "
            + " ".join(f"{other:9.1f}" for other in others)
            + f" | {max(row.worst_parameter for row in rows):9.2%} {max(row.stiffness for row in rows):9.2%} "
            f"{np.median([row.horizon for row in rows]):6.2f} {max(row.seconds for row in rows):7.1f} "
            f"{sum(row.accepted for row in rows)}/{len(rows)}",
            flush=True,
        )


def print_real_pendulum(folder: Path) -> None:
    """Score a real double pendulum at 200 Hz (dynamicslab/MultiArm-Pendulum).

    Every `step`-th sample is used; every other one of these is withheld.
    """
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
            fit = fit_pendulum(t[shown], angles[shown])
            seconds = time.process_time() - began
            cubic = np.mean((CubicSpline(t[shown], angles[shown])(t[hidden]) - angles[hidden]) ** 2)
            ours = np.mean((fit.states_at(t[hidden])[:, :2] - angles[hidden]) ** 2)
            print(
                f"{step:3d} {t[start]:5.1f} | {cubic:8.1e} {ours:8.1e} {cubic / ours:9.0f} {seconds:6.1f}", flush=True
            )


if __name__ == "__main__":
    main()
