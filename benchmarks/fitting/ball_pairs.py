"""Two balls that collide or narrowly miss: truth from an independent simulator, and noisy tracks of it."""

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

WORLD = Path(__file__).resolve().parents[2] / "worlds" / "billiards.py"
GRAVITY = 9.81
R, LENGTH, WIDTH = 0.028575, 2.54, 1.27
PX_PER_M = 350.0
HZ = 1000
# Shots that one process of the simulator plays.
SHOTS_PER_PROCESS = 50


@dataclass(frozen=True, slots=True)
class Meeting:
    """Requested state of two rolling or sliding balls at the moment of contact or closest approach."""

    x: FloatArray
    """(2, 2) m, centres."""
    v: FloatArray
    """(2, 2) m/s."""
    slip: FloatArray
    """(2, 2) m/s, velocity of the points in contact with the cloth."""
    mu_s: float = 0.2
    mu_r: float = 0.01
    e: float = 0.95
    law: str = "alciatore"
    before: float = 0.45
    after: float = 0.45
    """Seconds that are simulated before and after that moment."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Output of the simulator: samples a millisecond apart, and the first contact of the two balls."""

    t: FloatArray
    """(T,) s."""
    xy: FloatArray
    """(T, 2, 2) m."""
    contact: float
    """s; NaN where the balls never touch."""
    speed: float
    """m/s along the line of centres at contact; NaN without one."""
    middle: float
    """s, the requested moment of the meeting."""


def overhead_scene() -> Scene:
    """Return a 9 ft table without pockets, seen from straight above with a calibration error of 0.1 px."""
    table = Table("pool-9ft", "pool", LENGTH, WIDTH, R, 0.17, False)
    matrix = np.array([[PX_PER_M, 0, 0, 30], [0, PX_PER_M, 0, 30], [0, 0, 0, 1.0]])
    camera = Camera(matrix, 950, 505, table.corners * PX_PER_M + 30, 0.01 * np.eye(8), "cloth", 4.0, 0.3)
    return Scene(table, camera, np.array([40.0, -30.0, 10.0]), ())


def _state_before(meeting: Meeting, ball: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, velocity and slip (2,) each, `before` s earlier on the contact-free path."""
    x, v, slip, time = meeting.x[ball], meeting.v[ball], meeting.slip[ball], meeting.before
    speed, sliding = float(np.hypot(*v)), float(np.hypot(*slip))
    if sliding > 1e-9:
        a = -meeting.mu_s * GRAVITY * slip / sliding
        return x - v * time + a * time**2 / 2, v - a * time, slip - 3.5 * a * time
    if speed < 1e-9:
        return x, v, slip
    a = -meeting.mu_r * GRAVITY * v / speed
    return x - v * time + a * time**2 / 2, v - a * time, slip


def describe_shot(meeting: Meeting) -> dict[str, object]:
    """Describe the shot that leads to a meeting of balls `a` and `b`, as the simulator reads it."""
    balls = []
    for ball, name in enumerate("ab"):
        x, v, slip = _state_before(meeting, ball)
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


def simulate_meetings(meetings: Sequence[Meeting], folder: Path) -> list[Truth]:
    """Return the truth of every meeting, from `folder` or from the simulator, which runs as a process."""
    shots = [json.dumps(describe_shot(meeting)) for meeting in meetings]
    places = [folder / hashlib.sha256(shot.encode()).hexdigest()[:16] for shot in shots]
    _run_world([(shot, out) for shot, out in zip(shots, places, strict=True) if not (out / "events.csv").is_file()])
    return [_read_truth(out, meeting.before) for out, meeting in zip(places, meetings, strict=True)]


def _run_world(wanted: Sequence[tuple[str, Path]]) -> None:
    """Let the simulator write the folder of every shot, many shots per process, since starting takes longest."""
    for first in range(0, len(wanted), SHOTS_PER_PROCESS):
        words = [sys.executable, str(WORLD)]
        for shot, out in wanted[first : first + SHOTS_PER_PROCESS]:
            out.mkdir(parents=True, exist_ok=True)
            (out / "shot.json").write_text(shot)
            words += [str(out / "shot.json"), str(out)]
        subprocess.run(words, check=True)


def _read_truth(out: Path, middle: float) -> Truth:
    """Read what the simulator wrote into a folder."""
    rows = np.genfromtxt(out / "trajectory.csv", delimiter=",", skip_header=1, usecols=(0, 2, 3))
    with (out / "events.csv").open() as file:
        contacts = [row for row in csv.DictReader(file) if row["kind"] == "ball"]
    t, speed = (float(contacts[0]["t"]), float(contacts[0]["speed"])) if contacts else (np.nan, np.nan)
    return Truth(rows[::2, 0], rows[:, 1:].reshape(-1, 2, 2), t, speed, middle)


def film_pair(
    truth: Truth, fps: float, rng: np.random.Generator, half: float = 0.3, noise: float = 1e-3, ar: float = 0.0
) -> Tracks:
    """Sample noisy tracks within `half` s of the contact, at a random phase; `noise` in m with autocorrelation `ar`."""
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
