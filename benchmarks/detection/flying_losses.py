"""Where the object of rendered rallies is lost, and what a frame costs: spots, network, choice of places.

    python -m benchmarks.detection.flying_losses [--rallies 2] [--seed 1] [--sport tennis] [--out out/courts]

Clips are those of `benchmarks.courts` of the same seed; the camera is the true one. Of the frames that show the object,
it prints in how many a spot of motion, a candidate, and the most probable candidate lies on it, and in how many frames
a candidate of at least 1/2 lies elsewhere.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np

from benchmarks.court_cases.court_clips import CourtCase, CourtTruth, read_truth, render_case
from benchmarks.court_cases.court_scores import FALSE_PX, FOUND_PX, find_visible
from benchmarks.courts import SPORTS
from detectors.flying.find_candidates import find_candidates
from detectors.flying.frame_windows import list_windows
from detectors.flying.motion_spots import find_window_spots
from detectors.flying.object_size import choose_scale, outline_of_play
from detectors.training.flying_samples import judge_spots
from video.io.clip import Clip, open_clip


@dataclass(frozen=True, slots=True)
class LossCount:
    """Frames of one clip, or of many, and CPU s of the search."""

    frames: int
    visible: int
    spot: int
    candidate: int
    first: int
    false: int
    seconds: float


def count_losses(truth: CourtTruth) -> LossCount:
    """Count in how many frames of a clip each step of the search has the object."""
    clip, columns, is_visible = open_clip(truth.folder / "clip.mp4"), truth.columns, find_visible(truth)
    start = time.process_time()
    found = find_candidates(clip, truth.scene)
    seconds = time.process_time() - start
    unit = truth.stated["width"] / 1280
    off = np.linalg.norm(found.centre - columns["px"][found.frame], axis=1) / unit
    is_first = np.diff(found.frame, prepend=-1) > 0
    frames = {
        "candidate": found.frame[off < FOUND_PX],
        "first": found.frame[(off < FOUND_PX) & is_first],
        "false": found.frame[~(off < FALSE_PX) & (found.score >= 0.5)],
    }
    counts = {name: len(np.unique(rows)) for name, rows in frames.items() if name == "false"}
    counts |= {name: int(is_visible[np.unique(rows)].sum()) for name, rows in frames.items() if name != "false"}
    return LossCount(len(is_visible), int(is_visible.sum()), _count_spots(truth, clip), **counts, seconds=seconds)


def _count_spots(truth: CourtTruth, clip: Clip) -> int:
    """Count the visible frames in which a spot lies on the object."""
    scale, columns, count = choose_scale(truth.scene), truth.columns, 0
    is_visible = find_visible(truth)
    for window in list_windows(clip, truth.scene.camera, scale):
        k = window.frame
        if is_visible[k]:
            spots = find_window_spots(window, outline_of_play(truth.scene, scale, k))
            centre, streak = (columns["px"][k] + 0.5) * scale - 0.5, columns["streak"][k] * scale
            count += bool(len(spots) and judge_spots(spots, centre, streak, 1.0)[0].any())
    return count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rallies", type=int, default=2, help="per sport")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sport", action="append", choices=SPORTS)
    parser.add_argument("--out", type=Path, default=Path("out/courts"))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    for sport in options.sport or SPORTS:
        cases = [CourtCase(sport, number, options.seed, (2, 6)) for number in range(options.rallies)]
        counts = [count_losses(read_truth(render_case(case, options.out))) for case in cases]
        for name, one in [*zip((case.name for case in cases), counts, strict=True), (sport, add_counts(counts))]:
            seen = max(one.visible, 1)
            print(
                f"{name:24} visible {one.visible}/{one.frames}: spot {one.spot / seen:.1%}, candidate "
                f"{one.candidate / seen:.1%}, first {one.first / seen:.1%}; false at 1/2 or more "
                f"{one.false / one.frames:.1%}; {1000 * one.seconds / one.frames:.1f} CPU ms a frame",
                flush=True,
            )


def add_counts(counts: list[LossCount]) -> LossCount:
    """Add the counts of clips."""
    return LossCount(*(sum(getattr(one, column.name) for one in counts) for column in fields(LossCount)))


if __name__ == "__main__":
    main()
