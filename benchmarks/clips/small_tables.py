"""Run clips of small tables: a phone held upright, white nets, one to three balls, pixels that are not square.

    python -m benchmarks.clips.small_tables [-o DIR] [--clips 24] [--seed 1]

Clip K of a seed is always the same. The world of the sample clips simulates the shot; the balls are as large as those
of any maker, and a net is painted over each hole. Half of the clips miss frames. A run resumes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.clips.traps import (
    MATCHING_SECONDS,
    Stage,
    blend,
    draw_circle,
    paint_mask,
    score_run,
    to_px,
    write_clip,
)
from benchmarks.clips.varied_clips import draw_appearance, draw_camera, draw_places, make, shots
from benchmarks.support.row_files import append_row, read_rows
from benchmarks.support.run_folder import ROOT, RunFolder, read_run, run_clip
from models.core.scene import Table
from models.core.typing import BoolArray, FloatArray, ImageArray
from video.rendering.scene_renderer import render_image
from video.rendering.table_rendering import HOLE_BACK_CORNER, HOLE_BACK_SIDE, HOLE_RADIUS

# px, three of four held upright.
SIZES = ((334, 616), (400, 712), (640, 360), (540, 960))
# Lengths of tables for children and of four to four and a half feet, and radii of the balls that come with them.
LENGTHS_M, RADII_M = (0.95, 1.4), (0.019, 0.0286)
# Width of what the image shows outside of the noses.
RAILS_M = (0.05, 0.12)
# Apparent length over width of the table, with pixels that are not square; trueroll refuses a few percent more.
ASPECTS = (1.93, 2.25)
# Distance of a net behind the noses, in that of a rendered hole: the nets of small tables reach further inwards.
BACK_SHARE = 0.4


@dataclass(frozen=True)
class SmallTableRow:
    """Result of one clip."""

    clip: str
    about: str
    status: int
    balls: int
    found: int
    """True balls with a track."""
    false_balls: int
    events: int
    """True events of the strike and of contacts until a ball falls into a pocket."""
    recalled: int
    """Those listed at 0.5 or more within `MATCHING_SECONDS`."""
    sure: int
    """False events at 0.99 or more."""
    trust: str
    sentence: str


def draw_sample(seed: int, number: int) -> tuple[shots.Sample, float]:
    """Draw the shot of a clip, and by how much its pixels are squeezed."""
    rng = np.random.default_rng([seed, number, 21])
    length, radius = float(rng.uniform(*LENGTHS_M)), float(rng.uniform(*RADII_M))
    table = Table("home", "pool", length, length / float(rng.uniform(1.9, 2.05)), radius, 8000 * radius**3, True)
    camera = draw_camera(table, "above", SIZES[number % len(SIZES)], rng, float(rng.uniform(*RAILS_M)))
    count = 1 + number % 3
    numbers = rng.permutation(np.arange(1, 16))[:count]
    numbers[0] *= number // len(SIZES) % 2  # the cue ball is struck in half of the clips, a coloured one in the others
    balls = shots.pool_balls(*((int(k), *xy) for k, xy in zip(numbers, draw_places(table, count, rng), strict=True)))
    angle, speed = float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(1.0, 3.0))
    if count > 1:
        angle = float(np.arctan2(balls[1].y - balls[0].y, balls[1].x - balls[0].x)) + float(rng.normal(0, 0.03))
    velocity = (speed * float(np.cos(angle)), speed * float(np.sin(angle)))
    sample = shots.Sample(
        f"small_{seed}_{number:02}", f"{count} balls of {1e3 * radius:.1f} mm on {length:.2f} m", table, camera,
        draw_appearance(table, rng), balls, velocity, (0.0, 0.0, 0.0), bool(rng.integers(2)), Fraction(30), 3.0,
        strike_at=0.6, exposure=1 / 90, player=bool(rng.integers(4)), irregular=bool(number % 2), seed=number,
    )  # fmt: skip
    wide = rng.uniform(*ASPECTS) * table.width / table.length
    return sample, float(1 / wide if camera.height_px > camera.width_px else wide)


def make_clip(seed: int, number: int, path: Path) -> tuple[shots.Sample, dict[str, Any]]:
    """Write a clip unless it is there; return its shot, and the truth as for `clips.traps`."""
    sample, squeeze = draw_sample(seed, number)
    shot = make.build_world_shot(sample)
    states, events = make.simulate_shot(shot)
    view, motion, times = make.build_sample_view(sample), make.build_motion(sample, states), make.capture_times(sample)
    rng = np.random.default_rng([seed, number, 22])
    stage = Stage(sample.table, sample.camera, np.array([[ball.x, ball.y] for ball in sample.balls]), view)
    nets = draw_nets(stage, rng)
    size = (2 * round(sample.camera.width_px * squeeze / 2), sample.camera.height_px)
    scale = np.array([size[0] / sample.camera.width_px, 1.0])

    def render() -> Iterator[ImageArray]:
        for t in times:
            image = render_image(view, motion, float(t), rng)
            px = make.project_ball_centres(view, motion, float(t))
            radii = view.camera.radius_px(stage.rest, sample.table.ball_radius)
            hidden = draw_discs(image.shape, px, radii)
            for outline, net in nets:
                image = blend(image, outline * ~hidden, net)
            yield np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    if not path.is_file():
        write_clip(path, render(), sample.rate, times)
    px = np.stack([make.project_ball_centres(view, motion, float(t)) for t in times])
    frames = [{**make.convert_event(one, sample)} for one in events]
    for one in frames:
        one["frame"] = float(np.interp(one["t"], times, np.arange(len(times))))
    known = [one for one in frames if one["t"] < times[-1] - 0.1]
    names = [ball.id for ball in sample.balls]
    return sample, {"frames": len(times), "rate": sample.rate, "px": scale * px, "events": known, "names": names}


def draw_nets(stage: Stage, rng: np.random.Generator) -> list[tuple[FloatArray, FloatArray]]:
    """Draw the outline (H, W) of each hole and the image (H, W, 3) of its net, threads over darker meshes."""
    table, shape = stage.table, (stage.camera.height_px, stage.camera.width_px)
    outwards = np.sign(table.pocket_centres - [table.length / 2, table.width / 2])
    back = BACK_SHARE * np.where(outwards[:, :1] == 0, HOLE_BACK_SIDE, HOLE_BACK_CORNER)
    pale, nets = rng.uniform(150, 250), []
    for centre in table.pocket_centres + back * outwards:
        circle = draw_circle(stage, centre, HOLE_RADIUS / table.ball_radius)
        reach = HOLE_RADIUS * rng.uniform(-1, 1, (60, 2, 2))
        threads = [paint_mask(shape, to_px(stage, centre + ends), int(rng.integers(1, 4)), False) for ends in reach]
        net = np.full((*shape, 3), rng.uniform(60, 120))
        for thread in threads:
            net = net + (pale * rng.uniform(0.7, 1.0) - net) * thread[..., None]
        nets.append((paint_mask(shape, circle, None), net))
    return nets


def draw_discs(shape: tuple[int, ...], px: FloatArray, radii: FloatArray) -> BoolArray:
    """Draw the balls (H, W) at places (N, 2) px, without those that are NaN."""
    mask = np.zeros(shape[:2], np.uint8)
    for (x, y), radius in zip(px, radii, strict=True):
        if np.isfinite(x):
            cv2.circle(mask, (round(16 * x), round(16 * y)), round(16 * radius), 1, -1, shift=4)
    return mask > 0


def score_clip(clip: Path, sample: shots.Sample, truth: dict[str, Any], run: RunFolder) -> SmallTableRow:
    """Score a run folder."""
    trap = score_run(clip, "small", truth, run, 0.0)
    found = {find_true_ball(run, str(name), truth) for name in np.unique(run.tracks["id"])} - {""}
    falls = [one["t"] for one in truth["events"] if one["kind"] == "pocket"]
    wanted = [{"kind": "strike", "t": sample.strike_at}]
    wanted += [
        one for one in truth["events"] if one["kind"] in ("ball", "cushion") and one["t"] < min(falls, default=9)
    ]
    listed = run.events
    recalled = [
        any(
            listed["kind"][k] == one["kind"] and abs(listed["t"][k] - one["t"]) < MATCHING_SECONDS
            and listed["probability"][k] >= 0.5
            for k in range(len(listed["kind"]))
        )
        for one in wanted
    ]  # fmt: skip
    missed = "; ".join(f"missed {one['kind']} {one['t']:.2f}" for one, is_there in zip(wanted, recalled, strict=True)
                       if not is_there)  # fmt: skip
    return SmallTableRow(
        clip.stem, sample.about, 0, len(sample.balls), len(found), trap.false_balls, len(wanted), sum(recalled),
        trap.sure, run.scene["trust"]["light"], "; ".join(filter(None, (missed, trap.sentence))),
    )  # fmt: skip


def find_true_ball(run: RunFolder, name: str, truth: dict[str, Any]) -> str:
    """Find the true ball that a track follows in half of its observed rows; empty for none."""
    rows = (run.tracks["id"] == name) & (run.tracks["observed"] == 1)
    px = np.column_stack([run.tracks["x_px"][rows], run.tracks["y_px"][rows]])
    gap = np.linalg.norm(truth["px"][run.tracks["frame"][rows].astype(int)] - px[:, None], axis=-1)
    share = (gap < run.tracks["radius_px"][rows][:, None]).mean(axis=0)
    return str(truth["names"][int(np.argmax(share))]) if len(px) and share.max() > 0.5 else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "-o", "--out", type=Path, default=ROOT / "out" / "small_tables", help="folder of clips and runs"
    )
    parser.add_argument("--clips", type=int, default=24, help="number of clips")
    parser.add_argument("--seed", type=int, default=1, help="seed")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    table = arguments.out / f"rows_{arguments.seed}.csv"
    rows = {row.clip: row for row in read_rows(table, SmallTableRow)}
    for number in range(arguments.clips):
        clip = arguments.out / f"small_{arguments.seed}_{number:02}.mp4"
        if clip.stem in rows:
            continue
        sample, truth = make_clip(arguments.seed, number, clip)
        outcome = run_clip(clip, clip.with_suffix(""), "--no-video")
        if outcome.status:
            sizes = len(sample.balls), 0, 0, 0, 0, 0
            row = SmallTableRow(clip.stem, sample.about, outcome.status, *sizes, "", outcome.sentence)
        else:
            row = score_clip(clip, sample, truth, read_run(clip.with_suffix("")))
        rows[clip.stem] = row
        append_row(row, table)
        print(row, file=sys.stderr, flush=True)
    own = list(rows.values())
    print("| clips | refused | balls | found | false balls | events | recalled | false events >= 0.99 | red |")
    print("|---|---|---|---|---|---|---|---|---|")
    sums = [
        sum(getattr(row, n) for row in own) for n in ("balls", "found", "false_balls", "events", "recalled", "sure")
    ]
    refused, red = sum(row.status != 0 for row in own), sum(row.trust == "red" for row in own)
    print("|", " | ".join(map(str, [len(own), refused, *sums, red])), "|")
    return 0


if __name__ == "__main__":
    sys.exit(main())
