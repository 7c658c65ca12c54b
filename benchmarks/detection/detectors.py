"""Measure recall, precision and errors of the Hough detector and the network on rendered images and on real footage.

    python -m benchmarks.detection.detectors [--quick] [--model FILE.onnx] [--images 24]
        [--sets rendered,other,low,high,stills,pool,carom] [--detectors hough,onnx]

`rendered` images show scenes of kinds that training never uses (cloth, lamp, camera, ball set). `other` ones have
another seed, for choosing between variants; `low` and `high` ones are seen from 18 to 25 and from 75 to 88 degrees.
`stills`, `pool` and `carom` are those of ../shared/data; no training used them, and they are skipped where they are
absent. Takes minutes.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.detection.detector_cases import (
    DATA,
    HIGH_ELEVATION,
    LOW_ELEVATION,
    DetectorCase,
    match_still_classes,
    read_carom_cases,
    read_pool_cases,
    read_still_cases,
    render_cases,
)
from benchmarks.detection.detector_scores import HEADER, DetectorTally, format_row, score_detections
from benchmarks.support.figures import Figure, add_quick_option, estimate_rms, estimate_share, run_quick
from detectors.hough.hough_detector import HoughDetector, build_hough_detector
from detectors.network.ball_model import SHIPPED_BALL_MODEL, BallModel, open_ball_model
from detectors.network.network_detector import NetworkDetector, build_network_detector

QUICK_IMAGES = 8


def measure_figures(model: BallModel) -> list[Figure]:
    """Measure the figures of the documentation on rendered images of kinds that training never uses."""
    tallies = {detector: DetectorTally() for detector in ("hough", "onnx")}
    prepared: dict[tuple[str, int], PreparedDetector] = {}
    for case in render_cases(QUICK_IMAGES):
        for detector, tally in tallies.items():
            _run_case(case, detector, model, tally, prepared)
    figures = []
    for name, tally in tallies.items():
        true = tally.detections - tally.false_positives
        figures += [
            estimate_share(f"{name}: balls found", tally.hits, tally.required),
            estimate_share(f"{name}: detections that are balls", true, tally.detections),
            estimate_rms(f"{name}: error of centres per axis, RMS", np.array(tally.centre_errors)[:, :2], "px"),
        ]
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("--model", type=Path, default=SHIPPED_BALL_MODEL, help="ONNX file of the network")
    parser.add_argument("--images", type=int, default=24, help="rendered images per set (default 24)")
    parser.add_argument("--sets", default="rendered,stills,pool,carom", help="names of the sets, separated by commas")
    parser.add_argument("--detectors", default="hough,onnx", help="detectors, separated by commas")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    model = open_ball_model(arguments.model)
    if arguments.quick:
        inputs = f"{QUICK_IMAGES} images of the set `rendered`, seed of the set; balls are the cases"
        run_quick("detection.detectors", lambda: measure_figures(model), inputs)
        return
    sources = {
        "rendered": lambda: render_cases(arguments.images),
        "other": lambda: render_cases(arguments.images, 99),
        "low": lambda: render_cases(arguments.images, 77, LOW_ELEVATION),
        "high": lambda: render_cases(arguments.images, 78, HIGH_ELEVATION),
        "stills": read_still_cases,
        "pool": read_pool_cases,
        "carom": read_carom_cases,
    }
    print(HEADER)
    for name in arguments.sets.split(","):
        if name in ("stills", "pool", "carom") and not DATA.is_dir():
            print(f"{name}: skipped, {DATA} does not exist")
            continue
        tallies = {detector: DetectorTally() for detector in arguments.detectors.split(",")}
        prepared: dict[tuple[str, int], PreparedDetector] = {}
        for case in sources[name]():
            for detector, tally in tallies.items():
                _run_case(case, detector, model, tally, prepared)
        for detector, tally in tallies.items():
            print(format_row(f"{name} {detector}", tally), flush=True)
        if name == "stills":
            pairs = Counter(match_still_classes())
            right = sum(count for (label, detected), count in pairs.items() if label == detected)
            wrong = ", ".join(
                f"{label} as {detected} {n}" for (label, detected), n in sorted(pairs.items()) if label != detected
            )
            print(f"ball classes of the stills: {right} of {pairs.total()} right; {wrong or 'none wrong'}", flush=True)


@dataclass(frozen=True)
class PreparedDetector:
    """A detector and its background frames; keeping both alive keeps their id() unique."""

    detector: HoughDetector | NetworkDetector
    images: list[tuple[int, NDArray[np.uint8]]]


def _run_case(
    case: DetectorCase,
    name: str,
    model: BallModel,
    tally: DetectorTally,
    prepared: dict[tuple[str, int], PreparedDetector],
) -> None:
    key = (name, id(case.background_frames))
    if key not in prepared:
        prepared.clear() if len(prepared) > 3 else None
        if name == "hough":
            detector = build_hough_detector(case.scene, case.background_frames)
        else:
            detector = build_network_detector(case.scene, case.background_frames, model)
        prepared[key] = PreparedDetector(detector, case.background_frames)
    start = time.process_time()
    detections = prepared[key].detector.detect(case.rgb, case.frame)
    tally.seconds += time.process_time() - start
    tally.images += 1
    score_detections(case, detections, tally)


if __name__ == "__main__":
    main()
