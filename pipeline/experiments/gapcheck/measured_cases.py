"""Track folders from measurements of which the missing effect is known from outside.

Small readers for five public sets in a folder that lies on the machine (`--real DIR`): tosses of a cube that slides
(DAIRLab/contact-nets), shuttlecocks in flight (morishitamakoto0330/ShuttlecockSimulation), a single and a double
pendulum (dynamicslab/MultiArm-Pendulum), balls dropped from a bridge
(briandesilva/discovery-of-physics-from-data).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from models.core.typing import FloatArray

Shot = tuple[NDArray[np.int64], FloatArray, FloatArray]
"""Frames (T,), times (T,) s, coordinates (T, D)."""

CUBE_HALF, CUBE_HZ = 0.0524, 148.0
"""m, 1/s."""
FLAT, CLIMBING, TURNING, MOVING = 0.002, 0.05, 1.0, 0.08
"""m, m/s, rad/s, m/s: the cube lies flat, neither climbs nor turns, and moves."""
SHUTTLE_HZ, SHUTTLE_PX_PER_M = 60.0, 159.0
PENDULUM_EVERY, PENDULUM_SECONDS = 4, 2.5
"""Every so manieth picture of 200 a second, in swings of so many seconds."""
FEWEST, MOST = 20, 24
"""Pictures of a shot, at least, and shots of a set, at most."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A set of shots, and what a simulator without anything lacks there."""

    name: str
    scene: str
    columns: tuple[str, ...]
    missing: tuple[str, ...]
    """any of these is a right name; empty: nothing may be named."""
    read: Callable[[Path], list[Shot]]
    facts: Mapping[str, object]


def _cube(folder: Path) -> list[Shot]:
    shots = []
    with np.load(folder / "contactnets_cube" / "cube_tosses_SI_64.npz", allow_pickle=False) as tosses:
        for name in tosses.files:
            toss = tosses[name]
            if toss.ndim != 2:
                continue
            sliding = (np.abs(toss[:, 2] - CUBE_HALF) < FLAT) & (np.abs(toss[:, 9]) < CLIMBING)
            sliding &= (np.linalg.norm(toss[:, 10:13], axis=1) < TURNING) & (np.hypot(toss[:, 7], toss[:, 8]) > MOVING)
            rows = np.flatnonzero(sliding)
            runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
            longest = max(runs, key=len)
            if len(longest) >= FEWEST:
                frames = np.arange(len(longest))
                shots.append((frames, frames / CUBE_HZ, toss[longest, :2].astype(np.float64)))
    return shots


def _shuttle(folder: Path) -> list[Shot]:
    table = csv.read_csv(folder / "badminton_morishita" / "shuttle_tracks_px.csv")
    session = np.array([str(value) for value in table.column("session").to_pylist()])
    shot, frame, x, y = (table.column(name).to_numpy().astype(np.float64) for name in ("shot", "frame", "x_px", "y_px"))
    shots = []
    for one, number in sorted(set(zip(session.tolist(), shot.tolist(), strict=True))):
        rows = np.flatnonzero((session == one) & (shot == number))
        rows = rows[np.diff(frame[rows], prepend=-1) > 0]
        places = np.stack([x[rows], -y[rows]], axis=1) / SHUTTLE_PX_PER_M
        if places[-1, 0] < places[0, 0]:
            places[:, 0] *= -1
        if len(rows) >= FEWEST:
            shots.append((frame[rows].astype(np.int64), frame[rows] / SHUTTLE_HZ, places))
    return shots


def _pendulum(folder: Path, file: str, columns: tuple[str, ...]) -> list[Shot]:
    with np.load(folder / "multiarm_pendulum" / file, allow_pickle=False) as swing:
        t = np.ravel(swing["t"])[::PENDULUM_EVERY]
        angles = np.stack([np.ravel(swing[name])[::PENDULUM_EVERY] for name in columns], axis=1) - np.pi
    long = round(PENDULUM_SECONDS / float(np.median(np.diff(t))))
    starts = range(0, len(t) - long, long)
    return [(np.arange(long), t[s : s + long] - t[s], angles[s : s + long]) for s in starts]


def _drops(folder: Path, wanted: Callable[[str], bool]) -> list[Shot]:
    table = csv.read_csv(folder / "falling_balls" / "ball_drops.csv")
    ball = np.array([str(value) for value in table.column("ball").to_pylist()])
    drop, t, height = (table.column(name).to_numpy().astype(np.float64) for name in ("drop", "t", "h"))
    shots = []
    for name, number in sorted(set(zip(ball.tolist(), drop.tolist(), strict=True))):
        rows = np.flatnonzero((ball == name) & (drop == number))
        if wanted(name.lower()) and len(rows):
            shots.append((np.arange(len(rows)), t[rows], height[rows, None]))
    return shots


SETS = (
    Measured("sliding cube", "slide", ("x", "y"), ("sliding_friction",), _cube, {}),
    Measured("shuttlecock", "flight", ("x", "y"), ("air_drag",), _shuttle, {}),
    Measured(
        "single pendulum", "pendulum", ("theta1",), ("joint_friction",),
        lambda d: _pendulum(d, "single_freeswing_200Hz.npz", ("theta",)), {"units": "rad"},
    ),
    Measured(
        "double pendulum", "pendulum", ("theta1", "theta2"), ("joint_friction",),
        lambda d: _pendulum(d, "double_freeswing_200Hz.npz", ("theta1", "theta2")), {"units": "rad"},
    ),
    # a drag for sure; which law is not: v v is expected, yet v fits each of the eight drops twice as well
    Measured(
        "whiffle balls", "flight", ("x",), ("air_drag", "viscous_drag"),
        lambda d: _drops(d, lambda n: "whiffle" in n), {},
    ),
    Measured("bowling ball", "flight", ("x",), (), lambda d: _drops(d, lambda n: "bowling" in n), {}),
)  # fmt: skip


def write_measured(measured: Measured, source: Path, folder: Path) -> int:
    """Write a set as a track folder; how many shots. FileNotFoundError where the set is not in `source`."""
    shots = measured.read(source)
    shots = shots[:: -(-len(shots) // MOST)]
    count = np.array([len(frames) for frames, _, _ in shots])
    places = np.concatenate([found for _, _, found in shots])
    columns: dict[str, object] = {
        "shot": np.repeat(np.arange(len(shots)), count),
        "frame": np.concatenate([frames for frames, _, _ in shots]),
        "t": np.concatenate([t for _, t, _ in shots]),
        "id": ["body"] * int(count.sum()),
        **{name: places[:, k] for k, name in enumerate(measured.columns)},
    }
    folder.mkdir(parents=True, exist_ok=True)
    csv.write_csv(pa.table(columns), folder / "tracks.csv")
    facts = {"scene": measured.scene, "units": "m", "model": [], **measured.facts}
    (folder / "scene.json").write_text(json.dumps(facts), encoding="utf-8")
    return len(shots)
