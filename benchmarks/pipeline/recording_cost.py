"""Measure size, write time, load time and scrubbing of recording.rrd for 10 s of 1920 x 1080 at 60 fps.

    python -m benchmarks.pipeline.recording_cost [--balls 16]

All balls roll for the whole clip and rebound from the cushions, which is more than in any shot. Goals: at most 5 s
beyond the rest of the chain, and 1.3 times the size of the clip plus 10 MB. Two clips of the same motion: one with a
key frame each second, as phones write it, and one with a single key frame, like many clips of the web. Takes about a
minute. Prints one table:

- read: CPU seconds of rerun's own reader for the whole recording, without drawing.
- chunks: units in which a viewer holds the recording in memory.
- farthest: frames to decode before the worst placed frame is shown, and the CPU milliseconds for them on one thread;
  scrubbing is smooth up to about a quarter of a second. The recording contains the clip unchanged: a copy of the second
  clip with a key frame each second needs 211 ms, but 14 CPU s and 21 MB where 13 are allowed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import av
import cv2
import numpy as np
from rerun.chunk import RrdReader

from models.core.detections import Detections
from models.core.events import Events
from models.core.fit_result import Fit, Parameter, Trust
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.forecast.forecast_values import ForecastFan, ForecastFans
from pipeline.reporting.recording.recording_file import write_recording
from video.io.clip import Clip, open_clip

SECONDS, RATE, WIDTH, HEIGHT = 10, 60, 1920, 1080
PX_PER_M = 680.0
EDGE_PX = np.array([96.0, 108.0])
MOST_SECONDS, MOST_TIMES, MOST_BYTES = 5.0, 1.3, 10e6
FANS, MEMBERS = 4, 48


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--balls", type=int, default=16, help="number of balls")
    balls = parser.parse_args().balls
    scene = table_from_above()
    motion, bounces = simulate_rolling(scene.table, balls, np.random.default_rng(8))
    head = ("key frames", "events", "clip MB", "recording MB", "allowed MB", "write CPU s", "wall s", "goal s",
            "read CPU s", "chunks", "farthest", "CPU ms")  # fmt: skip
    print(f"| {' | '.join(head)} |\n" + len(head) * "|---" + "|")
    over = [measure_recording(scene, motion, bounces, each) for each in (RATE, SECONDS * RATE)]
    return int(any(over))


def measure_recording(
    scene: Scene, motion: Trajectory, bounces: list[tuple[float, int, str]], key_frame_each: int
) -> bool:
    """Write a clip and its recording, read and scrub it, and print a row; returns whether a limit is exceeded."""
    with tempfile.TemporaryDirectory() as folder:
        clip = write_film(Path(folder) / "clip.mp4", scene, motion, key_frame_each)
        tracks = make_tracks(clip, scene, motion)
        fit = make_fit(motion, bounces, tracks)
        target = Path(folder) / "recording.rrd"
        start, cpu = time.perf_counter(), time.process_time()
        write_recording(clip, scene, make_detections(tracks), tracks, fit, make_forecasts(motion), target, "benchmark")
        wall, cpu = time.perf_counter() - start, time.process_time() - cpu
        own, written = clip.path.stat().st_size, target.stat().st_size
        read, chunks, film_inside = read_recording(target)
        (Path(folder) / "inside.mp4").write_bytes(film_inside)
        frames, spent = measure_farthest_frame(Path(folder) / "inside.mp4")
    allowed = MOST_TIMES * own + MOST_BYTES
    print(
        f"| each {key_frame_each} | {len(fit.events)} | {own / 1e6:.1f} | {written / 1e6:.1f} | {allowed / 1e6:.1f} "
        f"| {cpu:.1f} | {wall:.1f} | {MOST_SECONDS:.0f} | {read:.2f} | {chunks} | {frames} "
        f"| {1000 * spent:.0f} |",
        flush=True,
    )
    return written > allowed or wall > MOST_SECONDS


def read_recording(recording: Path) -> tuple[float, int, bytes]:
    """Return the CPU seconds to read every row of a recording, its number of chunks, and the video inside."""
    start, chunks, film_inside = time.process_time(), 0, b""
    for chunk in RrdReader(recording).stream():
        batch = chunk.to_record_batch()
        chunks += 1
        if chunk.entity_path == "/picture/video" and chunk.is_static:
            film_inside = batch.column("AssetVideo:blob")[0].values[0].values.to_numpy(zero_copy_only=False).tobytes()
    return time.process_time() - start, chunks, film_inside


def measure_farthest_frame(path: Path) -> tuple[int, float]:
    """Return the largest number of frames from one key frame to the next, and the CPU seconds to decode them."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type, stream.codec_context.thread_count = "NONE", 1
        packets = [packet for packet in container.demux(stream) if packet.size]
        keys = np.flatnonzero([packet.is_keyframe for packet in packets])
        runs = np.diff([*keys, len(packets)])
        first, count = int(keys[np.argmax(runs)]), int(runs.max())
        start = time.process_time()
        for packet in [*packets[first : first + count], None]:
            stream.codec_context.decode(packet)
    return count, time.process_time() - start


def table_from_above() -> Scene:
    """Return a pool table that nearly fills the frame."""
    table = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, True)
    matrix = np.array([[PX_PER_M, 0, 0, EDGE_PX[0]], [0, PX_PER_M, 0, EDGE_PX[1]], [0, 0, 0, 1.0]])
    corners = PX_PER_M * table.corners + EDGE_PX
    camera = Camera(matrix, WIDTH, HEIGHT, corners, np.eye(8), "noses", 3.0, 0.5)
    return Scene(table, camera, np.array([40.0, -20.0, 10.0]), ("A rendered table.",))


def simulate_rolling(
    table: Table, balls: int, rng: np.random.Generator
) -> tuple[Trajectory, list[tuple[float, int, str]]]:
    """Simulate balls with constant deceleration and mirror cushions; returns the motion and the rebounds."""
    segments: list[tuple[int, float, float, FloatArray]] = []
    bounces: list[tuple[float, int, str]] = []
    low, high = np.full(2, table.ball_radius), np.array([table.length, table.width]) - table.ball_radius
    for ball in range(balls):
        t, x = 0.0, rng.uniform(low, high)
        v = rng.uniform(0.8, 2.0) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)])
        while t < SECONDS:
            brake = -0.05 * v / np.linalg.norm(v)
            duration, axis = time_to_cushion(x, v, brake, low, high)
            end = min(t + duration, float(SECONDS))
            segments.append((ball, t, end, np.array([x, v, brake / 2, np.zeros(2)])))
            x, v, t = x + v * (end - t) + brake / 2 * (end - t) ** 2, v + brake * (end - t), end
            if end < SECONDS:
                bounces.append((end, ball, (("left", "right"), ("top", "bottom"))[axis][int(v[axis] > 0)]))
                v[axis] = -v[axis]
    index, start, end, position = (list(column) for column in zip(*segments, strict=True))
    count = len(segments)
    names = tuple(f"ball-{k}" for k in range(balls))
    return Trajectory(
        names, np.array(index), np.array(start), np.array(end), np.array(position), np.zeros((count, 2, 3)),
        ("roll",) * count, np.tile(1e-8 * np.eye(4), (count, 1, 1)),
    ), sorted(bounces)  # fmt: skip


def time_to_cushion(
    x: FloatArray, v: FloatArray, brake: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[float, int]:
    """Return the time (s) until a ball reaches a cushion, and the axis of that cushion."""
    times = []
    for axis in (0, 1):
        way = (high if v[axis] > 0 else low)[axis] - x[axis]
        roots = np.roots([brake[axis] / 2, v[axis], -way])
        ahead = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and r.real > 1e-6]
        times.append(min(ahead, default=np.inf))
    return max(min(times), 1e-3), int(np.argmin(times))


def write_film(path: Path, scene: Scene, motion: Trajectory, key_frame_each: int) -> Clip:
    """Write discs on a noisy cloth, so that the clip is about as large as one of a camera."""
    rng = np.random.default_rng(1)
    cloth = np.full((HEIGHT, WIDTH, 3), (30, 110, 70), np.int16) + rng.integers(-12, 12, (HEIGHT, WIDTH, 1))
    cloth = cloth.clip(0, 255).astype(np.uint8)
    colours = rng.integers(60, 255, (len(motion.ids), 3)).tolist()
    t = np.arange(SECONDS * RATE) / RATE
    radius = PX_PER_M * scene.table.ball_radius
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=RATE)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = WIDTH, HEIGHT, "yuv420p", key_frame_each
        stream.options = {"crf": "20", "preset": "veryfast", "sc_threshold": "0", "x264-params": "force-cfr=1"}
        for places in scene.camera.to_pixels(motion.at(t).xy, scene.table.ball_radius):
            image = cloth.copy()
            for (x, y), colour in zip(places, colours, strict=True):
                cv2.circle(image, (round(16 * x), round(16 * y)), round(16 * radius), colour, -1, cv2.LINE_AA, 4)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return open_clip(path)


def make_tracks(clip: Clip, scene: Scene, motion: Trajectory) -> Tracks:
    """Make tracks of every ball in every frame, with 0.3 px of noise."""
    frames = np.arange(clip.frame_count)
    xy = motion.at(clip.t).xy
    noise = np.random.default_rng(2).normal(0, 0.3 / PX_PER_M, xy.shape)
    one = np.ones(xy.shape[:2])
    px = scene.camera.to_pixels(xy + noise, scene.table.ball_radius)
    colour = np.tile([60.0, 40.0, 20.0], (len(motion.ids), 1))
    radius = PX_PER_M * scene.table.ball_radius * one
    sigma = 0.3 / PX_PER_M * one
    return Tracks(
        frames, clip.t, motion.ids, ("ball",) * len(motion.ids), xy + noise, px, sigma, sigma, np.zeros_like(xy),
        radius, colour,
    )  # fmt: skip


def make_detections(tracks: Tracks) -> Detections:
    """Make detections of the same balls."""
    count, balls = tracks.px.shape[:2]
    one = np.ones(count * balls)
    return Detections(
        np.repeat(tracks.frame, balls), tracks.px.reshape(-1, 2), tracks.radius_px.ravel(), np.zeros((len(one), 2)),
        np.tile(tracks.colour, (count, 1)), 0 * one, 0 * one, 0.5 * one, one, 0.3 * one, 0.3 * one,
    )  # fmt: skip


def make_fit(motion: Trajectory, bounces: list[tuple[float, int, str]], tracks: Tracks) -> Fit:
    """Make the fit: the true motion, with residuals of the noise."""
    t = np.array([when for when, _, _ in bounces])
    one = np.ones(len(t))
    balls = [ball for _, ball, _ in bounces]
    places = motion.at(t).xy[np.arange(len(t)), balls]
    events = Events(
        ("cushion",) * len(t), t, 1e-3 * one, RATE * t, tuple(motion.ids[k] for k in balls),
        tuple(side for _, _, side in bounces), places, one, -0.05 * one, 1e-3 * one, one,
    )  # fmt: skip
    everywhere = np.ones(tracks.xy.shape[:2], bool)
    friction = Parameter("rolling_resistance.mu", 0.005, 1e-4, "1", False)
    residual = tracks.xy - motion.at(tracks.t).xy
    trust = Trust("green", ("It is rendered.",))
    return Fit(events, motion, (friction,), 4e-4, 1.0, residual, everywhere, everywhere, trust)


def make_forecasts(motion: Trajectory) -> ForecastFans:
    """Make forecasts from several moments."""
    rng = np.random.default_rng(3)
    fans = []
    for start in np.linspace(1, 7, FANS):
        times = start + 0.03 * np.arange(51)
        xy = motion.at(times).xy
        spread = rng.normal(0, 0.05, (MEMBERS, 1, xy.shape[1], 2)) * (times - start)[:, None, None]
        fans.append(ForecastFan(float(start), motion.ids, times, xy + spread))
    return ForecastFans(tuple(fans))


if __name__ == "__main__":
    sys.exit(main())
