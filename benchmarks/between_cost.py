"""What in-between frames cost on one core: CPU time to open a gap, and for each of seven frames in it.

    python -m benchmarks.between_cost [CLIP ...]

As a module, for `detectors` is the room here, not the script beside this one. Without CLIPs three real ones. Decoding
and encoding are not counted; what is learnt from the whole clip is told apart.
Asked: 25 ms a frame and 150 ms a gap at 720p.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from models.core.progress import Progress, silent
from pipeline.chain import fit_graph, fitted
from pipeline.engine.result_cache import Cache, default_root
from pipeline.options import RunOptions
from video.io.clip import read_frames
from video.matting.ball_timeline import sight
from video.overlay.ball_outlines import balls_at
from video.synthesis.frame_synthesis import Scenery, open_interval, scenery_of

FOOTAGE = Path(__file__).resolve().parents[2] / "shared" / "data" / "billiards"
FACTOR, GAPS = 8, 12
CLIPS = ("snooker_null_grad_stoss_1_0003_0009", "pool8_game2_clip1", "carom_F1")


class Silent:
    """A watcher that hears nothing."""

    def started(self, stage: str) -> Progress:
        return silent

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        pass


def gap_costs(scenery: Scenery, row: int, first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """s of CPU to open a gap, and per frame in it."""
    sightings, start = scenery.sightings, time.process_time()
    interval = open_interval(sightings, scenery.plate, row, first, second, sharp=scenery.sharp)
    begin, end = sightings.t[[row, row + 1]]
    times = begin + (end - begin) * np.arange(1, FACTOR) / FACTOR
    state, ways = sightings.state(times), sightings.ways(times, sightings.exposure)
    opened = time.process_time()
    for t, balls, way in zip(times.tolist(), balls_at(sightings, state, times), ways, strict=True):
        interval.at(t, balls.centre, way)
    return opened - start, (time.process_time() - opened) / len(times)


def clip_costs(clip: Path) -> tuple[tuple[int, int], float, np.ndarray]:
    """Size, s of CPU to learn the clip, and costs (gaps, 2)."""
    seen, *shot = fitted(fit_graph(clip, RunOptions()), clip, Cache(default_root()), Silent())
    start = time.process_time()
    scenery = scenery_of(sight(*shot), seen)
    learnt = time.process_time() - start
    moving = np.flatnonzero(scenery.sightings.moves.any(axis=1))
    rows = set(moving[np.linspace(0, len(moving) - 1, GAPS).round().astype(int)].tolist())
    costs, before = [], None
    for row, (_, picture) in enumerate(read_frames(seen, indices=scenery.sightings.frame)):
        if before is not None and row - 1 in rows:
            costs.append(gap_costs(scenery, row - 1, before, picture))
        before = picture
    return (seen.width, seen.height), learnt, np.array(costs)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", type=Path)
    clips = parser.parse_args().clips or [FOOTAGE / f"{name}.mp4" for name in CLIPS]
    cv2.setNumThreads(1)
    print("| clip | size | learnt s | gap ms | most | frame ms | most |\n|---|---|---|---|---|---|---|")
    for clip in clips:
        (width, height), learnt, costs = clip_costs(clip)
        gap, frame = 1e3 * costs.T
        cells = f"{gap.mean():.0f} | {gap.max():.0f} | {frame.mean():.1f} | {frame.max():.1f}"
        print(f"| {clip.stem} | {width}x{height} | {learnt:.2f} | {cells} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
