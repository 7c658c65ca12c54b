"""Make the sample clips: a world simulates the balls, the renderer films them; the truth is written next to each clip.

python sample_videos/make.py [--only NAME] [--out DIR]

The same script with the same library versions writes the same bytes.
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
from shots import FOREIGN_EFFECTS, FOREIGN_LAWS, PLAIN_EFFECTS, PLAIN_LAWS, SAMPLES, Sample

from video.rendering.player_props import CUE_LENGTH_M, Rod, make_cue_rods, make_hand_rods
from video.rendering.scene_renderer import BallPoses, Motion, SceneView, build_view, project_ball_centres, render_image

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.uint8]

HERE = Path(__file__).resolve().parent
WORLD_SCRIPT = HERE.parent / "worlds" / "billiards.py"
WORLD_HZ = 2000
# Hz, clock of the timestamps of a clip with variable frame rate.
CLOCK_HZ = 90_000
# Frames that the phone with variable frame rate never delivered.
MISSING_FRAMES = (17, 18, 41)
# s, standard deviation of the phone's capture times around its nominal rate.
JITTER_SIGMA_S = 0.0025


def build_world_shot(sample: Sample) -> dict[str, Any]:
    """Build the shot description that the world reads."""
    radius = sample.table.ball_radius
    balls = [{"id": b.id, "x": b.x, "y": b.y, "radius": radius, "mass": sample.table.ball_mass} for b in sample.balls]
    balls[0] |= dict(zip(("vx", "vy", "wx", "wy", "wz"), (*sample.velocity, *sample.spin), strict=True))
    table = {"length": sample.table.length, "width": sample.table.width, "pockets": sample.table.pockets}
    return {
        "scene": "billiards", "table": table, "seconds": sample.seconds - sample.strike_at + 0.2, "hz": WORLD_HZ,
        "balls": balls, "effects": FOREIGN_EFFECTS if sample.foreign else PLAIN_EFFECTS,
        "laws": FOREIGN_LAWS if sample.foreign else PLAIN_LAWS,
    }  # fmt: skip


def simulate_shot(shot: dict[str, Any]) -> tuple[FloatArray, list[dict[str, str]]]:
    """Simulate a shot with the world in its own process; return samples (T, N, 7) of x, y, z, q, and the events."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shot.json"
        path.write_text(json.dumps(shot))
        subprocess.run([sys.executable, str(WORLD_SCRIPT), str(path), folder], check=True)
        table = np.loadtxt(
            Path(folder) / "trajectory.csv", delimiter=",", skiprows=1, usecols=(2, 3, 4, 10, 11, 12, 13)
        )
        with (Path(folder) / "events.csv").open() as file:
            events = list(csv.DictReader(file))
    return table.reshape(-1, len(shot["balls"]), 7), events


def build_motion(sample: Sample, samples: FloatArray) -> Motion:
    """Build the function from clip time to poses: the world's samples, and the player's cue and hand."""
    rng = np.random.default_rng(sample.seed)
    start = np.stack([rotation_matrix(q / np.linalg.norm(q)) for q in rng.standard_normal((len(sample.balls), 4))])
    start[0] = np.eye(3)
    potted_depth = -3 * sample.table.ball_radius

    def motion(t: float) -> BallPoses:
        sample_position = np.clip((t - sample.strike_at) * WORLD_HZ, 0, len(samples) - 1.001)
        row, weight = int(sample_position), sample_position - int(sample_position)
        state = samples[row] * (1 - weight) + samples[row + 1] * weight
        xyz = np.where(state[:, 2:3] < potted_depth, np.nan, state[:, :3])
        rotations = np.stack([rotation_matrix(q) for q in state[:, 3:]])
        return BallPoses(xyz, rotations @ start, player_rods(sample, t) if sample.player else ())

    return motion


def rotation_matrix(q: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of a quaternion (4,), w first."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def player_rods(sample: Sample, t: float) -> tuple[Rod, ...]:
    """Return cue and bridge hand at time t: address, back swing, strike, retreat."""
    radius, ball = sample.table.ball_radius, sample.balls[0]
    forward = np.array(sample.velocity) / np.linalg.norm(sample.velocity)
    tip_offset = cue_reach(t - sample.strike_at) - radius
    retreat = 2.2 * max(t - sample.strike_at - 0.35, 0.0) ** 2
    if retreat > 2 * CUE_LENGTH_M:
        return ()
    tip = np.append([ball.x, ball.y] + forward * (tip_offset - retreat), radius * 1.1 + 0.15 * retreat)
    bridge = np.append([ball.x, ball.y] - forward * (0.20 + retreat), 0.25 * retreat)
    return (*make_hand_rods(bridge, forward), *make_cue_rods(tip, forward))


def cue_reach(t: float) -> float:
    """Return the position (m) of the tip relative to the strike (t = 0), negative behind."""
    if t < -0.45:
        return -0.03 - 0.02 * float(np.sin(6 * t))
    if t < -0.15:
        return float(np.interp(t, (-0.45, -0.15), (-0.03 - 0.02 * np.sin(-2.7), -0.14)))
    if t < 0:
        return -0.14 * (1 - ((t + 0.15) / 0.15) ** 2)
    return 0.05 * (1 - (1 - min(t / 0.12, 1)) ** 2)


def capture_times(sample: Sample) -> FloatArray:
    """Return mid-exposure times (T,) in s; the first is 0."""
    count = int(sample.seconds * sample.rate)
    t = np.arange(count) / float(sample.rate)
    if not sample.irregular:
        return t
    t = np.delete(t + np.random.default_rng(sample.seed).normal(0, JITTER_SIGMA_S, count), MISSING_FRAMES)
    return np.round((t - t[0]) * CLOCK_HZ) / CLOCK_HZ


def write_clip(path: Path, view: SceneView, sample: Sample, motion: Motion, bar: Progress, task: TaskID) -> None:
    """Render and encode a clip; presentation times are the times of mid-exposure."""
    times, rng = capture_times(sample), np.random.default_rng(sample.seed)
    base = Fraction(1, CLOCK_HZ) if sample.irregular else 1 / sample.rate
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
            image = render_image(view, motion, float(t), rng)
            frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(
                format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
            )
            frame.pts, frame.time_base = round(t / base), base
            container.mux(stream.encode(frame))
            bar.advance(task)
        container.mux(stream.encode())
    part.replace(path)


def write_truth(
    path: Path, view: SceneView, sample: Sample, motion: Motion, shot: dict[str, Any], events: list[dict[str, str]]
) -> None:
    """Write NAME.truth.json (scene, camera, events) and NAME.truth.csv (a row per frame and ball)."""
    times = capture_times(sample)
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
        "balls": [{"id": b.id, "kind": b.appearance.kind} for b in sample.balls],
        "events": [convert_event(e, sample) for e in events if float(e["t"]) + sample.strike_at <= times[-1]],
    }  # fmt: skip
    text = json.dumps(scene, indent=1)
    (path / f"{sample.name}.truth.json").write_text(text + "\n")
    with (path / f"{sample.name}.truth.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("frame", "t", "id", "x", "y", "x_px", "y_px", "radius_px", "visible"))
        for frame, t in enumerate(times):
            rows.writerows(format_truth_rows(view, sample, motion, frame, float(t)))


def convert_event(event: dict[str, str], sample: Sample) -> dict[str, str | float | None]:
    """Convert an event of the world to the clip's clock."""
    speed = float(event["speed"])
    return {
        "kind": event["kind"], "t": round(float(event["t"]) + sample.strike_at, 6), "a": event["a"], "b": event["b"],
        "x": float(event["x"]), "y": float(event["y"]), "speed": None if np.isnan(speed) else speed,
    }  # fmt: skip


def format_truth_rows(view: SceneView, sample: Sample, motion: Motion, frame: int, t: float) -> list[list[str]]:
    """Format the rows of the balls that still exist at t; a ball that falls into a pocket is not visible."""
    xyz, px = motion(t).xyz, project_ball_centres(view, motion, t)
    rows = []
    for ball in np.flatnonzero(np.isfinite(xyz[:, 0])):
        (x, y, z), seen_px = xyz[ball], px[ball]
        radius_px = view.camera.radius_px(xyz[ball, :2], sample.table.ball_radius)
        on_table = z > 0.999 * sample.table.ball_radius
        rows.append([str(frame), f"{t:.6f}", sample.balls[ball].id, f"{x:.5f}", f"{y:.5f}",
                     f"{seen_px[0]:.3f}", f"{seen_px[1]:.3f}", f"{radius_px:.2f}", str(int(on_table))])  # fmt: skip
    return rows


def draw_scoreboard(lines: tuple[str, ...], width_px: int, height_px: int) -> ImageArray | None:
    """Draw a broadcaster's scoreboard (H, W, 4) in the lower left corner."""
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


def build_sample_view(sample: Sample) -> SceneView:
    """Build the view of the sample's table through its camera."""
    camera = sample.camera
    return build_view(
        sample.table, camera, sample.appearance, tuple(ball.appearance for ball in sample.balls), sample.exposure,
        sample.readout, sample.k1, draw_scoreboard(sample.scoreboard, camera.width_px, camera.height_px),
    )  # fmt: skip


def make_sample(sample: Sample, out: Path, bar: Progress) -> None:
    """Make one clip and its truth."""
    task = bar.add_task(sample.name, total=len(capture_times(sample)))
    shot = build_world_shot(sample)
    samples, events = simulate_shot(shot)
    view, motion = build_sample_view(sample), build_motion(sample, samples)
    write_truth(out, view, sample, motion, shot, events)
    write_clip(out / f"{sample.name}.mp4", view, sample, motion, bar, task)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the sample clips and their truth.")
    parser.add_argument("--only", choices=[sample.name for sample in SAMPLES], help="one clip instead of all")
    parser.add_argument("--out", type=Path, default=HERE, help="folder to write to (default: beside this script)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    with Progress() as bar:
        for sample in SAMPLES:
            if arguments.only in (None, sample.name):
                make_sample(sample, arguments.out, bar)


if __name__ == "__main__":
    main()
