"""Measure the CPU time of ball detection per frame of a clip on one core, for Hough and the network.

    python -m benchmarks.detection.detector_speed [--quick] [CLIP ...] [--model FILE.onnx] [--frames 120]

Without CLIPs, three real ones of ../shared/data; takes about a minute. Table localisation, the estimate of the cloth
and decoding are not counted. Everything else is: differences to the frame before, the network, circles, streaks and
colours. Goal of the network: 25 ms at 720p.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.detection.detector_cases import DATA
from benchmarks.support.figures import ROOT, Figure, add_quick_option, run_quick, state_cost
from detectors.detect import BallDetector, prepare_detector
from detectors.detect_options import DetectOptions
from detectors.network.ball_model import SHIPPED_BALL_MODEL
from video.calibration.table_finder import calibrate_clip
from video.io.clip import Clip, open_clip, read_frames
from video.io.video_options import CalibrateOptions

CLIPS = ("snooker_null_grad_stoss_1_0003_0009", "pool8_game2_clip1", "carom_F1")


QUICK_CLIP, QUICK_FRAMES = ROOT / "sample_videos" / "many_contacts.mp4", 40


def measure_figures(model: Path) -> list[Figure]:
    """Measure the figures of the documentation on a sample clip of 720p."""
    clip = open_clip(QUICK_CLIP)
    scene = calibrate_clip(clip, CalibrateOptions())
    figures = []
    for name in ("hough", "onnx"):
        spent, _ = _measure_detector(prepare_detector(clip, scene, DetectOptions(name, str(model))), clip, QUICK_FRAMES)
        figures.append(state_cost(f"{name}: CPU time per frame, median", float(np.median(spent)), "ms", len(spent)))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("clips", nargs="*", type=Path, metavar="CLIP")
    parser.add_argument("--model", type=Path, default=SHIPPED_BALL_MODEL)
    parser.add_argument("--frames", type=int, default=120, help="number of frames from the first on (default 120)")
    arguments = parser.parse_args()
    clips = arguments.clips or [DATA / "billiards" / f"{name}.mp4" for name in CLIPS]
    cv2.setNumThreads(1)
    if arguments.quick:
        inputs = (
            f"the first {QUICK_FRAMES} frames of `{QUICK_CLIP.name}`, 1280 x 720; noise: twice the time, for the load"
        )
        run_quick("detection.detector_speed", lambda: measure_figures(arguments.model), inputs, alone=True)
        return
    print(
        "| clip | image | detector | median ms | mean | 90 % below | balls per frame |\n|---|---|---|---|---|---|---|"
    )
    for path in clips:
        if not path.is_file():
            print(f"{path.stem}: skipped, {path} does not exist")
            continue
        clip = open_clip(path)
        scene = calibrate_clip(clip, CalibrateOptions())
        for name in ("hough", "onnx"):
            detector = prepare_detector(clip, scene, DetectOptions(name, str(arguments.model)))
            spent, balls = _measure_detector(detector, clip, arguments.frames)
            low, high = np.median(spent), np.quantile(spent, 0.9)
            print(
                f"| {path.stem} | {clip.width} x {clip.height} | {name} | {low:.1f} | {spent.mean():.1f} | {high:.1f} "
                f"| {balls:.1f} |",
                flush=True,
            )


def _measure_detector(detector: BallDetector, clip: Clip, count: int) -> tuple[np.ndarray, float]:
    """Return CPU milliseconds (n,) of each of the first frames, and the mean number of detections."""
    spent, balls = [], 0
    memory: Any = None
    for frame, rgb in islice(read_frames(clip, indices=clip.distinct_frames[:count]), count):
        start = time.process_time()
        detections, memory = detector.detect_next(rgb, frame, memory)
        spent.append(1e3 * (time.process_time() - start))
        balls += len(detections)
    return np.array(spent), balls / len(spent)


if __name__ == "__main__":
    main()
