"""Render short clips of varied tables, views, sets of balls and shots.

    python -m benchmarks.clips.varied_clips OUT [--clips 40] [--seed 1] [--only 7] [--frames 14]

Clip K of a seed is always the same: the world of the sample clips simulates a random shot, the renderer films it from
above, from an end, from a side or across a corner. The truth is written beside each clip, as for the sample clips.
`--frames` ends the clips early: what is found before anything is fitted needs only the strike.
"""

from __future__ import annotations

import argparse
import colorsys
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.support.run_folder import ROOT
from models.core.scene import Camera, Table
from models.core.typing import FloatArray
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import ClothMarks, SceneAppearance, carom_ball

sys.path.insert(0, str(ROOT / "sample_videos"))
import make
import shots

TABLES = (shots.POOL_9FT, shots.POOL_8FT, shots.POOL_7FT, shots.CAROM, shots.SNOOKER)
# px, of films held level, and of a phone held upright, from above or from an end.
SIZES, UPRIGHT_SIZE = ((640, 360), (640, 480), (960, 540)), (640, 800)
VIEWS = ("above", "end", "side", "corner")
# Width of the rail, m, and the share of the image that table and rails fill.
RAIL_M, FILLED = 0.16, 0.92
MARKS: dict[str, ClothMarks] = {"pool": "pool", "snooker": "snooker", "carom": "carom"}
CLOTH_HUES = (0.36, 0.42, 0.55, 0.60, 0.98)
LEAST_APART_M = 0.09


def draw_clip(seed: int, number: int) -> shots.Sample:
    """Draw clip `number` of a seed; the number decides on the table, and with it on the view and the size."""
    rng = np.random.default_rng([seed, number])
    table, view = TABLES[number % len(TABLES)], VIEWS[number % len(VIEWS)]
    upright = view in ("above", "end") and rng.random() < 0.25
    camera = draw_camera(table, view, UPRIGHT_SIZE if upright else SIZES[int(rng.integers(len(SIZES)))], rng)
    balls = draw_balls(table, rng)
    aim = np.array([balls[1].x - balls[0].x, balls[1].y - balls[0].y])
    if rng.random() < 0.25:  # at a cushion first
        aim = rng.normal(size=2)
    off_centre = rng.uniform(-2.0, 2.0) * table.ball_radius / float(np.hypot(*aim))
    angle, speed = float(np.arctan2(aim[1], aim[0])) + off_centre, float(rng.uniform(1.5, 4.0))
    velocity = (speed * float(np.cos(angle)), speed * float(np.sin(angle)))
    roll, side = rng.uniform(-0.3, 1.0) / table.ball_radius, float(rng.uniform(-0.5, 0.5)) * speed / table.ball_radius
    rate = Fraction((25, 30)[int(rng.integers(2))])
    return shots.Sample(
        f"varied_{number:02}", f"{table.name} from {view}, {len(balls)} balls", table, camera,
        draw_appearance(table, rng), balls, velocity, (-roll * velocity[1], roll * velocity[0], side),
        bool(rng.integers(2)), rate, float(rng.uniform(2.0, 2.5)), strike_at=0.3, exposure=1 / (5 * float(rate)),
        player=view == "above" and bool(rng.integers(2)), k1=0.001, seed=1000 * seed + number,
    )  # fmt: skip


def draw_camera(
    table: Table, view: str, size: tuple[int, int], rng: np.random.Generator, rail: float = RAIL_M
) -> Camera:
    """Draw a camera whose image holds the whole table with `rail` m of its rails."""
    middle = np.array([table.length / 2, table.width / 2, 0.0])
    if view == "above":
        up = (-1.0, 0.0, 0.0) if size[1] > size[0] else (0.0, -1.0 if rng.random() < 0.5 else 1.0, 0.0)
        away = np.append(rng.normal(0, 0.03, 2), 1.0)
    else:
        up = (0.0, 0.0, 1.0)
        azimuth = {"end": 0.0, "side": np.pi / 2, "corner": 0.65}[view] + float(rng.choice([0.0, np.pi]))
        elevation = float(rng.uniform(0.5, 0.9))
        across = np.array([np.cos(azimuth + rng.normal(0, 0.06)), np.sin(azimuth), 0.0])
        away = np.append(np.cos(elevation) * across[:2], np.sin(elevation))
    eye, target, focal = middle + 1.5 * table.length * away / np.linalg.norm(away), middle, 1000.0
    for _ in range(12):  # aim at the middle of what the image shows of the table, and zoom to it
        corners = project_outline(table, look_at(table, eye, target, focal, *size, up=up), rail)
        low, high = corners.min(axis=0), corners.max(axis=0)
        focal *= FILLED * float(np.min(np.array(size) / (high - low)))
        target = np.append(look_at(table, eye, target, focal, *size, up=up).to_table((low + high) / 2, 0.0), 0.0)
    return look_at(table, eye, target, focal, *size, up=up)


def project_outline(table: Table, camera: Camera, rail: float) -> FloatArray:
    """Project the corners (4, 2) px of a rectangle `rail` m outside of the noses."""
    middle = table.corners.mean(axis=0)
    return camera.to_pixels(table.corners + rail * np.sign(table.corners - middle), 0.0)


def draw_balls(table: Table, rng: np.random.Generator) -> tuple[shots.Ball, ...]:
    """Draw a set of balls of the table's game and their places; the first one is struck."""
    if table.game == "carom":
        places = draw_places(table, 3, rng)
        kinds = ("white", "yellow", "red")
        return tuple(shots.Ball(k, carom_ball(k), x, y) for k, (x, y) in zip(kinds, places, strict=True))
    if table.game == "snooker":
        colours = rng.permutation(["yellow", "green", "brown", "blue", "pink", "black"])[: int(rng.integers(2, 7))]
        kinds = ("cue", *["red"] * int(rng.integers(1, 6)), *colours.tolist())
        places = draw_places(table, len(kinds), rng)
        return shots.snooker_balls(*((k, x, y) for k, (x, y) in zip(kinds, places, strict=True)))
    numbers = (0, *rng.permutation(np.arange(1, 16))[: int(rng.integers(2, 10))].tolist())
    places = draw_places(table, len(numbers), rng)
    return shots.pool_balls(*((n, x, y) for n, (x, y) in zip(numbers, places, strict=True)))


def draw_places(table: Table, count: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Draw places of balls apart from each other and from the cushions, m."""
    while True:
        xy = rng.uniform(0.09, np.array([table.length, table.width]) - 0.09, (count, 2))
        apart = np.linalg.norm(xy[:, None] - xy, axis=-1) + 9 * np.eye(count)
        if apart.min() > LEAST_APART_M and (count == 1 or apart[0, 1] > 0.3):
            return [(float(x), float(y)) for x, y in xy]


def draw_appearance(table: Table, rng: np.random.Generator) -> SceneAppearance:
    """Draw cloth, rail, floor, marks and lamps."""
    hue = float(rng.choice(CLOTH_HUES)) + float(rng.normal(0, 0.01))
    lamps = shots.make_lamp_row(table, int(rng.integers(2, 5)), float(rng.uniform(1.1, 1.6)), 0.15)
    return SceneAppearance(
        cloth=colorsys.hsv_to_rgb(hue % 1.0, float(rng.uniform(0.6, 0.85)), float(rng.uniform(0.45, 0.75))),
        rail=colorsys.hsv_to_rgb(0.06, float(rng.uniform(0.4, 0.8)), float(rng.uniform(0.15, 0.4))),
        floor=colorsys.hsv_to_rgb(0.1, 0.2, float(rng.uniform(0.15, 0.5))),
        floor_kind="planks" if rng.random() < 0.5 else "carpet",
        marks=MARKS[table.game],
        brightness=1.35, lamps=lamps, noise=float(rng.uniform(0.8, 1.8)), seed=int(rng.integers(8)),
    )  # fmt: skip


def render_clip(seed: int, number: int, folder: Path, bar: Progress, frames: int | None = None) -> Path:
    """Render clip `number` of a seed, of all its frames or of the first ones, unless it is there already."""
    sample = draw_clip(seed, number)
    if frames is not None:
        sample = replace(sample, seconds=frames / float(sample.rate) + 1e-6)
    path = folder / f"{sample.name}.mp4"
    if not path.is_file():
        make.make_sample(sample, folder, bar)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="Folder of the clips.")
    parser.add_argument("--clips", type=int, default=40, help="Number of clips.")
    parser.add_argument("--seed", type=int, default=1, help="Seed.")
    parser.add_argument("--only", type=int, help="Number of the only clip to render.")
    parser.add_argument("--frames", type=int, help="Number of frames of each clip. Default: about 60, a whole shot.")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with Progress() as bar:
        for number in [arguments.only] if arguments.only is not None else range(arguments.clips):
            render_clip(arguments.seed, number, arguments.out, bar, arguments.frames)


if __name__ == "__main__":
    main()
