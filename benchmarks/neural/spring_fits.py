"""The double pendulum of Chen 2022, section 3.1.1, and scores of the fit of its springs.

Truth: first ball fixed at (200, 190), the others 80 px apart in a row, masses 1, g 981 px/s^2, from rest, DOP853 at
1e-10. Every other frame is withheld; the visible ones have noise. mse is in px^2 over withheld frames, mean over points
and coordinates; cubic is the not-a-knot spline through the visible samples. The fit knows neither the noise nor which
balls are connected. Horizon: seconds after the last frame until a ball is 10 px off (at most 5).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.recording import record_points
from models.estimation.springs.latent_inference import LatentSprings, infer_springs
from pipeline.experiments.thesis.thesis_scenes import SPRING_KINDS, simulate_double_pendulum

CASES = [
    *((kind, fps, noise) for kind in ("soft", "medium") for fps, noise in ((30, 0.1), (30, 0.5), (15, 0.1))),
    ("stiff", 30, 0.1),
]
PAIRS = [[0, 1], [1, 2]]
# Extrapolated time, s.
FUTURE_SECONDS = 5.0
# Error at which an extrapolation counts as lost, px.
LOST_PX = 10.0


@dataclass(frozen=True)
class SpringFitScore:
    """Scores of one seed."""

    mse: float
    cubic: float
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
    latent = infer_springs(record_points(t[shown], noisy[shown]))
    seconds = time.process_time() - began

    def mse(guess: np.ndarray) -> float:
        return float(np.mean((guess - x[hidden]) ** 2))

    off = np.linalg.norm(latent.states_at(t[later])[:, 0] - x[later], axis=2).max(axis=1)
    lost = np.flatnonzero(off > LOST_PX)
    horizon = float(t[later][lost[0]] - t[frames - 1]) if len(lost) else FUTURE_SECONDS
    return SpringFitScore(
        mse(latent.states_at(t[hidden])[:, 0]), mse(CubicSpline(t[shown], noisy[shown])(t[hidden])),
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
