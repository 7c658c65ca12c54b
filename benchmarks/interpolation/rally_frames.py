"""Withhold frames of rallies, interpolate them, and compare the ball or shuttle with that of rivals.

    python -m benchmarks.interpolation.rally_frames [--step 2] [--gaps 40] [--seed 947] [-o DIR] [--sport badminton]

Prints the PSNR within 12 px (at 720 lines) of the true place of the object, for trueroll, a cross-fade, DIS flow both
ways and ffmpeg's minterpolate, over withheld frames in which the object moves further than that disc. The clips are the
shared badminton rally, whose shuttle was marked by hand, and a rendered rally, whose truth is known. DIR gets the
frames around the object side by side: truth, trueroll, and the rivals. Takes some minutes per clip.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from benchmarks.court_cases.court_clips import CourtCase, read_truth, render_case
from benchmarks.interpolation.frame_scores import to_decibels
from benchmarks.interpolation.interpolation import make_plain_rivals
from benchmarks.interpolation.withheld_frames import interpolate_with_trueroll, read_all_frames, withhold
from benchmarks.support.run_folder import FOOTAGE
from models.core.typing import FloatArray

# px at 720 lines: radius of the disc that is compared; a shuttle measures up to 8 px, its streak more.
DISC_PX = 12.0
MARKED = FOOTAGE.parent / "courts" / "badminton_1_00_01"
SHEET_PX, SHEET_ROWS = 40, 24


def read_marks(folder: Path) -> FloatArray:
    """Read where the object is in every frame (T, 2), px; NaN where it is not seen."""
    if (folder / "truth.npz").exists():
        columns = read_truth(folder).columns
        return np.where(columns["is_visible"][:, None], columns["px"], np.nan)
    # the file lacks the first frame of those that were marked
    _, seen, x, y = np.loadtxt(folder / "shuttle.csv", delimiter=",", skiprows=2).T
    return np.where(seen[:, None] > 0, np.column_stack([x, y]), np.nan)


def compare_clip(folder: Path, step: int, most: int, target: Path) -> Iterator[str]:
    """Withhold frames of a clip, and yield one row per method."""
    withheld, px = withhold(folder / "clip.mp4", step, target), read_marks(folder)
    frames = read_all_frames(withheld)
    radius = DISC_PX * frames[0].shape[0] / 720
    places = []
    for place in withheld.withheld_places():
        first = place // step * step
        near = px[withheld.frames[[first, place, first + step]]]
        if np.isfinite(near).all() and min(np.linalg.norm(near[1] - near[[0, 2]], axis=1)) > radius:
            places.append(place)
    places = sorted(np.random.default_rng(7).permutation(places)[:most].tolist())
    made = {"trueroll": dict(enumerate(interpolate_with_trueroll(withheld)))}
    made |= make_plain_rivals(withheld, frames, places)
    height, width = frames[0].shape[:2]
    across, down = np.meshgrid(np.arange(width), np.arange(height))
    for method, own in made.items():
        errors = []
        for place in places:
            x, y = px[withheld.frames[place]]
            disc = np.hypot(across - x, down - y) < radius
            errors.append(np.mean((own[place][disc].astype(float) - frames[place][disc]) ** 2))
        yield f"{folder.name:28} {method:14} {to_decibels(float(np.mean(errors))):6.1f} dB  {len(places)} frames"
    cv2.imwrite(str(target / f"{folder.name}.png"), _draw_sheet(frames, made, places, px[withheld.frames]))


def _draw_sheet(
    frames: list[np.ndarray], made: dict[str, dict[int, np.ndarray]], places: list[int], px: FloatArray
) -> np.ndarray:
    """Draw the surroundings of the object, a row per frame: truth, then every method."""
    rows = []
    for place in places[:SHEET_ROWS]:
        cells = [cv2.getRectSubPix(image, (SHEET_PX, SHEET_PX), tuple(px[place].tolist()))
                 for image in (frames[place], *(own[place] for own in made.values()))]  # fmt: skip
        rows.append(cv2.resize(np.hstack(cells), None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST))
    return cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR)


def main() -> None:
    """Compare the methods on both clips."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--step", type=int, default=2)
    parser.add_argument("--gaps", type=int, default=40)
    parser.add_argument("--seed", type=int, default=947)
    parser.add_argument("--sport", default="badminton")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/rally_frames"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    case = CourtCase(given.sport, 0, given.seed, (2, 3))
    for folder in (MARKED, render_case(case, given.out)):
        for row in compare_clip(folder, given.step, given.gaps, given.out):
            print(row, flush=True)


if __name__ == "__main__":
    main()
