"""Measure detection in still images of 1280 to 8000 px, held level and upright.

    python -m benchmarks.detection.still_sizes [--sets marked,rendered] [--widths 1280,8000] [--views 8] [--rows FILE]

`marked` are the stills of ../shared/data, scaled to each width, and turned by 90 degrees; `rendered` ones are tables of
pool and snooker as a camera of 4000 to 8000 px sees them, from above, from an end, a side and a corner, with its blur,
noise and JPEG coding. A run with `--rows` continues. The goals: 99 % of the balls found, 99 % of the detections balls,
97 % of the kinds right.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.clips.varied_clips import MARKS, TABLES, VIEWS, draw_appearance, draw_balls, draw_camera, shots
from benchmarks.detection.detector_cases import CLASS_OF_LABEL, DATA, MARK_OFFSET
from benchmarks.support.row_files import append_row, read_rows
from detectors.detect_options import DetectOptions
from detectors.still_images import detect_in_still
from models.core.errors import TableNotFound
from models.core.scene import Camera
from models.core.typing import FloatArray, ImageArray
from pipeline.io.image_file import read_image
from video.io.video_options import CalibrateOptions
from video.rendering.scene_appearance import SceneAppearance
from video.rendering.scene_renderer import BallPoses, build_view, render_image

# px, of the longer side.
WIDTHS = (1280, 1920, 2560, 4032, 6000, 8000)
RENDERED_SIZES = ((4000, 3000), (6000, 4000), (8000, 6000))
# Side of the tiles that are rendered at once, which limits the memory, and by how much they overlap.
TILE_PX, SEAM_PX = 1500, 24
# Largest distance of a detection from its ball; and of a nearer ball that hides one, which then need not be found.
MATCHING_RADII, HIDDEN_RADII = 0.5, 1.2
# Radius of the balls of the stills with marks.
STILL_RADIUS_PX = 15.0
SNOOKER_STILL = "still_snooker.jpg"
SNOOKER_KINDS = ("red",) * 9 + ("cue", "yellow", "green", "brown", "blue", "pink", "black")


@dataclass(frozen=True)
class StillRow:
    """Result of one image at one size."""

    image: str
    width: int
    upright: int
    balls: int
    found: int
    false_balls: int
    kinds: int
    """Balls that were found and whose kind is known."""
    right_kinds: int
    seconds: float
    sentence: str


@dataclass(frozen=True)
class Still:
    """An image with its balls: places (N, 2) px, NaN where only the kinds are known, and kinds, empty where unknown."""

    name: str
    rgb: ImageArray
    px: FloatArray
    radius: FloatArray
    kinds: tuple[str, ...]
    required: tuple[bool, ...]


def read_marked_stills() -> Iterator[Still]:
    """Read the stills with marks."""
    labels = json.loads((DATA / "images" / "labels.json").read_text())
    for entry in labels["images"]:
        balls = entry["balls"]
        px = np.array([[ball["x_px"], ball["y_px"]] for ball in balls]) - MARK_OFFSET
        kinds = tuple(CLASS_OF_LABEL.get(ball.get("colour"), (ball.get("colour") or "").lower()) for ball in balls)
        radius = np.full(len(balls), STILL_RADIUS_PX)
        yield Still(entry["image"], read_image(DATA / "images" / entry["image"]), px, radius, kinds, (True,) * len(px))
    rgb, count = read_image(DATA / "clips_to_refuse_or_survive" / SNOOKER_STILL), len(SNOOKER_KINDS)
    yield Still(SNOOKER_STILL, rgb, np.full((count, 2), np.nan), np.full(count, np.nan), SNOOKER_KINDS, (True,) * count)


def scale_still(still: Still, width: int, upright: bool) -> Still:
    """Scale a still so that its longer side has `width` px, and turn it by 90 degrees if it is to be upright."""
    factor = width / max(still.rgb.shape[:2])
    size = tuple(round(side * factor) for side in still.rgb.shape[1::-1])
    rgb = cv2.resize(still.rgb, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC)
    px = (still.px + 0.5) * factor - 0.5
    if upright:
        rgb, px = np.ascontiguousarray(np.rot90(rgb)), np.column_stack([px[:, 1], size[0] - 1 - px[:, 0]])
    return replace(still, rgb=np.asarray(rgb, np.uint8), px=px, radius=still.radius * factor)


def render_still(seed: int, number: int) -> Still:
    """Render a still; number decides on table, view and size."""
    rng = np.random.default_rng([seed, number, 31])
    tables = [table for table in TABLES if table.game in MARKS and table.game != "carom"]
    table, view = tables[number % len(tables)], VIEWS[number // len(tables) % len(VIEWS)]
    size = RENDERED_SIZES[number % len(RENDERED_SIZES)][:: -1 if number // 2 % 2 else 1]
    camera = draw_camera(table, view, size, rng)
    balls = draw_balls(table, rng)
    appearance = replace(draw_appearance(table, rng), vignette=0.0, noise=float(rng.uniform(1, 5)),
                         blur_px=float(rng.uniform(0.8, 2.5)))  # fmt: skip
    rgb = render_tiles(table, camera, appearance, balls, rng)
    coded = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(75, 96))])[1]
    places = np.array([[ball.x, ball.y] for ball in balls])
    px, radius = camera.to_pixels(places, table.ball_radius), camera.radius_px(places, table.ball_radius)
    away = np.linalg.norm(np.column_stack([places, np.zeros(len(places))]) - camera.position, axis=1)
    gap = np.linalg.norm(px[:, None] - px, axis=-1)
    hidden = ((gap < HIDDEN_RADII * radius[:, None]) & (away[:, None] > away)).any(axis=1)
    return Still(
        f"{seed}_{number} {table.name} {view}", np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1], np.uint8),
        px, radius, tuple(ball.appearance.kind for ball in balls), tuple((~hidden).tolist()),
    )  # fmt: skip


def render_tiles(
    table: shots.Table, camera: Camera, appearance: SceneAppearance, balls: tuple[shots.Ball, ...],
    rng: np.random.Generator,
) -> ImageArray:  # fmt: skip
    """Render an image (H, W, 3) tile by tile."""
    xyz = np.array([[ball.x, ball.y, table.ball_radius] for ball in balls])
    turns = np.linalg.qr(rng.normal(size=(len(balls), 3, 3)))[0]
    turns *= np.linalg.det(turns)[:, None, None]
    image = np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
    for top in range(0, camera.height_px, TILE_PX):
        for left in range(0, camera.width_px, TILE_PX):
            shift = np.array([[1.0, 0, SEAM_PX - left], [0, 1, SEAM_PX - top], [0, 0, 1]])
            part = image[top : top + TILE_PX, left : left + TILE_PX]
            height, width = (side + 2 * SEAM_PX for side in part.shape[:2])
            corners = camera.corners_px + shift[:2, 2]
            own = replace(camera, matrix=shift @ camera.matrix, width_px=width, height_px=height, corners_px=corners)
            view = build_view(table, own, appearance, tuple(ball.appearance for ball in balls), samples=1)
            tile = render_image(view, lambda t: BallPoses(xyz, turns), 0.0, rng)
            part[:] = tile[SEAM_PX:-SEAM_PX, SEAM_PX:-SEAM_PX]
    return image


def score_still(still: Still, name: str) -> StillRow:
    """Detect the balls of a still, and compare them with its balls."""
    start, height, width = time.process_time(), *still.rgb.shape[:2]
    size = {"width": max(width, height), "upright": int(height > width), "balls": sum(still.required)}
    try:
        balls = detect_in_still(still.rgb, name, DetectOptions(), CalibrateOptions())
    except TableNotFound as missing:
        return StillRow(name, **size, found=0, false_balls=0, kinds=0, right_kinds=0,
                        seconds=time.process_time() - start, sentence=str(missing))  # fmt: skip
    seconds, listed = time.process_time() - start, list(balls.kind)
    if np.isnan(still.px).any():
        right = sum(min(listed.count(kind), still.kinds.count(kind)) for kind in set(still.kinds))
        found = min(len(listed), len(still.kinds))
        return StillRow(name, **size, found=found, false_balls=len(listed) - found, kinds=found, right_kinds=right,
                        seconds=seconds, sentence="")  # fmt: skip
    gap = np.linalg.norm(still.px[:, None] - balls.centre[None], axis=-1) / still.radius[:, None]
    pairs = [(i, j) for i, j in zip(*linear_sum_assignment(np.minimum(gap, 9.0)), strict=True)
             if gap[i, j] < MATCHING_RADII]  # fmt: skip
    named = [(still.kinds[i], listed[j]) for i, j in pairs if still.kinds[i]]
    wrong = [f"{one} as {two}" for one, two in named if one != two]
    seen, used = {i for i, _ in pairs}, {j for _, j in pairs}
    missed = [f"missed {still.kinds[i] or 'ball'} at {still.px[i].round().tolist()}" for i in range(len(still.px))
              if still.required[i] and i not in seen]  # fmt: skip
    false = [f"no ball at {balls.centre[j].round().tolist()}" for j in range(len(listed)) if j not in used]
    return StillRow(name, **size, found=sum(still.required[i] for i in seen), false_balls=len(false), kinds=len(named),
                    right_kinds=len(named) - len(wrong), seconds=seconds,
                    sentence="; ".join(missed + false + wrong))  # fmt: skip


def list_cases(sets: str, widths: list[int], views: int, seed: int, done: set[tuple[str, int, int]]) -> Iterator[Still]:
    """List the images that are not done yet."""
    if "marked" in sets and DATA.is_dir():
        for still in read_marked_stills():
            for width in widths:
                for upright in (False, True):
                    if (still.name, width, int(upright)) not in done:
                        yield scale_still(still, width, upright)
    for number in range(views if "rendered" in sets else 0):
        if not any(name.startswith(f"{seed}_{number} ") for name, _, _ in done):
            yield render_still(seed, number)


def print_table(rows: list[StillRow]) -> None:
    """Print shares by set and width."""
    print("| images | width, px | count | recall, % | precision, % | kinds, % | CPU, s |")
    print("|---|---|---|---|---|---|---|")
    groups = sorted({(row.image.startswith(("snooker_", "still_")), row.width) for row in rows}, reverse=True)
    for is_marked, width in groups:
        own = [r for r in rows if r.image.startswith(("snooker_", "still_")) == is_marked and r.width == width]
        sums = {name: sum(getattr(row, name) for row in own) for name in ("balls", "found", "false_balls", "kinds",
                                                                          "right_kinds", "seconds")}  # fmt: skip
        shares = (
            100 * sums["found"] / max(sums["balls"], 1),
            100 * sums["found"] / max(sums["found"] + sums["false_balls"], 1),
            100 * sums["right_kinds"] / max(sums["kinds"], 1),
        )
        cells = ["marked" if is_marked else "rendered", width, len(own), *(f"{share:.1f}" for share in shares)]
        print("|", " | ".join(map(str, [*cells, f"{sums['seconds'] / len(own):.1f}"])), "|")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", default="marked,rendered", help="names of the sets, separated by commas")
    parser.add_argument("--widths", default=",".join(map(str, WIDTHS)), help="px of the longer side of marked stills")
    parser.add_argument("--views", type=int, default=8, help="number of rendered stills")
    parser.add_argument("--seed", type=int, default=1, help="seed of the rendered stills")
    parser.add_argument("--rows", type=Path, help="file of the rows of single images")
    arguments = parser.parse_args()
    rows = read_rows(arguments.rows, StillRow)
    done = {(row.image, row.width, row.upright) for row in rows}
    widths = [int(width) for width in arguments.widths.split(",")]
    for still in list_cases(arguments.sets, widths, arguments.views, arguments.seed, done):
        rows.append(score_still(still, still.name))
        append_row(rows[-1], arguments.rows)
        print(rows[-1], file=sys.stderr, flush=True)
    print_table(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
