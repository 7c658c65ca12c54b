"""Two balls that meet, or just miss: truth of a world that shares no code with the library, and noisy tracks of it."""

from __future__ import annotations

import csv
import hashlib
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray

WORLD = Path(__file__).resolve().parent.parent / "worlds" / "billiards.py"
GRAVITY = 9.81
R, LENGTH, WIDTH = 0.028575, 2.54, 1.27
PX_PER_M = 350.0
HZ = 1000
TOLD_AT_ONCE = 50
"""Shots that one process of the world is told."""


@dataclass(frozen=True, slots=True)
class Meeting:
    """Two rolling or sliding balls at the moment that counts, as the truth is asked for."""

    x: FloatArray
    """(2, 2) m, centres."""
    v: FloatArray
    """(2, 2) m/s."""
    slip: FloatArray
    """(2, 2) m/s, velocity of the points that touch the cloth."""
    mu_s: float = 0.2
    mu_r: float = 0.01
    e: float = 0.95
    law: str = "alciatore"
    before: float = 0.45
    after: float = 0.45
    """s that the world runs before and after that moment."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What the world says: samples a millisecond apart, and the first contact of the two balls."""

    t: FloatArray
    """(T,) s."""
    xy: FloatArray
    """(T, 2, 2) m."""
    contact: float
    """s; NaN where the balls never touch."""
    speed: float
    """m/s along the line of centres at contact; NaN as well."""
    middle: float
    """s at which the meeting was asked for."""


def scene() -> Scene:
    """A 9 ft table without pockets from straight above, its calibration known to a tenth of a pixel."""
    table = Table("pool-9ft", "pool", LENGTH, WIDTH, R, 0.17, False)
    matrix = np.array([[PX_PER_M, 0, 0, 30], [0, PX_PER_M, 0, 30], [0, 0, 0, 1.0]])
    camera = Camera(matrix, 950, 505, table.corners * PX_PER_M + 30, 0.01 * np.eye(8), "cloth", 4.0, 0.3)
    return Scene(table, camera, np.array([40.0, -30.0, 10.0]), ())


def _earlier(meeting: Meeting, ball: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place, velocity and slip (2,) each, `before` s earlier on the path without a contact."""
    x, v, slip, time = meeting.x[ball], meeting.v[ball], meeting.slip[ball], meeting.before
    speed, sliding = float(np.hypot(*v)), float(np.hypot(*slip))
    if sliding > 1e-9:
        a = -meeting.mu_s * GRAVITY * slip / sliding
        return x - v * time + a * time**2 / 2, v - a * time, slip - 3.5 * a * time
    if speed < 1e-9:
        return x, v, slip
    a = -meeting.mu_r * GRAVITY * v / speed
    return x - v * time + a * time**2 / 2, v - a * time, slip


def shot_of(meeting: Meeting) -> dict[str, object]:
    """The shot file that leads to a meeting; balls `a` and `b`."""
    balls = []
    for ball, name in enumerate("ab"):
        x, v, slip = _earlier(meeting, ball)
        wx, wy = (slip[1] - v[1]) / R, (v[0] - slip[0]) / R
        balls.append({"id": name, "x": x[0], "y": x[1], "vx": v[0], "vy": v[1], "wx": wx, "wy": wy, "radius": R})
    effects = {
        "sliding_friction": {"mu": meeting.mu_s}, "rolling_resistance": {"mu": meeting.mu_r},
        "cushion_restitution": {"e": 0.8}, "cushion_friction": {"mu": 0.2}, "ball_restitution": {"e": meeting.e},
    }  # fmt: skip
    return {
        "scene": "billiards", "table": {"length": LENGTH, "width": WIDTH, "pockets": False}, "hz": HZ,
        "seconds": meeting.before + meeting.after, "balls": balls, "effects": effects,
        "laws": {"cushion": "mathavan_2010", "ball": meeting.law},
    }  # fmt: skip


def happened(meetings: Sequence[Meeting], folder: Path) -> list[Truth]:
    """The truth of every meeting, from `folder` or from the world, which runs as a process."""
    shots = [json.dumps(shot_of(meeting)) for meeting in meetings]
    places = [folder / hashlib.sha256(shot.encode()).hexdigest()[:16] for shot in shots]
    _play([(shot, out) for shot, out in zip(shots, places, strict=True) if not (out / "events.csv").is_file()])
    return [_told(out, meeting.before) for out, meeting in zip(places, meetings, strict=True)]


def _play(wanted: Sequence[tuple[str, Path]]) -> None:
    """Let the world write every shot's folder, many shots by a process: it takes longer to start than to run."""
    for first in range(0, len(wanted), TOLD_AT_ONCE):
        words = [sys.executable, str(WORLD)]
        for shot, out in wanted[first : first + TOLD_AT_ONCE]:
            out.mkdir(parents=True, exist_ok=True)
            (out / "shot.json").write_text(shot)
            words += [str(out / "shot.json"), str(out)]
        subprocess.run(words, check=True)


def _told(out: Path, middle: float) -> Truth:
    """What the world wrote into a folder."""
    rows = np.genfromtxt(out / "trajectory.csv", delimiter=",", skip_header=1, usecols=(0, 2, 3))
    with (out / "events.csv").open() as file:
        contacts = [row for row in csv.DictReader(file) if row["kind"] == "ball"]
    t, speed = (float(contacts[0]["t"]), float(contacts[0]["speed"])) if contacts else (np.nan, np.nan)
    return Truth(rows[::2, 0], rows[:, 1:].reshape(-1, 2, 2), t, speed, middle)


def film(
    truth: Truth, fps: float, rng: np.random.Generator, half: float = 0.3, noise: float = 1e-3, ar: float = 0.0
) -> Tracks:
    """Pictures within `half` s of the moment that counts, at a random phase; noise (m) of autocorrelation `ar`."""
    middle = truth.contact if np.isfinite(truth.contact) else truth.middle
    first = middle - half + rng.uniform(0, 1 / fps)
    wanted = first + np.arange(int((middle + half - first) * fps) + 1) / fps
    rows = np.unique(np.clip(np.round(wanted * HZ).astype(int), 0, len(truth.t) - 1))
    error = rng.normal(size=(len(rows), 2, 2))
    for k in range(1, len(rows)):
        error[k] = ar * error[k - 1] + np.sqrt(1 - ar**2) * error[k]
    xy, shape = truth.xy[rows] + noise * error, (len(rows), 2)
    sigma = np.full(shape, noise)
    return Tracks(
        np.arange(len(rows)), truth.t[rows], ("a", "b"), ("cue", "solid"), xy, xy * PX_PER_M + 30, sigma, sigma.copy(),
        np.zeros((*shape, 2)), np.full(shape, R * PX_PER_M), np.zeros((2, 3)),
    )  # fmt: skip
