"""Compare names and colours of balls in run folders with the clips and their truth.

    python -m benchmarks.detection.ball_looks [--measure] RUN_FOLDER...

With --measure, names and colours are measured now on the tracks of the run, not read from it.

The truth of a sample clip, `CLIP.truth.json` and `CLIP.truth.csv` beside it, states the number of each pool ball; that
of a clip of ../shared/data, `CLIP.gt.json`, its class alone. A name is right if it has the number or the colour of the
ball, and, where it states them, the class; a ball that is only called solid, stripe or ball has no name. The colour
difference is CIEDE2000 between the colour that plans draw and the median of the unshaded painted pixels of the ball in
the frames in which it is sharp and apart: in one frame alone, a cushion, a highlight or the coarse colour of the codec
decide as often as the paint.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from skimage.color import deltaE_ciede2000, rgb2lab

from detectors.measurement.ball_paint import look_at_balls, select_clear_frames
from models.core.tracks import Tracks
from models.core.typing import ByteArray, FloatArray, IntArray
from pipeline.editing.edited_clip import find_edited_clip
from pipeline.io.saved_shot import read_shot
from video.io.clip import open_clip, read_frames

# Colours of the numbers 1 to 7, and of 9 to 15; 4 and 12 are pink in sets for television.
COLOURS = ({"yellow"}, {"blue"}, {"red"}, {"purple", "pink"}, {"orange"}, {"green"}, {"maroon", "brown"})
# Ball class by the number of the class of a box.
BOX_KINDS = ("", "cue", "eight", "solid", "stripe")
# Classes of balls that are white.
UNPAINTED = ("cue", "white")
# Level from which two channels of a pixel no longer show its hue; share of the other pixels from which they count.
OVEREXPOSED, MIN_EXPOSED = 250, 0.1
# Share of the pixels of a ball in shade, and of those in the highlight.
SHADE, HIGHLIGHT = 0.4, 0.1
# Distance from white, with half the weight of L*, as a share of the largest of a ball, below which a pixel is white or
# mixed with it in the coded picture.
UNMIXED = 0.75


def collect_pixels(frames: dict[int, ByteArray], tracks: Tracks, rows: IntArray, ball: int) -> FloatArray:
    """Collect the pixels (n, 3), sRGB, of a ball in rows of its tracks."""
    pixels = []
    for row in rows:
        frame, centre, radius = frames[int(tracks.frame[row])], tracks.px[row, ball], tracks.radius_px[row, ball]
        y, x = np.mgrid[: frame.shape[0], : frame.shape[1]]
        pixels.append(frame[np.hypot(x - centre[0], y - centre[1]) < 0.7 * radius].astype(float))
    return np.concatenate(pixels)


def measure_colour(pixels: FloatArray, white: FloatArray | None = None) -> FloatArray:
    """Measure the median sRGB (3,) of unshaded pixels (n, 3); with the sRGB of `white`, of the painted ones."""
    if white is not None:
        exposed = pixels[np.sum(pixels >= OVEREXPOSED, axis=1) < 2]
        pixels = exposed if len(exposed) > MIN_EXPOSED * len(pixels) else pixels
        lab = rgb2lab(np.vstack([pixels, white])[None] / 255)[0]
        apart = np.linalg.norm((lab[:-1] - lab[-1]) * [0.5, 1.0, 1.0], axis=1)
        pixels = pixels[apart >= UNMIXED * np.quantile(apart, 0.95)]
    brightness = pixels.sum(axis=1)
    low, high = np.quantile(brightness, [SHADE, 1 - HIGHLIGHT])
    return np.asarray(np.median(pixels[(brightness >= low) & (brightness <= high)], axis=0))


def compare_colours(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the CIEDE2000 differences (N,) of sRGB colours (N, 3)."""
    return np.asarray(deltaE_ciede2000(rgb2lab(np.asarray(one) / 255), rgb2lab(np.asarray(two) / 255)))


def read_truth(clip: Path) -> tuple[FloatArray, list[str]]:
    """Read the places (N, 2) px of the balls in the first frame, and their ids, such as `solid-3`, or classes."""
    sample, boxes = clip.with_suffix(".truth.csv"), clip.with_suffix(".gt.json")
    if sample.is_file():
        with sample.open() as file:
            rows = [row for row in csv.DictReader(file) if row["frame"] == "0"]
        return np.array([[float(row["x_px"]), float(row["y_px"])] for row in rows]), [row["id"] for row in rows]
    first = json.loads(boxes.read_text()).get("boxes", {}).get("first", []) if boxes.is_file() else []
    corners = np.array([box[:4] for box in first], float).reshape(-1, 4)
    return corners[:, :2] + corners[:, 2:] / 2, [BOX_KINDS[box[4]] for box in first]


def judge_name(name: str, number: int, truth: str) -> str:
    """Judge the name and number of a ball: right, wrong, WRONG NUMBER, or none."""
    kind, _, text = truth.partition("-")
    words = set(name.split())
    if kind not in ("solid", "stripe"):
        return "right" if (kind == "eight") == ("8" in words) and (kind == "cue") == ("cue" in words) else "wrong"
    is_wrong_class = bool({"solid", "stripe"} & words - {kind}) or (number != 0 and (number > 8) != (kind == "stripe"))
    if not text:
        return "wrong" if is_wrong_class else "right"
    if number not in (0, int(text)):
        return "WRONG NUMBER"
    if not words & set().union(*COLOURS):
        return "none"
    return "right" if words & COLOURS[(int(text) - 1) % 8] and not is_wrong_class else "wrong"


def print_run(folder: Path, total: Counter[str], is_measured: bool) -> list[float]:
    """Print names and colour differences of a run; return the differences."""
    shot, clip = read_shot(folder), open_clip(find_edited_clip(folder, None).path)
    tracks: Tracks = shot.tracks
    if is_measured:
        tracks = replace(tracks, looks=look_at_balls(clip, shot.scene, tracks))
    places, truth = read_truth(clip.path)
    rows = select_clear_frames(tracks, shot.scene.table.ball_radius)
    frames = dict(read_frames(clip, indices=np.unique(tracks.frame[np.concatenate(rows)])))
    whites = (look.colour for kind, look in zip(tracks.kinds, tracks.looks, strict=True) if kind in UNPAINTED)
    differences, white = [], np.array(next(whites, (255,) * 3))
    print(f"\n{clip.path.name}")
    for ball, (own, look) in enumerate(zip(rows, tracks.looks, strict=True)):
        pixels, radius = collect_pixels(frames, tracks, own, ball), float(np.median(tracks.radius_px[own, ball]))
        shown = measure_colour(pixels, None if tracks.kinds[ball] in UNPAINTED else white)
        difference = float(compare_colours(np.array([look.colour]), shown[None])[0])
        start = tracks.px[np.flatnonzero(tracks.is_observed[:, ball])[0], ball]
        gap = np.linalg.norm(places - start, axis=1) if len(places) else np.array([np.inf])
        verdict = "no truth" if gap.min() > radius else judge_name(look.name, look.number, truth[int(gap.argmin())])
        total[verdict] += 1
        differences.append(difference)
        true_name = "" if verdict == "no truth" else truth[int(gap.argmin())]
        print(f"  {tracks.ids[ball]:10} {look.name:16} {true_name:10} {verdict:12} colour difference {difference:4.1f}")
    return differences


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, metavar="RUN_FOLDER")
    parser.add_argument("--measure", action="store_true", help="measure names and colours now")
    total: Counter[str] = Counter()
    chosen = parser.parse_args(arguments)
    differences = [value for folder in chosen.folders for value in print_run(folder, total, chosen.measure)]
    if differences:
        print(f"\nnames: {', '.join(f'{count} {verdict}' for verdict, count in total.most_common())}")
        print(f"colour differences: median {np.median(differences):.1f}, largest {max(differences):.1f}, "
              f"{np.mean(np.array(differences) < 5):.0%} below 5")  # fmt: skip


if __name__ == "__main__":
    main()
