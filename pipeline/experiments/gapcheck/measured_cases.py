"""Track folders and answers from public measurements whose missing effect is known.

Readers for six sets in a local folder (`--real DIR`): tosses of a cube that slides (DAIRLab/contact-nets),
shuttlecocks in flight (morishitamakoto0330/ShuttlecockSimulation), a single and a double pendulum
(dynamicslab/MultiArm-Pendulum), balls dropped from a bridge (briandesilva/discovery-of-physics-from-data).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from models.core.typing import FloatArray

Shot = tuple[NDArray[np.int64], FloatArray, FloatArray]
"""Frames (T,), times (T,) s, coordinates (T, D)."""

CUBE_HALF, CUBE_HZ = 0.0524, 148.0
"""Half of the edge, m; sampling rate, Hz."""
FLAT, CLIMBING, TURNING, MOVING = 0.002, 0.05, 1.0, 0.08
"""Limits where the cube slides: height m, vertical speed m/s, spin rad/s; it moves from the last one on, m/s."""
SHUTTLE_HZ, SHUTTLE_PX_PER_M = 60.0, 159.0
"""Frame rate, Hz; resolution, px/m."""
PENDULUM_EVERY, PENDULUM_SECONDS = 4, 2.5
"""Every so many of 200 samples per second are used; duration of a swing, s."""
MIN_FRAMES, MAX_SHOTS = 20, 24
"""Least number of frames of a shot; largest number of shots of a set."""


@dataclass(frozen=True, slots=True)
class MeasuredSet:
    """A set of shots, and the effects that a simulator without any effect may lack there."""

    name: str
    scene: str
    columns: tuple[str, ...]
    accepted: tuple[tuple[str, ...], ...]
    """Sets of effects that are a right answer; an empty one: nothing is named."""
    read: Callable[[Path], list[Shot]]
    facts: Mapping[str, object]


def _read_cube(folder: Path) -> list[Shot]:
    """Read the sliding part of each toss of a cube."""
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
            if len(longest) >= MIN_FRAMES:
                frames = np.arange(len(longest))
                shots.append((frames, frames / CUBE_HZ, toss[longest, :2].astype(np.float64)))
    return shots


def _read_shuttlecocks(folder: Path) -> list[Shot]:
    """Read the flights of shuttlecocks."""
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
        if len(rows) >= MIN_FRAMES:
            shots.append((frame[rows].astype(np.int64), frame[rows] / SHUTTLE_HZ, places))
    return shots


def _read_pendulum(folder: Path, file: str, columns: tuple[str, ...]) -> list[Shot]:
    """Read a recorded swing, split into shots."""
    with np.load(folder / "multiarm_pendulum" / file, allow_pickle=False) as swing:
        t = np.ravel(swing["t"])[::PENDULUM_EVERY]
        angles = np.stack([np.ravel(swing[name])[::PENDULUM_EVERY] for name in columns], axis=1) - np.pi
    long = round(PENDULUM_SECONDS / float(np.median(np.diff(t))))
    starts = range(0, len(t) - long, long)
    return [(np.arange(long), t[s : s + long] - t[s], angles[s : s + long]) for s in starts]


def _read_drops(folder: Path, wanted: Callable[[str], bool]) -> list[Shot]:
    """Read the drops of the balls whose name is `wanted`."""
    table = csv.read_csv(folder / "falling_balls" / "ball_drops.csv")
    ball = np.array([str(value) for value in table.column("ball").to_pylist()])
    drop, t, height = (table.column(name).to_numpy().astype(np.float64) for name in ("drop", "t", "h"))
    shots = []
    for name, number in sorted(set(zip(ball.tolist(), drop.tolist(), strict=True))):
        rows = np.flatnonzero((ball == name) & (drop == number))
        if wanted(name.lower()) and len(rows):
            shots.append((np.arange(len(rows)), t[rows], height[rows, None]))
    return shots


_DRAG = (("air_drag",), ("viscous_drag", "air_drag"))
_JOINT = (("joint_friction",), ("joint_friction", "gravity_tilt"))
MEASURED_SETS = (
    MeasuredSet(
        "sliding_cube", "slide", ("x", "y"), (("sliding_friction",), ("sliding_friction", "slope")), _read_cube, {}
    ),
    MeasuredSet("shuttlecock", "flight", ("x", "y"), _DRAG, _read_shuttlecocks, {}),
    MeasuredSet(
        "single_pendulum", "pendulum", ("theta1",), (*_JOINT, *((*names, "air_drag") for names in _JOINT)),
        lambda d: _read_pendulum(d, "single_freeswing_200Hz.npz", ("theta",)), {"units": "rad"},
    ),
    MeasuredSet(
        "double_pendulum", "pendulum", ("theta1", "theta2"), _JOINT,
        lambda d: _read_pendulum(d, "double_freeswing_200Hz.npz", ("theta1", "theta2")), {"units": "rad"},
    ),
    # a drag, of either law: v v is expected, yet v fits each of the eight drops twice as well
    MeasuredSet(
        "whiffle_balls", "flight", ("x",), (*_DRAG, ("viscous_drag",)),
        lambda d: _read_drops(d, lambda n: "whiffle" in n), {},
    ),
    MeasuredSet("bowling_ball", "flight", ("x",), ((),), lambda d: _read_drops(d, lambda n: "bowling" in n), {}),
)  # fmt: skip


def write_measured_sets(source: Path, folder: Path) -> dict[str, Any]:
    """Write the sets that a folder of public measurements holds as track folders.

    Args:
        source: Folder of the public measurements.
        folder: Folder of the track folders to write, one per set.

    Returns:
        The answers by name of the set, in the format of answers.json; sets that are not in `source` are left out.
    """
    answers = {}
    for measured in MEASURED_SETS:
        try:
            shots = measured.read(source)
        except FileNotFoundError:
            continue
        _write_measured_set(measured, shots, folder / measured.name)
        answers[measured.name] = {"accepted": [list(names) for names in measured.accepted]}
    return answers


def _write_measured_set(measured: MeasuredSet, shots: list[Shot], folder: Path) -> None:
    """Write the shots of a set, at most `MAX_SHOTS`, as a track folder."""
    shots = shots[:: -(-len(shots) // MAX_SHOTS)]
    count = np.array([len(frames) for frames, _, _ in shots])
    places = np.concatenate([coordinates for _, _, coordinates in shots])
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
