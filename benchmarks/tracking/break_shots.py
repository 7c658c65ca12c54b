"""Breaks of sixteen equal balls: truth from an independent simulator, and simulated detections of a camera."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.csv
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.scene import Camera, Scene, Table
from models.core.typing import FloatArray, IntArray

WORLD = Path(__file__).resolve().parents[2] / "worlds" / "billiards.py"
R, LENGTH, WIDTH, BALLS = 0.028575, 2.54, 1.27, 16
# A 9 ft table fills the width of a 720p frame: a pixel is 2 mm.
PX_PER_M = 500.0
# Seconds filmed before the strike, and pixels around the table.
REST, MARGIN = 0.4, 5
HZ = 1000


@dataclass(frozen=True, slots=True)
class Break:
    """True motion: T samples a millisecond apart of N balls, and E contacts."""

    xy: FloatArray
    """(T, N, 2) m."""
    v: FloatArray
    """(T, N, 2) m/s."""
    slip: FloatArray
    """(T, N, 2) m/s of the point in contact with the cloth."""
    on_table: NDArray[np.bool_]
    """(T, N) not fallen into a pocket."""
    kind: NDArray[np.str_]
    """(E,) ball or cushion; t (E,) s, a (E,) ball, b (E,) ball or cushion by name, speed (E,) m/s."""
    t: FloatArray
    a: NDArray[np.str_]
    b: NDArray[np.str_]
    speed: FloatArray


@dataclass(frozen=True, slots=True)
class FilmedBreak:
    """Detections without identities in the frames `frame` (T,) at `t` (T,) s of the clip."""

    detections: Detections
    frame: IntArray
    t: FloatArray
    ball: IntArray
    """(K,) true ball of each detection, not available to the trackers."""
    xy: FloatArray
    """(T, N, 2) m without noise; NaN once potted."""
    strike: float
    """Start of the simulation, s of the clip."""


def overhead_scene(pockets: bool) -> Scene:
    """Return a 9 ft table seen by a camera 4 m straight above it."""
    table = Table("pool-9ft", "pool", LENGTH, WIDTH, R, 0.17, pockets)
    height, x, y = 4.0, LENGTH / 2, WIDTH / 2
    wide, tall = round(LENGTH * PX_PER_M) + 2 * MARGIN, 720
    f = PX_PER_M * height
    rows = [
        [f, 0.0, -wide / 2, height * wide / 2 - f * x],
        [0.0, f, -tall / 2, height * tall / 2 - f * y],
        [0.0, 0.0, -1.0, height],
    ]
    corners = (table.corners - [x, y]) * PX_PER_M + [wide / 2, tall / 2]
    camera = Camera(np.array(rows), wide, tall, corners, 0.25 * np.eye(8), "cloth", height, 0.3)
    return Scene(table, camera, np.array([40.0, -30.0, 10.0]), ())


def draw_shot(seed: int, pockets: bool, seconds: float) -> dict[str, object]:
    """Draw a cue ball at 4 to 8 m/s and an irregular triangle with mean gaps of 0.1 to 1 mm."""
    rng = np.random.default_rng(seed)
    gap = rng.uniform(1e-4, 1e-3)
    pitch = 2 * R + gap
    rack = [(1.85 + row * pitch * np.sqrt(0.75), WIDTH / 2 + (j - row / 2) * pitch) for row in range(5)
            for j in range(row + 1)]  # fmt: skip
    places = np.array(rack) + rng.uniform(-gap / 2, gap / 2, (15, 2))
    cue = np.array([0.635 + rng.uniform(-0.1, 0.1), WIDTH / 2 + rng.uniform(-0.2, 0.2)])
    aim = places[0] + [0.0, rng.uniform(-0.6, 0.6) * R] - cue
    v = rng.uniform(4.0, 8.0) * aim / np.hypot(*aim)
    roll = rng.uniform(0.0, 1.0)
    spin = {"wx": -roll * v[1] / R, "wy": roll * v[0] / R, "wz": rng.uniform(-20.0, 20.0)}
    balls = [{"id": "0", "x": cue[0], "y": cue[1], "vx": v[0], "vy": v[1], **spin, "radius": R}]
    balls += [{"id": str(k + 1), "x": x, "y": y, "radius": R} for k, (x, y) in enumerate(places)]
    effects = {
        "sliding_friction": {"mu": rng.uniform(0.16, 0.24)},
        "rolling_resistance": {"mu": rng.uniform(0.007, 0.013)},
        "spin_decay": {"rate": 10.0},
        "cushion_restitution": {"e": rng.uniform(0.8, 0.9)},
        "cushion_friction": {"mu": 0.2},
        "ball_restitution": {"e": rng.uniform(0.93, 0.97)},
    }
    table = {"length": LENGTH, "width": WIDTH, "pockets": pockets}
    laws = {"cushion": "mathavan_2010", "ball": "alciatore"}
    return {"scene": "billiards", "table": table, "seconds": seconds, "hz": HZ, "balls": balls, "effects": effects,
            "laws": laws}  # fmt: skip


def simulate_break(seed: int, folder: Path, pockets: bool = False, seconds: float = 4.0) -> Break:
    """Return the break of a seed, from `folder` or from the simulator, which runs as a process."""
    out = folder / f"break_{seed}_{'pockets' if pockets else 'rails'}_{seconds:g}"
    if not (out / "events.csv").is_file():
        out.mkdir(parents=True, exist_ok=True)
        (out / "shot.json").write_text(json.dumps(draw_shot(seed, pockets, seconds)))
        subprocess.run([sys.executable, str(WORLD), str(out / "shot.json"), str(out)], check=True)
    return read_break(out)


def read_break(out: Path) -> Break:
    """Read the files of the simulator."""
    rows = pyarrow.csv.read_csv(out / "trajectory.csv")
    x, y, z, vx, vy, wx, wy = (
        rows[name].to_numpy().reshape(-1, BALLS) for name in ("x", "y", "z", "vx", "vy", "wx", "wy")
    )
    events = pyarrow.csv.read_csv(
        out / "events.csv",
        convert_options=pyarrow.csv.ConvertOptions(column_types={"a": pyarrow.string(), "b": pyarrow.string()}),
    )
    kind = np.array(events["kind"].to_pylist())
    chosen = np.isin(kind, ("ball", "cushion"))
    a, b = (np.array(events[name].to_pylist()) for name in "ab")
    t, speed = (events[name].to_numpy() for name in ("t", "speed"))
    on_table = z > 0.9 * R
    return Break(
        np.stack([x, y], axis=2), np.stack([vx, vy], axis=2), np.stack([vx - R * wy, vy + R * wx], axis=2), on_table,
        kind[chosen], t[chosen], a[chosen], b[chosen], speed[chosen],
    )  # fmt: skip


def film_break(
    shown: Break, fps: float, seed: int, pockets: bool, noise_px: float = 1.0, missed: float = 0.05
) -> FilmedBreak:
    """Simulate detections of a break: equal colours, Gaussian noise per axis, a share of missed detections."""
    rng = np.random.default_rng([seed, round(fps)])
    seconds = REST + len(shown.xy) / HZ
    t = np.round((np.arange(int(seconds * fps) - 1) / fps + rng.uniform(0, 1 / fps)) * HZ) / HZ
    sample = np.clip(np.round((t - REST) * HZ).astype(int), 0, None)
    xy = np.where(shown.on_table[sample][..., None], shown.xy[sample], np.nan)
    frame, ball = np.nonzero(np.isfinite(xy[..., 0]) & (rng.random(xy.shape[:2]) > missed))
    count = len(frame)
    order = np.lexsort((rng.random(count), frame))  # a random order within a frame
    frame, ball = frame[order], ball[order]
    px = overhead_scene(pockets).camera.to_pixels(xy[frame, ball], R) + rng.normal(0, noise_px, (count, 2))
    one, sharp = np.ones(count), np.zeros((count, 2))
    colour = np.array([60.0, 0.0, 10.0]) + rng.normal(0, 3, (count, 3))
    sigma = noise_px * one
    coat = (colour, 0.1 * one, 0.1 * one, 0.5 * one)
    detections = Detections(frame, px, R * PX_PER_M * one, sharp, *coat, one, sigma, sigma)
    return FilmedBreak(detections, np.arange(len(t)), t, ball, xy, REST)
