"""Check clips with one fault each, or none: does `trueroll check` name the fault?

    python -m benchmarks.clips.filming_checks [--quick] [--clips 200] [--seed 1] [--rows FILE.csv] [--minutes 60]
        [--keep DIR]

The clips are parts of the rendered sample clips, played at 50 or 60 fps, mirrored, resized, with other brightness
and colours; one fault of random strength is added, by operations on the frames or by the encoder. Takes about 5 s a
clip; --rows continues an interrupted run. Prints the confusion table: fault of the clip against the first fault named.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.stress_cases.video_damage import blur_streak
from benchmarks.support.figures import Figure, add_quick_option, estimate_share, run_quick
from benchmarks.support.row_files import append_row, read_rows
from benchmarks.support.run_folder import ROOT
from pipeline.actions.check_clip import check_clip
from pipeline.reporting.text.filming_sentences import rank_faults
from video.filming_check.measure_filming import CODES
from video.io.clip import open_clip, read_frames
from video.io.video_writer import VideoWriter

Image = NDArray[np.uint8]

# Frames of a clip before the fault: two thirds of a second, from shortly before the strike on.
FRAMES = 40
# Frames per second up to which a sample clip is played twice as fast.
SLOW_RATE = 50
NONE = "none"
SMALL_CRF, TIME_BASE = 18, Fraction(1, 90_000)
GOAL = 0.95
# One round through all faults.
QUICK_CLIPS = 14


@dataclass(frozen=True)
class FilmedPart:
    """Frames of a clip, their times (s), rate, and the true balls of each frame."""

    frames: list[Image]
    t: NDArray[np.float64]
    rate: float
    balls: list[list[tuple[NDArray[np.float64], NDArray[np.float64], float]]]
    """Centre (2,) px, motion to the next frame (2,) px and radius (px) of the moving balls of each frame."""
    radius: float
    """px, smallest radius of a ball."""
    crf: int = SMALL_CRF


@dataclass(frozen=True)
class CheckedRow:
    """Answer on one clip."""

    number: int
    clip: str
    fault: str
    strength: float
    verdict: str
    named: str
    """The first fault that was named."""
    all_named: str
    seconds: float


def read_sample(name: str) -> FilmedPart:
    """Read the part of a sample clip around the strike, at 50 or 60 fps, with its true balls."""
    clip = open_clip(ROOT / "sample_videos" / f"{name}.mp4")
    first = max(int(np.searchsorted(clip.t, 0.45)) - 6, 0)
    wanted = np.arange(first, min(first + FRAMES, clip.frame_count))
    frames = [image for _, image in read_frames(clip, indices=wanted)]
    places: dict[tuple[int, str], tuple[float, float, float]] = {}
    with (ROOT / "sample_videos" / f"{name}.truth.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            places[int(row["frame"]), row["id"]] = (float(row["x_px"]), float(row["y_px"]), float(row["radius_px"]))
    names = sorted({ball for _, ball in places})
    balls = []
    for frame in wanted.tolist():
        moving = []
        for ball in names:
            here, after = places.get((frame, ball)), places.get((frame + 1, ball))
            if here is not None and after is not None and np.hypot(after[0] - here[0], after[1] - here[1]) > 1:
                moving.append((np.array(here[:2]), np.subtract(after[:2], here[:2]), here[2]))
        balls.append(moving)
    rate = float(clip.fps) * (1 if clip.fps > SLOW_RATE else 2)
    radius = min(value[2] for value in places.values())
    return FilmedPart(frames, np.arange(len(frames)) / rate, rate, balls, radius)


def vary_part(part: FilmedPart, rng: np.random.Generator) -> FilmedPart:
    """Mirror and resize a part, and change its brightness, colours and noise within what is good."""
    scale = float(rng.uniform(min(max(0.7, 7.0 / part.radius), 1.0), 1.0))
    mirror, hue = bool(rng.random() < 0.5), int(rng.integers(0, 180))
    brightest = float(np.percentile(_crop_middle(part.frames[0]).max(axis=2), 99))
    gain, noise = float(rng.uniform(0.8, min(1.25, 235 / brightest))), float(rng.uniform(0.3, 2.0))
    height, width = (round(side * scale) // 2 * 2 for side in part.frames[0].shape[:2])

    def vary(image: Image) -> Image:
        small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        hsv = cv2.cvtColor(small, cv2.COLOR_RGB2HSV)
        hsv[..., 0] = (hsv[..., 0].astype(int) + hue) % 180
        turned = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB).astype(np.float32) * gain + rng.normal(0, noise, hsv.shape)
        return np.ascontiguousarray(np.clip(turned, 0, 255).astype(np.uint8)[:, :: -1 if mirror else 1])

    def move(px: NDArray[np.float64]) -> NDArray[np.float64]:
        x = (px[0] + 0.5) * scale - 0.5
        return np.array([width - 1 - x if mirror else x, (px[1] + 0.5) * scale - 0.5])

    sign = np.array([-1.0 if mirror else 1.0, 1.0])
    balls = [[(move(c), d * scale * sign, r * scale) for c, d, r in row] for row in part.balls]
    return replace(part, frames=[vary(image) for image in part.frames], balls=balls, radius=part.radius * scale)


def change_frames(part: FilmedPart, change: Callable[[int, Image], Image]) -> FilmedPart:
    """Change every frame."""
    return replace(part, frames=[np.ascontiguousarray(change(k, image)) for k, image in enumerate(part.frames)])


def darken(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Scale the light so that the median of the frame has 6 to 24 levels."""
    level = float(rng.uniform(6, 24))
    factor = level / max(float(np.median(cv2.cvtColor(_crop_middle(part.frames[0]), cv2.COLOR_RGB2GRAY))), 1.0)
    noise = 1.5
    return change_frames(part, lambda k, image: _to_bytes(image * factor + rng.normal(0, noise, image.shape))), level


def overexpose(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Scale the light so that the brightest colour of the middle of the table is 1.3 to 2.5 times the maximum."""
    factor = float(rng.uniform(1.3, 2.5))
    gain = 255 * factor / max(float(np.median(_crop_middle(part.frames[0]).max(axis=2))), 1.0)
    return change_frames(part, lambda k, image: _to_bytes(image * np.float32(gain))), factor


def flicker(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Let the light change by +-6 to 25 %, as lamps that beat with the frame rate, or an automatic exposure."""
    amount, frequency = float(rng.uniform(0.06, 0.25)), float(rng.uniform(1.5, 12.0))
    phase = float(rng.uniform(0, 6))
    gain = 1 + amount * np.sin(2 * np.pi * frequency * part.t + phase)
    return change_frames(part, lambda k, image: _to_bytes(0.85 * gain[k] * image)), amount


def add_glare(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Add the reflection of a lamp on the cloth, 3 to 7 ball radii wide, once to three times."""
    height, width = part.frames[0].shape[:2]
    y, x = np.mgrid[:height, :width]
    light, size = np.zeros((height, width), np.float32), float(rng.uniform(4.0, 8.0))
    for _ in range(int(rng.integers(1, 4))):
        at = rng.uniform(0.33, 0.67, 2) * (width, height)
        distance = np.hypot((x - at[0]) / 1.6, y - at[1]) / (size * part.radius)
        light = np.maximum(light, np.clip(2.2 * (1 - distance), 0, 1).astype(np.float32))
    return change_frames(part, lambda k, image: _to_bytes(image + (250.0 - image) * light[..., None])), size


def blur_motion(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Blur every moving ball over 0.6 to 0.95 of its motion to the next frame."""
    share = float(rng.uniform(0.6, 0.95))

    def blur(k: int, image: Image) -> Image:
        out = image.astype(np.float32)
        for centre, motion, radius in part.balls[k]:
            if np.hypot(*motion) > 2:
                out = blur_streak(out, centre, share * motion, radius)
        return _to_bytes(out)

    return change_frames(part, blur), share / part.rate * 1e3


def drop_rate(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Keep every second or third frame, at their times: 16 to 30 frames per second."""
    step = int(rng.choice([2, 3]))
    frames = part.frames[::step]
    while len(frames) < 24:
        frames = [*frames, *frames[::-1]]
    return replace(part, frames=frames, t=np.arange(len(frames)) * step / part.rate, rate=part.rate / step), step


def repeat_frames(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Show every frame of a camera at the rate of the clip twice, or two of five, in a container of a higher rate."""
    pattern = [2, 2] if rng.random() < 0.5 else [2, 1, 2, 1, 1]
    order = [k for k in range(len(part.frames)) for _ in range(pattern[k % len(pattern)])]
    rate = part.rate * len(order) / len(part.frames)
    frames = [part.frames[k] for k in order]
    return replace(part, frames=frames, t=np.arange(len(order)) / rate, rate=rate), float(np.mean(pattern))


def jitter_times(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Leave out a random 15 to 35 % of the frames, as a variable frame rate does."""
    share = float(rng.uniform(0.15, 0.35))
    kept = np.sort(rng.choice(len(part.frames), round(len(part.frames) * (1 - share)), replace=False))
    return replace(part, frames=[part.frames[k] for k in kept], t=part.t[kept] - part.t[kept[0]]), share


def cut_table(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Cut a quarter to two fifths off one side, so that two corners are outside."""
    share, side = float(rng.uniform(0.25, 0.4)), int(rng.integers(4))
    height, width = part.frames[0].shape[:2]
    cut = (round(share * (width if side < 2 else height)) // 2) * 2
    box = [np.s_[:, cut:], np.s_[:, : width - cut], np.s_[cut:], np.s_[: height - cut]][side]
    return change_frames(part, lambda k, image: image[box]), share


def shrink_balls(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Resize the frames, and put them on a dark surrounding of the old size, so that a far ball has 6 to 10 px."""
    diameter = float(rng.uniform(6.0, 10.0))
    scale = diameter / (2 * part.radius)
    height, width = (round(side * scale) // 2 * 2 for side in part.frames[0].shape[:2])
    return change_frames(
        part, lambda k, image: cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    ), diameter


def move_camera(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Move the image as a hand does, by 4 to 20 px."""
    most, angle = float(rng.uniform(4, 20)), float(rng.uniform(0, 2 * np.pi))
    path = most * (1 - np.cos(np.pi * part.t / part.t[-1])) / 2

    def move(k: int, image: Image) -> Image:
        shift = np.array([[1, 0, path[k] * np.cos(angle)], [0, 1, path[k] * np.sin(angle)]])
        return np.asarray(cv2.warpAffine(image, shift, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE))

    return change_frames(part, move), most


def compress(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Encode at a constant rate factor of 36 to 46."""
    crf = int(rng.integers(36, 47))
    return replace(part, crf=crf), float(crf)


def defocus(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Blur by a Gaussian of 0.3 to 0.7 ball radii."""
    share = float(rng.uniform(0.3, 0.7))
    return change_frames(part, lambda k, image: cv2.GaussianBlur(image, (0, 0), share * part.radius)), share


def keep_part(part: FilmedPart, rng: np.random.Generator) -> tuple[FilmedPart, float]:
    """Leave a part as it is."""
    return part, 0.0


# Faults by the code of the measurement that should name them.
FAULTS: dict[str, Callable[[FilmedPart, np.random.Generator], tuple[FilmedPart, float]]] = {
    NONE: keep_part, "exposure": darken, "clipping": overexpose, "flicker": flicker, "glare": add_glare,
    "motion_blur": blur_motion, "frame_rate": drop_rate, "duplicates": repeat_frames, "irregular_times": jitter_times,
    "corners": cut_table, "ball_size": shrink_balls, "camera_drift": move_camera, "compression": compress,
    "focus": defocus,
}  # fmt: skip
# Sample clips with regular times.
SAMPLES = ("overhead_pool", "oblique_pool", "carom_match", "snooker_reds", "many_contacts")


def _crop_middle(image: Image) -> Image:
    """Crop the middle ninth of a frame, which is cloth with some balls."""
    height, width = image.shape[:2]
    return np.ascontiguousarray(image[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3])


def _to_bytes(image: NDArray[np.floating]) -> Image:
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)


def write_part(part: FilmedPart, path: Path) -> None:
    """Encode a part with its times."""
    height, width = part.frames[0].shape[:2]
    rate = Fraction(part.rate).limit_denominator(1001)
    with VideoWriter(path, width, height, rate, crf=part.crf, time_base=TIME_BASE) as writer:
        for image, t in zip(part.frames, part.t, strict=True):
            writer.write(image, float(t))


def check_case(number: int, seed: int, parts: dict[str, FilmedPart], path: Path) -> CheckedRow:
    """Make a clip with one fault or none, and check it."""
    rng = np.random.default_rng((seed, number))
    fault, name = list(FAULTS)[number % len(FAULTS)], SAMPLES[int(rng.integers(len(SAMPLES)))]
    if name not in parts:
        parts[name] = read_sample(name)
    part, strength = FAULTS[fault](vary_part(parts[name], rng), rng)
    write_part(part, path)
    begun = time.perf_counter()
    report = check_clip(path)
    seconds = time.perf_counter() - begun
    faults = [one.code for one in rank_faults(report.measurements)]
    return CheckedRow(
        number, name, fault, round(strength, 4), report.verdict, faults[0] if faults else NONE, " ".join(faults),
        round(seconds, 2),
    )  # fmt: skip


def print_table(rows: list[CheckedRow]) -> bool:
    """Print the confusion table and the share of right answers; return whether the goal is met."""
    columns = [NONE, *CODES]
    print("| fault of the clip | clips | right | " + " | ".join(columns) + " |\n" + "|---" * (len(columns) + 3) + "|")
    for fault in FAULTS:
        mine = [row for row in rows if row.fault == fault]
        counts = [sum(row.named == code for row in mine) for code in columns]
        right = sum(row.named == row.fault for row in mine)
        print(f"| {fault} | {len(mine)} | {right} | " + " | ".join(str(n) if n else "" for n in counts) + " |")
    right = sum(row.named == row.fault for row in rows)
    among = sum(row.fault in (row.all_named.split() or [NONE]) for row in rows)
    alone = sum(row.all_named.split() == [row.fault] for row in rows if row.fault != NONE)
    bad = sum(row.fault != NONE for row in rows)
    seconds = [row.seconds for row in rows]
    print(f"\n{right} of {len(rows)} right ({right / len(rows):.1%}, goal {GOAL:.0%}): fault, or none, named first.")
    print(f"The fault, or none, is named at all: {among}. The fault is named alone: {alone} of {bad}.")
    print(f"Time of a check: median {np.median(seconds):.1f} s, at most {max(seconds):.1f} s.")
    for row in rows:
        if row.named != row.fault:
            print(f"- clip {row.number} ({row.clip}): {row.fault} {row.strength:g}, named: {row.all_named or NONE}")
    return right >= GOAL * len(rows)


def measure_figures(seed: int) -> list[Figure]:
    """Measure the figures of the documentation: one clip of each fault and one without."""
    parts: dict[str, FilmedPart] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clip.mp4"
        rows = [check_case(number, seed, parts, path) for number in range(QUICK_CLIPS)]
    bad = [row for row in rows if row.fault != NONE]
    return [
        estimate_share("fault, or none, named first", sum(row.named == row.fault for row in rows), len(rows)),
        estimate_share("fault named at all", sum(row.fault in row.all_named.split() for row in bad), len(bad)),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("--clips", type=int, default=200, help="number of clips (default 200)")
    parser.add_argument("--seed", type=int, default=1, help="seed of clips and faults (default 1)")
    parser.add_argument("--rows", type=Path, help="CSV file of finished clips, which are not checked again")
    parser.add_argument("--minutes", type=float, default=60.0, help="stop after so many minutes (default 60)")
    parser.add_argument("--keep", type=Path, help="folder in which the clips are kept")
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = (
            f"{QUICK_CLIPS} clips from the samples with one fault of {len(FAULTS) - 1} or none, seed {arguments.seed}"
        )
        run_quick("clips.filming_checks", lambda: measure_figures(arguments.seed), inputs)
        return 0
    rows = read_rows(arguments.rows, CheckedRow)
    finished, parts = {row.number for row in rows}, dict[str, FilmedPart]()
    end = time.monotonic() + 60 * arguments.minutes
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(arguments.clips):
            if number in finished or time.monotonic() > end:
                continue
            row = check_case(number, arguments.seed, parts, folder / f"clip{number}.mp4")
            print(f"{number}: {row.fault} {row.strength:g} -> {row.all_named or NONE}", file=sys.stderr, flush=True)
            rows.append(row)
            append_row(row, arguments.rows)
    return int(not print_table(sorted(rows, key=lambda row: row.number)))


if __name__ == "__main__":
    sys.exit(main())
