"""The cloth fitted to free paths, against paths that are integrated step by step."""

from __future__ import annotations

import numpy as np

from benchmarks.fitting.free_paths import FreePath, FreePaths, extract_free_paths
from models.core.events import Events
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import ShootingFit, fit_windows

G, SIGMA, FPS = 9.81, 0.0004, 30.0
SLIDING, ROLLING = 0.17, 0.0102


def integrate_path(v: FloatArray, slip: FloatArray, t: FloatArray, tilt: FloatArray, bumps: FloatArray) -> FloatArray:
    """Positions (K, 2) at t of a ball that starts at 0; `tilt` (2,) m/m, `bumps` (B, 2) m/s^2 for 0.4 s each."""
    step, now, x, v, slip, result = 2e-3, 0.0, np.zeros(2), v.copy(), slip.copy(), []
    for moment in t:
        while now < moment - 1e-12:
            push = bumps[min(int(now / 0.4), len(bumps) - 1)] + 5 / 7 * G * tilt
            speed, slide = float(np.hypot(*v)), float(np.hypot(*slip))
            if slide > 3.5 * SLIDING * G * step:
                a = -SLIDING * G * slip / slide
                slip = slip + 3.5 * a * step
            else:
                slip = np.zeros(2)
                a = push - ROLLING * G * v / max(speed, 1e-9)
            if slide == 0 and speed < 2 * ROLLING * G * step:
                v, a = np.zeros(2), np.zeros(2)
            x, v, now = x + v * step + a * step**2 / 2, v + a * step, now + step
        result.append(x.copy())
    return np.array(result)


def simulate_paths(
    rng: np.random.Generator, tilt: FloatArray, roughness: float, paths: int = 4
) -> tuple[FreePath, ...]:
    """Roll-outs in all directions, half of them without initial spin."""
    result = []
    for k in range(paths):
        angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.6)
        v = speed * np.array([np.cos(angle), np.sin(angle)])
        t = np.arange(1, int(FPS * (speed / 0.1 + 0.5))) / FPS
        bumps = roughness * rng.standard_normal((20, 2))
        xy = integrate_path(v, v * (k % 2), t, tilt, bumps) + SIGMA * rng.standard_normal((len(t), 2))
        result.append(FreePath(k, "cue", 0.0, t, xy, np.tile(np.eye(2) / SIGMA, (len(t), 1, 1)), bool(k % 2)))
    return tuple(result)


def pulls(result: ShootingFit, tilt: FloatArray) -> FloatArray:
    return np.asarray((result.shared - np.array([SLIDING, ROLLING, *(1e3 * tilt)])) / result.sigma)


def test_friction_of_an_even_level_cloth_is_found() -> None:
    result = fit_windows(FreePaths(simulate_paths(np.random.default_rng(0), np.zeros(2), 0.0), unevenness=0.001))
    assert abs(result.shared[1] / ROLLING - 1) < 0.02
    assert abs(result.shared[0] / SLIDING - 1) < 0.15


def test_errors_match_their_sigma_on_an_uneven_sloping_cloth() -> None:
    tilt = np.array([-0.0015, 0.0008])
    observed = np.array([
        pulls(fit_windows(FreePaths(simulate_paths(np.random.default_rng(seed), tilt, 0.008, 3), 0.01)), tilt)
        for seed in range(8)
    ])  # fmt: skip
    spread = np.sqrt((observed**2).mean(axis=0))
    assert np.all(spread < 1.6), spread
    assert np.all(spread > 0.3), spread


def test_an_uneven_cloth_has_more_evidence_where_it_is_uneven() -> None:
    rough = simulate_paths(np.random.default_rng(3), np.zeros(2), 0.01)
    even = simulate_paths(np.random.default_rng(3), np.zeros(2), 0.0)
    gain = [
        fit_windows(FreePaths(paths, unevenness=0.01)).log_evidence
        - fit_windows(FreePaths(paths, unevenness=0.001)).log_evidence
        for paths in (rough, even)
    ]
    assert gain[0] > 3
    assert gain[1] < -3


def test_one_direction_does_not_separate_slope_from_friction() -> None:
    path = simulate_paths(np.random.default_rng(1), np.zeros(2), 0.0, paths=1)
    one = fit_windows(FreePaths(path, unevenness=0.001))
    level = fit_windows(FreePaths(path, unevenness=0.001, slope=1e-3))
    assert one.sigma[1] > 3 * level.sigma[1]


def test_paths_keep_away_from_contacts_and_mark_balls_hit_at_rest() -> None:
    t = np.arange(60) / FPS
    xy = np.zeros((60, 2, 2))
    xy[:, 0, 0] = np.where(t < 1.0, 0.4 * t, 0.4)
    xy[:, 1, 0] = 0.45 + np.where(t < 1.0, 0.0, 0.4 * (t - 1.0))
    sigma = np.full((60, 2), SIGMA)
    tracks = Tracks(
        np.arange(60), t, ("cue", "red"), ("cue", "red"), xy, xy * 600, sigma, sigma, np.zeros_like(xy),
        np.full_like(sigma, 15.0), np.zeros((2, 3)),
    )  # fmt: skip
    one, nothing = np.array([1.0]), np.array([np.nan])
    events = Events(("ball",), one, one * 0.01, one * 30, ("cue",), ("red",), np.zeros((1, 2)), one, nothing,
                    nothing, one)  # fmt: skip
    result = extract_free_paths(tracks, events, 0, 0.02)
    assert [(path.ball, path.spinless) for path in result] == [("red", True)]
    assert result[0].t[0] >= 1.03
