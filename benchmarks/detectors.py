"""How well the detectors find balls: Hough and the network side by side, on drawn halls and on real footage.

    python benchmarks/detectors.py [--model FILE.onnx] [--pictures 24] [--sets drawn,other,low,high,stills,pool,carom]

Drawn pictures show halls of a kind that training never shows (cloth, lamp, camera, set of balls). `other` ones have
another seed, to choose by; `low` and `high` ones are seen from 18 to 25 and from 75 to 88 degrees. The real ones are
those of ../shared/data; no picture of them was used for training, and a set is left out where they are absent.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

# A script's own folder comes first, and there this file hides the package of the same name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
from detector_cases import (
    DATA,
    HIGH_ELEVATION,
    LOW_ELEVATION,
    Case,
    carom_cases,
    drawn_cases,
    named_in_stills,
    pool_cases,
    still_cases,
)
from detector_scores import HEADER, Tally, line, score
from numpy.typing import NDArray

from detectors.apparent_ball_size import with_seen_size
from detectors.hough.hough_detector import BallFinder, ball_finder
from detectors.network.network_detector import NetworkFinder, network_finder
from detectors.network.network_file import SHIPPED, BallModel, open_model


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--model", type=Path, default=SHIPPED)
    asked.add_argument("--pictures", type=int, default=24)
    asked.add_argument("--sets", default="drawn,stills,pool,carom")
    asked.add_argument("--detectors", default="hough,onnx")
    given = asked.parse_args()
    cv2.setNumThreads(1)
    model = open_model(given.model)
    sources = {
        "drawn": lambda: drawn_cases(given.pictures),
        "other": lambda: drawn_cases(given.pictures, 99),
        "low": lambda: drawn_cases(given.pictures, 77, LOW_ELEVATION),
        "high": lambda: drawn_cases(given.pictures, 78, HIGH_ELEVATION),
        "stills": still_cases,
        "pool": pool_cases,
        "carom": carom_cases,
    }
    print(HEADER)
    for name in given.sets.split(","):
        if name in ("stills", "pool", "carom") and not DATA.is_dir():
            print(f"{name}: left out, {DATA} is not there")
            continue
        tallies = {detector: Tally() for detector in given.detectors.split(",")}
        finders: dict[tuple[str, int], Learnt] = {}
        for case in sources[name]():
            for detector, tally in tallies.items():
                _run(case, detector, model, tally, finders)
        for detector, tally in tallies.items():
            print(line(f"{name} {detector}", tally), flush=True)
        if name == "stills":
            pairs = Counter(named_in_stills())
            right = sum(count for (said, found), count in pairs.items() if said == found)
            wrong = ", ".join(f"{said} as {found} {n}" for (said, found), n in sorted(pairs.items()) if said != found)
            print(f"kinds of the stills: {right} of {pairs.total()} right; {wrong or 'none wrong'}", flush=True)


@dataclass(frozen=True)
class Learnt:
    """A detector and the pictures it learnt from: while it is kept, no others have their address."""

    finder: BallFinder | NetworkFinder
    pictures: list[tuple[int, NDArray[np.uint8]]]


def _run(case: Case, detector: str, model: BallModel, tally: Tally, finders: dict[tuple[str, int], Learnt]) -> None:
    key = (detector, id(case.learnt))
    if key not in finders:
        finders.clear() if len(finders) > 3 else None
        if detector == "hough":
            made = ball_finder(with_seen_size(case.scene, case.learnt[:3]), case.learnt)
        else:
            made = network_finder(case.scene, case.learnt, model)
        finders[key] = Learnt(made, case.learnt)
    start = time.process_time()
    found = finders[key].finder.look(case.rgb, case.frame)
    tally.seconds += time.process_time() - start
    tally.pictures += 1
    score(case, found, tally)


if __name__ == "__main__":
    main()
