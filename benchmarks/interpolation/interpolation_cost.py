"""Measure the CPU time of frame interpolation on one core: to prepare a gap, and for each of seven frames in it.

    python -m benchmarks.interpolation.interpolation_cost [--quick] [CLIP ...]

Without CLIPs, three real ones of ../shared/data. Takes a minute once their runs are in the cache. Decoding and encoding
are not counted; the preparation of the whole clip is reported separately. Goal: 25 ms per frame and 150 ms per gap at
720p.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.support.figures import ROOT, Figure, add_quick_option, run_quick, state_cost
from benchmarks.support.run_folder import FOOTAGE
from models.core.progress import Progress, ignore_progress
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.chain import build_shot_graph, run_shot_graph
from pipeline.engine.result_cache import ResultCache, default_cache_root
from pipeline.run_options import RunOptions
from video.io.clip import read_frames
from video.matting.ball_timeline import build_ball_timeline
from video.matting.hidden_background import estimate_hidden_background
from video.overlay.slow_motion import balls_at_times
from video.synthesis.frame_synthesis import ClipAppearance, estimate_clip_appearance, prepare_interval

QUICK_CLIP = ROOT / "sample_videos" / "many_contacts.mp4"
FACTOR, GAPS = 8, 12
CLIPS = ("snooker_null_grad_stoss_1_0003_0009", "pool8_game2_clip1", "carom_F1")


class SilentWatcher:
    """A watcher without output."""

    def start_stage(self, stage: str) -> Progress:
        return ignore_progress

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        pass


def measure_gap(appearance: ClipAppearance, row: int, first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Return CPU seconds to prepare a gap, and per frame in it."""
    timeline, start = appearance.timeline, time.process_time()
    interval = prepare_interval(timeline, appearance.plate, row, first, second, sharp_balls=appearance.sharp_balls)
    begin, end = timeline.t[[row, row + 1]]
    times = begin + (end - begin) * np.arange(1, FACTOR) / FACTOR
    state, ways = timeline.state_at(times), timeline.streak_paths(times, timeline.shutter_time)
    opened = time.process_time()
    for t, balls, way in zip(times.tolist(), balls_at_times(timeline, state, times), ways, strict=True):
        interval.synthesize(t, balls.centre, way)
    return opened - start, (time.process_time() - opened) / len(times)


def measure_clip(clip: Path) -> tuple[tuple[int, int], float, np.ndarray]:
    """Return the size of a clip, CPU seconds to prepare it, and costs (gaps, 2) s."""
    opened_clip, shot = run_shot_graph(
        build_shot_graph(clip, RunOptions()), ResultCache(default_cache_root()), SilentWatcher()
    )
    start = time.process_time()
    timeline = build_ball_timeline(shot.scene, shot.tracks, view_shot(shot))
    appearance = estimate_clip_appearance(estimate_hidden_background(timeline, opened_clip), opened_clip)
    preparation = time.process_time() - start
    moving = np.flatnonzero(appearance.timeline.moving.any(axis=1))
    rows = set(moving[np.linspace(0, len(moving) - 1, GAPS).round().astype(int)].tolist())
    costs, before = [], None
    for row, (_, image) in enumerate(read_frames(opened_clip, indices=appearance.timeline.frame)):
        if before is not None and row - 1 in rows:
            costs.append(measure_gap(appearance, row - 1, before, image))
        before = image
    return (opened_clip.width, opened_clip.height), preparation, np.array(costs)


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation on a sample clip of 720p."""
    _, _, costs = measure_clip(QUICK_CLIP)
    gap, frame = 1e3 * costs.T
    return [
        state_cost("CPU time to prepare a gap, median", float(np.median(gap)), "ms", len(gap)),
        state_cost("CPU time of a frame in it, median", float(np.median(frame)), "ms", len(frame)),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", type=Path, help="clips; default: three real ones")
    add_quick_option(parser)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if arguments.quick:
        inputs = f"`{QUICK_CLIP.name}`, 1280 x 720, factor {FACTOR}, {GAPS} gaps; noise: twice the time, for the load"
        run_quick("interpolation.interpolation_cost", measure_figures, inputs, alone=True)
        return 0
    clips = arguments.clips or [FOOTAGE / f"{name}.mp4" for name in CLIPS]
    print("| clip | size | preparation s | gap ms | most | frame ms | most |\n|---|---|---|---|---|---|---|")
    for clip in clips:
        (width, height), preparation, costs = measure_clip(clip)
        gap, frame = 1e3 * costs.T
        cells = f"{gap.mean():.0f} | {gap.max():.0f} | {frame.mean():.1f} | {frame.max():.1f}"
        print(f"| {clip.stem} | {width}x{height} | {preparation:.2f} | {cells} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
