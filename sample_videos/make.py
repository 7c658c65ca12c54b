"""Make the sample clips: a world moves the balls, the renderer films them, the truth is written beside each clip.

python sample_videos/make.py [--only NAME] [--out DIR]

The same script on the same library versions writes the same bytes.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress, TaskID
from shots import FOREIGN_EFFECTS, FOREIGN_LAWS, OUR_EFFECTS, OUR_LAWS, SAMPLES, Sample

from video.rendering.player_props import CUE_LENGTH, Rod, cue_rods, hand_rods
from video.rendering.scene_renderer import Motion, Poses, View, make_view, render_picture, seen_centres

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

HERE = Path(__file__).resolve().parent
WORLD = HERE.parent / "worlds" / "billiards.py"
WORLD_HZ = 2000
CLOCK = 90_000
"""Hz of the timestamps of a clip of variable rate."""
MISSING = (17, 18, 41)
"""Pictures that the phone of variable rate never delivered."""
JITTER = 0.0025
"""s, standard deviation of the phone's capture times around its nominal rate."""


def shot_of(sample: Sample) -> dict[str, Any]:
    """The shot as the world reads it."""
    radius = sample.table.ball_radius
    balls = [{"id": b.id, "x": b.x, "y": b.y, "radius": radius, "mass": sample.table.ball_mass} for b in sample.balls]
    balls[0] |= dict(zip(("vx", "vy", "wx", "wy", "wz"), (*sample.velocity, *sample.spin), strict=True))
    table = {"length": sample.table.length, "width": sample.table.width, "pockets": sample.table.pockets}
    return {
        "scene": "billiards", "table": table, "seconds": sample.seconds - sample.strike_at + 0.2, "hz": WORLD_HZ,
        "balls": balls, "effects": FOREIGN_EFFECTS if sample.foreign else OUR_EFFECTS,
        "laws": FOREIGN_LAWS if sample.foreign else OUR_LAWS,
    }  # fmt: skip


def play(shot: dict[str, Any]) -> tuple[Floats, list[dict[str, str]]]:
    """Samples (T, N, 7) of x, y, z, q and the events of a shot, played by the world in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shot.json"
        path.write_text(json.dumps(shot))
        subprocess.run([sys.executable, str(WORLD), str(path), folder], check=True)
        table = np.loadtxt(
            Path(folder) / "trajectory.csv", delimiter=",", skiprows=1, usecols=(2, 3, 4, 10, 11, 12, 13)
        )
        with (Path(folder) / "events.csv").open() as file:
            events = list(csv.DictReader(file))
    return table.reshape(-1, len(shot["balls"]), 7), events


def motion_of(sample: Sample, samples: Floats) -> Motion:
    """Poses at any time of the clip: the world's samples, and the player's cue and hand."""
    rng = np.random.default_rng(sample.seed)
    start = np.stack([rotation(q / np.linalg.norm(q)) for q in rng.standard_normal((len(sample.balls), 4))])
    start[0] = np.eye(3)
    gone = -3 * sample.table.ball_radius

    def motion(t: float) -> Poses:
        place = np.clip((t - sample.strike_at) * WORLD_HZ, 0, len(samples) - 1.001)
        row, part = int(place), place - int(place)
        now = samples[row] * (1 - part) + samples[row + 1] * part
        xyz = np.where(now[:, 2:3] < gone, np.nan, now[:, :3])
        turns = np.stack([rotation(q) for q in now[:, 3:]])
        return Poses(xyz, turns @ start, player_rods(sample, t) if sample.player else ())

    return motion


def rotation(q: Floats) -> Floats:
    """Matrix (3, 3) of a quaternion (4,), w first."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def player_rods(sample: Sample, t: float) -> tuple[Rod, ...]:
    """Cue and bridge hand at t: addressing, drawing back, striking, leaving."""
    radius, ball = sample.table.ball_radius, sample.balls[0]
    ahead = np.array(sample.velocity) / np.linalg.norm(sample.velocity)
    reach = cue_reach(t - sample.strike_at) - radius
    away = 2.2 * max(t - sample.strike_at - 0.35, 0.0) ** 2
    if away > 2 * CUE_LENGTH:
        return ()
    tip = np.append([ball.x, ball.y] + ahead * (reach - away), radius * 1.1 + 0.15 * away)
    bridge = np.append([ball.x, ball.y] - ahead * (0.20 + away), 0.25 * away)
    return (*hand_rods(bridge, ahead), *cue_rods(tip, ahead))


def cue_reach(t: float) -> float:
    """m from the tip's place at the strike (t = 0), negative behind."""
    if t < -0.45:
        return -0.03 - 0.02 * float(np.sin(6 * t))
    if t < -0.15:
        return float(np.interp(t, (-0.45, -0.15), (-0.03 - 0.02 * np.sin(-2.7), -0.14)))
    if t < 0:
        return -0.14 * (1 - ((t + 0.15) / 0.15) ** 2)
    return 0.05 * (1 - (1 - min(t / 0.12, 1)) ** 2)


def times_of(sample: Sample) -> Floats:
    """Mid-exposure times (T,) in s, the first 0."""
    count = int(sample.seconds * sample.rate)
    t = np.arange(count) / float(sample.rate)
    if not sample.irregular:
        return t
    t = np.delete(t + np.random.default_rng(sample.seed).normal(0, JITTER, count), MISSING)
    return np.round((t - t[0]) * CLOCK) / CLOCK


def write_clip(path: Path, view: View, sample: Sample, motion: Motion, bar: Progress, task: TaskID) -> None:
    """Render and encode; presentation times are the times of mid-exposure."""
    times, rng = times_of(sample), np.random.default_rng(sample.seed)
    base = Fraction(1, CLOCK) if sample.irregular else 1 / sample.rate
    part = path.with_suffix(".part.mp4")
    with av.open(str(part), "w") as container:
        stream = container.add_stream("libx264", rate=sample.rate)
        stream.width, stream.height, stream.pix_fmt = view.camera.width_px, view.camera.height_px, "yuv420p"
        stream.time_base = stream.codec_context.time_base = base
        stream.codec_context.thread_count = 1
        # without B-frames: x264's macroblock tree over them is not the same from run to run
        stream.options = {"crf": str(sample.crf), "preset": "slow", "bf": "0",
                          "x264-params": "force-cfr=1:colorprim=bt709:transfer=bt709:colormatrix=bt709"}  # fmt: skip
        for t in times:
            picture = render_picture(view, motion, float(t), rng)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
                format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
            )
            frame.pts, frame.time_base = round(t / base), base
            container.mux(stream.encode(frame))
            bar.advance(task)
        container.mux(stream.encode())
    part.replace(path)


def write_truth(
    path: Path, view: View, sample: Sample, motion: Motion, shot: dict[str, Any], events: list[dict[str, str]]
) -> None:
    """NAME.truth.json: scene, camera, events; NAME.truth.csv: a row per picture and ball."""
    times = times_of(sample)
    scene = {
        "clip": f"{sample.name}.mp4", "about": sample.about, "foreign": sample.foreign,
        "time": "presentation time = mid-exposure of the middle row, s",
        "fps": None if sample.irregular else str(sample.rate), "pictures": len(times),
        "exposure": sample.exposure, "readout": sample.readout,
        "lens": {"k1": sample.k1, "unit_px": round(view.lens.unit_px, 3)},
        "table": {"name": sample.table.name, "game": sample.table.game, **shot["table"]},
        "ball_radius": sample.table.ball_radius, "width_px": view.camera.width_px, "height_px": view.camera.height_px,
        "camera": {"matrix": view.camera.matrix.tolist(), "about": "(x, y, z up from the cloth, 1) to px, no lens"},
        "strike_at": sample.strike_at, "effects": shot["effects"], "laws": shot["laws"],
        "balls": [{"id": b.id, "kind": b.look.kind} for b in sample.balls],
        "events": [on_clip(event, sample) for event in events if float(event["t"]) + sample.strike_at <= times[-1]],
    }  # fmt: skip
    text = json.dumps(scene, indent=1)
    (path / f"{sample.name}.truth.json").write_text(text + "\n")
    with (path / f"{sample.name}.truth.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("frame", "t", "id", "x", "y", "x_px", "y_px", "radius_px", "visible"))
        for frame, t in enumerate(times):
            rows.writerows(truth_rows(view, sample, motion, frame, float(t)))


def on_clip(event: dict[str, str], sample: Sample) -> dict[str, str | float | None]:
    """An event of the world on the clip's clock."""
    speed = float(event["speed"])
    return {
        "kind": event["kind"], "t": round(float(event["t"]) + sample.strike_at, 6), "a": event["a"], "b": event["b"],
        "x": float(event["x"]), "y": float(event["y"]), "speed": None if np.isnan(speed) else speed,
    }  # fmt: skip


def truth_rows(view: View, sample: Sample, motion: Motion, frame: int, t: float) -> list[list[str]]:
    """Rows of the balls that are still there at t; a ball on its way down a pocket is not visible."""
    xyz, px = motion(t).xyz, seen_centres(view, motion, t)
    rows = []
    for ball in np.flatnonzero(np.isfinite(xyz[:, 0])):
        (x, y, z), seen = xyz[ball], px[ball]
        radius_px = view.camera.radius_px(xyz[ball, :2], sample.table.ball_radius)
        on_table = z > 0.999 * sample.table.ball_radius
        rows.append([str(frame), f"{t:.6f}", sample.balls[ball].id, f"{x:.5f}", f"{y:.5f}",
                     f"{seen[0]:.3f}", f"{seen[1]:.3f}", f"{radius_px:.2f}", str(int(on_table))])  # fmt: skip
    return rows


def scoreboard(lines: tuple[str, ...], width_px: int, height_px: int) -> Picture | None:
    """A broadcaster's board (H, W, 4) in the lower left corner."""
    if not lines:
        return None
    board = np.zeros((height_px, width_px, 4), np.uint8)
    top, left = height_px - 26 * len(lines) - 16, 24
    for i, line in enumerate(lines):
        y = top + 26 * i
        cv2.rectangle(board, (left, y), (left + 238, y + 22), (16, 22, 40, 225), -1)
        cv2.rectangle(board, (left, y), (left + 5, y + 22), ((240, 200, 20, 255), (230, 235, 240, 255))[i % 2], -1)
        cv2.putText(
            board, line, (left + 14, y + 16), cv2.FONT_HERSHEY_DUPLEX, 0.48, (240, 240, 240, 255), 1, cv2.LINE_AA
        )
    return board


def view_of(sample: Sample) -> View:
    """The sample's table before its camera."""
    camera = sample.camera
    return make_view(
        sample.table, camera, sample.look, tuple(ball.look for ball in sample.balls), sample.exposure, sample.readout,
        sample.k1, scoreboard(sample.scoreboard, camera.width_px, camera.height_px),
    )  # fmt: skip


def make(sample: Sample, out: Path, bar: Progress) -> None:
    """One clip and its truth."""
    task = bar.add_task(sample.name, total=len(times_of(sample)))
    shot = shot_of(sample)
    samples, events = play(shot)
    view, motion = view_of(sample), motion_of(sample, samples)
    write_truth(out, view, sample, motion, shot, events)
    write_clip(out / f"{sample.name}.mp4", view, sample, motion, bar, task)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the sample clips and their truth.")
    parser.add_argument("--only", choices=[sample.name for sample in SAMPLES], help="one clip instead of all")
    parser.add_argument("--out", type=Path, default=HERE, help="folder to write to (default: beside this script)")
    wanted = parser.parse_args()
    wanted.out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    with Progress() as bar:
        for sample in SAMPLES:
            if wanted.only in (None, sample.name):
                make(sample, wanted.out, bar)


if __name__ == "__main__":
    main()
