"""Tracks of simulated shots, as a camera would give them, with their truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from support import fixed_step_table as truth

from models.core.fit_result import Fit
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks

RADIUS, LENGTH, WIDTH = 0.028575, 2.54, 1.27
PX_PER_M = 400.0
EXPOSURE = 0.008
DELAY = 0.4
FINE = 20
"""moments of truth per picture"""
SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True)
class Filmed:
    """A shot: what the fit gets, and what it should find."""

    tracks: Tracks
    scene: Scene
    xy: np.ndarray
    """(T, N, 2) m without noise."""
    contacts: list[tuple[float, str, str, str]]
    """t, kind, a, b of contacts faster than 0.03 m/s, up to a tenth of a second before the end."""
    strike: float


def scene(pockets: bool = False) -> Scene:
    """A 9 ft table from straight above."""
    table = Table("pool-9ft", "pool", LENGTH, WIDTH, RADIUS, 0.17, pockets)
    matrix = np.array([[PX_PER_M, 0, 0, 50], [0, PX_PER_M, 0, 50], [0, 0, 0, 1.0]])
    camera = Camera(matrix, 1200, 700, table.corners * PX_PER_M + 50, np.eye(8) * 0.25, "cloth", 3.0, 0.3)
    return Scene(table, camera, np.array([40.0, -30.0, 0.0]), ())


def film(
    x: np.ndarray, v: np.ndarray, w: np.ndarray, rng: np.random.Generator, *, fps: int = 30, noise_px: float = 0.3,
    seconds: float = 5.0, missing: float = 0.05, law: int = truth.MIRROR, pocket: float = 0.0,
    mu_s: float = 0.2, mu_r: float = 0.01,
) -> Filmed:  # fmt: skip
    """Balls at x (N, 2) m rest for `DELAY` s, then move off with v (N, 2) and w (N, 3)."""
    t, path, log = truth.play(
        x, v, w, seconds=seconds - DELAY, fps=fps * FINE, law=law, pocket=pocket, mu_s=mu_s, mu_r=mu_r
    )
    frames = np.arange(int(seconds * fps))
    times = frames / fps

    def at(moment: np.ndarray) -> np.ndarray:
        return np.stack(
            [[np.interp(moment - DELAY, t, path[:, i, k]) for k in (0, 1)] for i in range(len(x))]
        ).transpose(2, 0, 1)  # fmt: skip

    xy = at(times)
    streak = at(times + EXPOSURE / 2) - at(times - EXPOSURE / 2)
    streak[np.linalg.norm(streak, axis=2) * PX_PER_M < 3] = 0.0
    sigma = np.full(xy.shape[:2], noise_px / PX_PER_M)
    along = np.hypot(sigma, 0.08 * np.linalg.norm(streak, axis=2))
    length = np.linalg.norm(streak, axis=2, keepdims=True)
    axis = np.where(length > 0, streak / np.maximum(length, 1e-12), np.array([1.0, 0.0]))
    across = np.stack([-axis[..., 1], axis[..., 0]], axis=-1)
    seen = xy + (rng.normal(size=along.shape) * along)[..., None] * axis
    seen += (rng.normal(size=sigma.shape) * sigma)[..., None] * across
    seen[rng.random(sigma.shape) < missing] = np.nan
    lost = ~np.isfinite(seen[..., 0])
    count = len(x)
    ids = ("cue", *(f"solid-{k}" for k in range(1, count)))
    tracks = Tracks(
        frames, times, ids, ("cue", *["solid"] * (count - 1)), seen, seen * PX_PER_M + 50,
        np.where(lost, np.nan, sigma), np.where(lost, np.nan, along), np.nan_to_num(streak),
        np.full(sigma.shape, RADIUS * PX_PER_M), np.zeros((count, 3)),
    )  # fmt: skip
    return Filmed(tracks, scene(pocket > 0), xy, _contacts(log, ids, times[-1] - 0.1), DELAY)


def random_shot(seed: int, balls: int = 3, **options: float) -> Filmed:
    """A cue ball played at the first of some balls anywhere on the table, with any spin."""
    rng = np.random.default_rng(seed)
    x = np.zeros((balls, 2))
    while (np.linalg.norm(x[:, None] - x, axis=2) + np.eye(balls)).min() < 3 * RADIUS:
        x = rng.uniform([2 * RADIUS, 2 * RADIUS], [LENGTH - 2 * RADIUS, WIDTH - 2 * RADIUS], (balls, 2))
    aim = x[1] - x[0]
    angle = np.arctan2(aim[1], aim[0]) + rng.uniform(-1.6, 1.6) * RADIUS / np.hypot(*aim)
    v, w = np.zeros((balls, 2)), np.zeros((balls, 3))
    v[0] = rng.uniform(1.0, 3.5) * np.array([np.cos(angle), np.sin(angle)])
    w[0, :2] = rng.uniform(-0.6, 1.2) * np.array([-v[0, 1], v[0, 0]]) / RADIUS
    w[0, 2] = rng.uniform(-40, 40)
    return film(x, v, w, rng, mu_s=rng.uniform(0.16, 0.24), mu_r=rng.uniform(0.007, 0.014), **options)  # type: ignore[arg-type]


def match(
    fit: Fit, shot: Filmed, tolerance: float = 0.07
) -> tuple[list[float], list[tuple[float, str, str, str]], int]:
    """Time errors of the contacts found, the contacts missed, and how many were reported that never were."""
    events, used, errors, missed = fit.events, set(), [], []
    for t, kind, a, b in shot.contacts:
        options = [
            i for i in range(len(events))
            if i not in used and events.kind[i] == kind and abs(events.t[i] - t) < tolerance
            and ({events.a[i], events.b[i]} == {a, b} if kind == "ball" else (events.a[i], events.b[i]) == (a, b))
        ]  # fmt: skip
        if options:
            best = min(options, key=lambda i: abs(events.t[i] - t))
            used.add(best)
            errors.append(float(events.t[best] - t))
        else:
            missed.append((t, kind, a, b))
    reported = [i for i in range(len(events)) if events.kind[i] in ("ball", "cushion")]
    late = shot.tracks.t[-1] - 0.15
    extra = sum(i not in used and events.speed[i] > 0.05 and events.t[i] < late for i in reported)
    return errors, missed, extra


def position_rms_px(fit: Fit, shot: Filmed) -> float:
    """Per axis, of moving balls, against the truth without noise."""
    miss = (fit.trajectory.at(shot.tracks.t).xy - shot.xy)[fit.moving] * PX_PER_M
    return float(np.sqrt(np.nanmean(miss**2)))


def _contacts(log: np.ndarray, ids: tuple[str, ...], until: float) -> list[tuple[float, str, str, str]]:
    found = []
    for t, kind, ball, other, speed in log:
        if kind == 1:
            found.append((t + DELAY, "cushion", ids[int(ball)], SIDES[int(other)], speed))
        elif kind == 2:
            found.append((t + DELAY, "ball", ids[int(ball)], ids[int(other)], speed))
    return [event[:4] for event in found if event[4] > 0.03 and event[0] < until]
