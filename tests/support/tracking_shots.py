"""Shots of a world of small fixed steps, and how a camera above would detect them: truth for association."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from support import fixed_step_table

from models.core.detections import Detections
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray

R = 0.028575
POOL = Table("pool-9ft", "pool", 2.54, 1.27, R, 0.17, pockets=True)
HZ = 1000
EXPOSURE = 0.3
"""of the picture interval"""


@dataclass(frozen=True, slots=True)
class Seen:
    """Detections of a shot, with which ball (K,) each is (-1: clutter) and where all were (T, N, 2) px."""

    detections: Detections
    frame: NDArray[np.int64]
    t: FloatArray
    ball: NDArray[np.int64]
    px: FloatArray


def overhead(table: Table = POOL, px_per_m: float = 400.0, height: float = 4.0) -> Scene:
    """A camera straight above the middle of the table."""
    width, tall = round(table.length * px_per_m) + 200, round(table.width * px_per_m) + 200
    f, x, y = px_per_m * height, table.length / 2, table.width / 2
    matrix = np.array([
        [f, 0.0, -width / 2, -f * x + width / 2 * height],
        [0.0, f, -tall / 2, -f * y + tall / 2 * height],
        [0.0, 0.0, -1.0, height],
    ])  # fmt: skip
    corners = (table.corners - [x, y]) * px_per_m + [width / 2, tall / 2]
    camera = Camera(matrix, width, tall, corners, 0.25 * np.eye(8), "cloth", height, 0.3)
    return Scene(table, camera, np.array([40.0, -30.0, 10.0]), ())


def play(cue: FloatArray, velocity: FloatArray, others: FloatArray, seconds: float, table: Table = POOL) -> FloatArray:
    """Samples (S, N, 5) at `PATH_RATE` of x, y, vx, vy and whether the ball is on the table, the cue ball first."""
    x = np.concatenate([cue[None], others])
    v = np.zeros_like(x)
    v[0] = velocity
    pocket = 0.055 if table.pockets else 0.0
    _, path, _ = fixed_step_table.play(
        x, v, np.zeros((len(x), 3)), seconds=seconds, fps=HZ, radius=R, length=table.length, width=table.width,
        law=fixed_step_table.GRIPPING, pocket=pocket,
    )  # fmt: skip
    moved = np.diff(path, axis=0, append=path[-1:]) * HZ
    moved[np.abs(moved) > 20] = 0.0  # a ball that left is put aside
    gone = np.hypot(*np.moveaxis(path[:, :, None] - table.pocket_centres, 3, 0)).min(axis=2, initial=np.inf) < pocket
    gone |= ~np.isfinite(path).all(axis=2)
    on_table = ~np.logical_or.accumulate(gone, axis=0)
    return np.concatenate([path, moved, on_table[..., None]], axis=2)


def break_shot(
    balls: int, rng: np.random.Generator, speed: float = 7.0, gap: float = 2e-4
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Cue ball, its velocity, and a rack of the others that all but touch."""
    rows = [(row, j - row / 2) for row in range(balls) for j in range(row + 1)][: balls - 1]
    pitch = 2 * R + gap
    rack = np.array([[1.85 + row * pitch * np.sqrt(0.75), 0.635 + j * pitch] for row, j in rows])
    rack += rng.normal(0, gap / 4, rack.shape)
    cue = np.array([0.635 + rng.uniform(-0.1, 0.1), 0.635 + rng.uniform(-0.2, 0.2)])
    aim = rack[0] + [0.0, rng.uniform(-0.02, 0.02)] - cue
    return cue, aim / np.hypot(*aim) * speed, rack


def scattered(balls: int, rng: np.random.Generator, speed: float = 4.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Cue ball, its velocity towards one of the others, and the others, anywhere."""
    places: list[FloatArray] = []
    while len(places) < balls:
        place = rng.uniform([3 * R, 3 * R], [POOL.length - 3 * R, POOL.width - 3 * R])
        if all(np.hypot(*(place - other)) > 2.2 * R for other in places):
            places.append(place)
    aim = places[int(rng.integers(1, balls))] + rng.normal(0, 0.01, 2) - places[0]
    return places[0], aim / np.hypot(*aim) * speed, np.array(places[1:])


def observe(
    samples: FloatArray, scene: Scene, fps: float, rng: np.random.Generator,
    noise: float = 0.5, miss: float = 0.05, clutter: float = 1.0, rest: float = 0.4, colours: FloatArray | None = None,
) -> Seen:  # fmt: skip
    """Detect a shot after `rest` seconds of stillness: noise in px, a share missed, false ones per picture."""
    still = round(rest * fps)
    step = np.round((np.arange(int((len(samples) - 1) / HZ * fps) - 1) / fps + rng.uniform(0, 1 / fps)) * HZ).astype(
        int
    )
    seen = np.concatenate([np.repeat(samples[:1], still, axis=0), samples[step]])
    seen[:still, :, 2:4] = 0.0
    px = scene.camera.to_pixels(seen[..., :2], R)
    way = scene.camera.to_pixels(seen[..., :2] + seen[..., 2:4] * EXPOSURE / fps, R) - px
    colours = np.tile([60.0, 0.0, 10.0], (px.shape[1], 1)) if colours is None else colours
    rows = []
    for k, i in np.argwhere((seen[..., 4] > 0) & (rng.random(px.shape[:2]) > miss)):
        length = float(np.hypot(*way[k, i]))
        streak = way[k, i] * rng.choice([-1, 1]) if length > 3 else np.zeros(2)
        along = noise + 0.1 * np.hypot(*streak)
        ahead = streak / max(length, 1e-9)
        off = rng.normal(0, noise, 2)
        off += ahead * (rng.normal(0, along) - off @ ahead) if length > 3 else 0.0
        rows.append((k, i, *(px[k, i] + off), *streak, *(colours[i] + rng.normal(0, 3, 3)), noise, along))
    for k in np.repeat(np.arange(len(px)), rng.poisson(clutter, len(px))):
        place = rng.uniform(0, [scene.camera.width_px, scene.camera.height_px])
        rows.append((k, -1, *place, 0.0, 0.0, *(colours[0] + rng.normal(0, 15, 3)), noise, noise))
    table = np.array(sorted(rows))
    count = np.ones(len(table))
    detections = Detections(
        table[:, 0].astype(np.int64), table[:, 2:4], R * 400 * count, table[:, 4:6], table[:, 6:9],
        0.1 * count, 0.1 * count, 0.5 * count, count, table[:, 9], table[:, 10],
    )  # fmt: skip
    frame = np.arange(len(px))
    return Seen(detections, frame, frame / fps, table[:, 1].astype(np.int64), px)


def owners(tracks: Tracks, px: FloatArray) -> NDArray[np.int64]:
    """Which true ball (T, N tracks) each sighting of a track is: -1 not seen, -2 no ball within 8 px."""
    result = np.full(tracks.is_observed.shape, -1)
    for k, j in np.argwhere(tracks.is_observed):
        gap = np.nan_to_num(np.hypot(*(px[k] - tracks.px[k, j]).T), nan=np.inf)
        result[k, j] = int(np.argmin(gap)) if gap.min() < 8 else -2
    return result


def switches(tracks: Tracks, px: FloatArray) -> int:
    """How often a track changes from one true ball to another; two balls exchanged count twice."""
    total = 0
    for column in owners(tracks, px).T:
        column = column[column >= 0]
        total += int(np.sum(np.diff(column) != 0))
    return total
