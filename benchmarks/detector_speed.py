"""What finding balls costs on one core, picture by picture of a clip: CPU time of Hough and the network side by side.

    python benchmarks/detector_speed.py [CLIP ...] [--model FILE.onnx] [--pictures 120]

Without CLIPs three real ones. Finding the table and learning its cloth are done before, and decoding is not counted.
All else is: what changed since the picture before, the network, circles, streaks, colours. Asked of the network: 25 ms
at 720p.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import islice
from pathlib import Path

# A script's own folder comes first, and there `detectors.py` hides the package of the same name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
from detector_cases import DATA

from detectors.detect import Detector, hough_detector, network_detector
from detectors.network.network_file import SHIPPED
from detectors.options import DetectOptions
from video.calibration.table_finder import find_scene
from video.io.clip import Clip, open_clip, read_frames
from video.io.options import CalibrateOptions

CLIPS = ("snooker_null_grad_stoss_1_0003_0009", "pool8_game2_clip1", "carom_F1")


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("clips", nargs="*", type=Path, metavar="CLIP")
    asked.add_argument("--model", type=Path, default=SHIPPED)
    asked.add_argument("--pictures", type=int, default=120, help="from the first on (default 120)")
    given = asked.parse_args()
    clips = given.clips or [DATA / "billiards" / f"{name}.mp4" for name in CLIPS]
    cv2.setNumThreads(1)
    options = DetectOptions(model=str(given.model))
    print(
        "| clip | picture | detector | median ms | mean | 90 % below | balls a picture |\n|---|---|---|---|---|---|---|"
    )
    for path in clips:
        if not path.is_file():
            print(f"{path.stem}: left out, {path} is not there")
            continue
        clip = open_clip(path)
        scene = find_scene(clip, CalibrateOptions())
        for name, made in (("hough", hough_detector), ("onnx", network_detector)):
            spent, balls = _timed(made(clip, scene, options), clip, given.pictures)
            low, high = np.median(spent), np.quantile(spent, 0.9)
            print(
                f"| {path.stem} | {clip.width} x {clip.height} | {name} | {low:.1f} | {spent.mean():.1f} | {high:.1f} "
                f"| {balls:.1f} |",
                flush=True,
            )


def _timed(detector: Detector, clip: Clip, most: int) -> tuple[np.ndarray, float]:
    """ms (n,) of CPU time for each of the first pictures, and how many balls were found in one."""
    spent, balls, memory = [], 0, None
    for frame, rgb in islice(read_frames(clip, indices=clip.distinct[:most]), most):
        start = time.process_time()
        found, memory = detector.follow(rgb, frame, memory)
        spent.append(1e3 * (time.process_time() - start))
        balls += len(found)
    return np.array(spent), balls / len(spent)


if __name__ == "__main__":
    main()
