"""Are all shots of a match recording found to the frame, and nothing else?

    python -m benchmarks.clips.match_recordings OUT [--minutes 60] [--height 360] [--seed 1]

Composes a recording OUT/match.mp4 from the sample clips, new shots by their cameras and, where it is there, real
footage: titles, fades, cuts between takes of one fixed camera, replays (slowed too), scoreboards, people
and other sports. The truth is known (OUT/match.truth.json). Then finds the shots of the recording as `trueroll batch`
does, and prints shots found, errors of their first and last frames, false shots, and CPU time. A recording that is
already there is used again. An hour at 360 rows takes 7 CPU minutes to compose and 9 to search.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.interpolation.rendered_clips import draw_shot
from benchmarks.stress_cases.stress_chain import SilentWatcher
from benchmarks.support.run_folder import ROOT
from pipeline.engine.result_cache import ResultCache
from pipeline.recording_shots import find_recording_shots
from pipeline.run_options import RunOptions
from video.calibration.shot_segmentation import MARGIN_S

sys.path.insert(0, str(ROOT / "sample_videos"))
import make
import shots

# (3/2 H, W) luma and chroma of one frame, yuv420p.
Planes = NDArray[np.uint8]

RATE = 30
FOOTAGE = ROOT.parent / "shared" / "data"
# Samples whose camera films new shots, how many, and px: larger frames take longer to render than to search.
SERIES_CAMERAS, SERIES_SHOTS, SERIES_WIDTH = ("overhead_pool", "carom_match"), 4, 640
# Samples that are shown forwards and backwards in one view, with stillness between.
LONG_VIEWS = ("overhead_pool", "carom_match", "potted_phone")
# Real clips that one camera took.
FIXED_CAMERA = ("snooker_simulation_vs_reality", "snooker_video", "snooker_gleitreibungskoeffizient")
# Axes of cv2.flip, in the order in which a clip is shown again.
FLIPS = (None, 1, 0, -1)
# Frames by which a span may differ from the truth where a fade is its border.
SAME_FRAME = 2


@dataclass(frozen=True)
class TrueSpan:
    """A part of the recording."""

    kind: str
    """shot, replay, title, people, board."""
    first: int
    stop: int
    source: str
    border: str = "cut"
    """What separates it from others: cut, fade, or still (the shot is a part of a long view)."""


@dataclass(frozen=True)
class Take:
    """A source clip, as the recording shows it."""

    path: Path
    flip: int | None = None
    """Axis of cv2.flip; None shows it as it is."""
    step: int = 1
    """Frames of the recording per frame of the clip: a replay in slow motion has 2 or more."""
    label: str = ""


class Recorder:
    """Composes a recording and its truth."""

    def __init__(self, path: Path, height: int, seed: int) -> None:
        self.size = (height * 16 // 9 // 2 * 2, height)
        self.rng = np.random.default_rng(seed)
        self._noise = self.rng.integers(0, 5, (16, height, self.size[0])).astype(np.uint8)
        self.spans: list[TrueSpan] = []
        self.count = 0
        self._container = av.open(str(path), "w")
        self._stream = self._container.add_stream("libx264", rate=RATE)
        self._stream.width, self._stream.height, self._stream.pix_fmt = *self.size, "yuv420p"
        self._stream.options = {"crf": "21", "preset": "veryfast"}

    def add_frame(self, planes: Planes) -> None:
        """Encode one frame."""
        frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        frame.pts, frame.time_base = self.count, Fraction(1, RATE)
        self._container.mux(self._stream.encode(frame))
        self.count += 1

    def add_span(self, kind: str, first: int, source: str, border: str = "cut") -> None:
        """Note what the frames since `first` show."""
        self.spans.append(TrueSpan(kind, first, self.count, source, border))

    def add_take(self, take: Take, kind: str = "shot", border: str = "cut") -> None:
        """Show a clip."""
        first = self.count
        for planes in read_take(take, self.size):
            for _ in range(take.step):
                self.add_frame(planes)
        self.add_span(kind, first, take.path.stem, border)

    def add_still(self, planes: Planes, seconds: float, kind: str = "") -> None:
        """Show one frame for some time, with the noise of a camera."""
        first = self.count
        for _ in range(round(seconds * RATE)):
            noise = self._noise[int(self.rng.integers(len(self._noise)))]
            shown = planes.copy()
            shown[: self.size[1]] = cv2.subtract(cv2.add(shown[: self.size[1]], noise), 2)
            self.add_frame(shown)
        if kind:
            self.add_span(kind, first, kind)

    def add_fade(self, planes: Planes, seconds: float, *, out: bool) -> None:
        """Fade a frame in from black or out to it."""
        shares = (np.arange(round(seconds * RATE)) + 0.5) / round(seconds * RATE)
        rows = self.size[1]
        for share in shares[::-1] if out else shares:
            shown = planes.astype(np.float64)
            shown[:rows] = 16 + share * (shown[:rows] - 16)
            shown[rows:] = 128 + share * (shown[rows:] - 128)
            self.add_frame(shown.round().astype(np.uint8))

    def close(self) -> None:
        """Write the end of the file."""
        self._container.mux(self._stream.encode(None))
        self._container.close()


@lru_cache(maxsize=6)
def _read_planes(path: Path, size: tuple[int, int]) -> tuple[Planes, ...]:
    """Read a clip, scaled into a frame of this size with black bars."""
    shown = []
    width, height = size
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            share = min(width / frame.width, height / frame.height)
            w, h = (int(share * side) // 4 * 4 for side in (frame.width, frame.height))
            small = frame.reformat(w, h, "yuv420p").to_ndarray()
            planes = make_grey(size, 16)
            top, left = (height - h) // 4 * 2, (width - w) // 4 * 2
            planes[top : top + h, left : left + w] = small[:h]
            _chroma(planes, height)[:, top // 2 : (top + h) // 2, left // 2 : (left + w) // 2] = _chroma(small, h)
            shown.append(planes)
    return tuple(shown)


def _chroma(planes: Planes, height: int) -> Planes:
    """Return the chroma planes (2, H / 2, W / 2) of a frame as a view."""
    return planes[height:].reshape(2, height // 2, planes.shape[1] // 2)


def make_grey(size: tuple[int, int], level: int) -> Planes:
    """Make a grey frame."""
    planes = np.full((size[1] * 3 // 2, size[0]), 128, np.uint8)
    planes[: size[1]] = level
    return planes


def read_take(take: Take, size: tuple[int, int]) -> Iterator[Planes]:
    """Read the frames of a clip as the recording shows them."""
    rows = size[1]
    for planes in _read_planes(take.path, size):
        shown = planes.copy()
        if take.flip is not None:
            shown[:rows] = cv2.flip(shown[:rows], take.flip)
            for plane in _chroma(shown, rows):
                plane[:] = cv2.flip(plane, take.flip)
        if take.label:
            write_text(shown, rows, take.label, (0.04, 0.1), 0.9)
        yield shown


def write_text(planes: Planes, rows: int, text: str, at: tuple[float, float], scale: float) -> None:
    """Write white text into the luma of a frame, at shares of its width and height."""
    place = round(at[0] * planes.shape[1]), round(at[1] * rows)
    luma = np.ascontiguousarray(planes[:rows])
    cv2.putText(luma, text, place, cv2.FONT_HERSHEY_DUPLEX, scale * rows / 360, 235, 1, cv2.LINE_AA)
    planes[:rows] = luma


def draw_title(size: tuple[int, int], lines: list[str], level: int = 40) -> Planes:
    """Draw a title."""
    planes = make_grey(size, level)
    for k, line in enumerate(lines):
        write_text(planes, size[1], line, (0.2, 0.35 + 0.14 * k), 0.9)
    return planes


def add_people(recorder: Recorder, seconds: float) -> None:
    """Show a person who talks before a wall."""
    first, (width, height) = recorder.count, recorder.size
    wall = make_grey(recorder.size, 90)
    wall[:height] += cv2.resize(recorder.rng.integers(0, 60, (6, 9)).astype(np.uint8), recorder.size)
    for k in range(round(seconds * RATE)):
        planes, sway = wall.copy(), 0.01 * width * np.sin(k / 9)
        luma = np.ascontiguousarray(planes[:height])
        cv2.ellipse(luma, (round(width / 2 + sway), round(0.95 * height)), (width // 6, height // 3), 0, 0, 360, 50, -1)
        cv2.ellipse(
            luma, (round(width / 2 + 2 * sway), round(0.42 * height)), (width // 14, height // 6), 0, 0, 360, 180, -1
        )
        mouth = 1 + round(abs(np.sin(k / 2.5)) * height / 50)
        cv2.ellipse(luma, (round(width / 2 + 2 * sway), height // 2), (width // 50, mouth), 0, 0, 360, 60, -1)
        planes[:height] = luma
        recorder.add_frame(planes)
    recorder.add_span("people", first, "drawn person")


def render_series(folder: Path) -> dict[str, list[Path]]:
    """Render new shots by the cameras of some samples; those that exist are used again."""
    folder.mkdir(parents=True, exist_ok=True)
    series: dict[str, list[Path]] = {}
    for sample in (one for one in shots.SAMPLES if one.name in SERIES_CAMERAS):
        scale = SERIES_WIDTH / sample.camera.width_px
        camera = replace(
            sample.camera, matrix=np.diag([scale, scale, 1.0]) @ sample.camera.matrix, width_px=SERIES_WIDTH,
            height_px=round(scale * sample.camera.height_px), corners_px=scale * sample.camera.corners_px,
        )  # fmt: skip
        film = replace(sample, seconds=min(sample.seconds, 3.0), rate=Fraction(RATE), camera=camera)
        series[sample.name] = []
        for n in range(SERIES_SHOTS):
            shot = draw_shot(film, np.random.default_rng((7, n)), n)
            path = folder / f"{shot.name}.mp4"
            if not path.exists():
                with make.Progress(disable=True) as bar:
                    make.make_sample(shot, folder, bar)
            series[sample.name].append(path)
    return series


def compose_recording(path: Path, minutes: float, height: int, seed: int, footage: Path | None) -> list[TrueSpan]:
    """Compose a recording, of rendered clips alone without footage; return what it shows."""
    recorder = Recorder(path, height, seed)
    series = list(render_series(path.parent / "rendered").values())
    clips = sorted((ROOT / "sample_videos").glob("*.mp4")) + (
        sorted((footage / "billiards").glob("*.mp4")) if footage else []
    )
    series += [group for name in FIXED_CAMERA if (group := [clip for clip in clips if clip.name.startswith(name)])]
    other = sorted((footage / "courts").rglob("*.mp4")) if footage else []
    recorder.add_still(draw_title(recorder.size, ["trueroll open", "semi-final"]), 3.0, "title")
    deck: list[tuple[str, list[Path]]] = []
    shown = dict.fromkeys([*clips, *(path for group in series for path in group)], 0)
    while recorder.count < 60 * minutes * RATE:
        if not deck:
            blocks = [("single", [clip]) for clip in clips] + [("series", group) for group in series]
            blocks += [("long", [ROOT / "sample_videos" / f"{name}.mp4"]) for name in LONG_VIEWS]
            deck = [blocks[k] for k in recorder.rng.permutation(len(blocks))]
        kind, paths = deck.pop()
        times = max(shown[path] for path in paths)
        flip = FLIPS[times % len(FLIPS)]  # the same shot once more would be a replay
        shown |= dict.fromkeys(paths, times + 1)
        _add_block(recorder, kind, [Take(path, flip) for path in paths], other)
    recorder.close()
    return recorder.spans


def _add_block(recorder: Recorder, kind: str, takes: list[Take], other: list[Path]) -> None:
    """Add a shot or some, and what stands between them in a broadcast."""
    rng = recorder.rng
    frames = list(read_take(takes[0], recorder.size))
    if kind == "series":
        for take in takes:
            recorder.add_take(take)
    elif kind == "long":
        _add_long_view(recorder, takes[0], frames)
    elif rng.random() < 0.3:
        recorder.add_fade(frames[0], 0.8, out=False)
        recorder.add_take(takes[0], border="fade")
        recorder.add_fade(frames[-1], 0.6, out=True)
    else:
        recorder.add_take(takes[0])
    if kind == "single" and rng.random() < 0.35:
        recorder.add_take(
            replace(takes[0], step=int(rng.integers(1, 4)), label="REPLAY" if rng.random() < 0.5 else ""), "replay"
        )
    what = rng.random()
    if what < 0.15:
        recorder.add_still(
            draw_title(recorder.size, ["frame 3", f"{rng.integers(99)} - {rng.integers(99)}"]), 2.0, "board"
        )
    elif what < 0.25:
        add_people(recorder, 3.0)
    elif what < 0.35 and other:
        recorder.add_take(Take(other[int(rng.integers(len(other)))]), "people")


def _add_long_view(recorder: Recorder, take: Take, frames: list[Planes]) -> None:
    """Add a shot, stillness, the same shot backwards as another one, and stillness."""
    begins, ends = 0, _find_last_motion(take.path)
    margin = round(MARGIN_S * RATE)
    first = recorder.count
    recorder.add_still(frames[0], 3.0)
    for direction in (1, -1):
        start = recorder.count
        for planes in frames[::direction]:
            recorder.add_frame(planes)
        low, high = (begins, ends) if direction == 1 else (len(frames) - 1 - ends, len(frames) - 1 - begins)
        recorder.spans.append(TrueSpan("shot", start + low - margin, start + high + margin, take.path.stem, "still"))
        recorder.add_still(frames[-1 if direction == 1 else 0], 4.0)
    assert recorder.count - first > 12 * RATE


def _find_last_motion(path: Path) -> int:
    """Find the last frame of a sample clip in which a ball moves; its player moves from the first one on."""
    with path.with_suffix(".truth.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    last = 0
    for name in {row["id"] for row in rows}:
        track = np.array([[float(row[key]) for key in ("frame", "x_px", "y_px")] for row in rows if row["id"] == name])
        moving = np.flatnonzero(np.hypot(*np.diff(track[:, 1:], axis=0).T) > 0.1)
        last = max([last, *(int(track[k + 1, 0]) for k in moving[-1:])])
    return last


@dataclass(frozen=True)
class Score:
    """How the found shots compare with the truth."""

    found: list[bool]
    errors: dict[str, list[int]]
    """Frames by which starts and stops differ, by border."""
    false: list[tuple[int, int, str]]


def score_shots(spans: list[TrueSpan], shots_found: list[tuple[int, int]]) -> Score:
    """Match found shots with true ones: each true shot with the span that overlaps it most."""
    left = set(range(len(shots_found)))
    found, errors = [], dict[str, list[int]]()
    for span in (one for one in spans if one.kind == "shot"):
        overlap = {k: min(span.stop, shots_found[k][1]) - max(span.first, shots_found[k][0]) for k in left}
        best = max(overlap, key=overlap.__getitem__, default=None)
        is_found = best is not None and overlap[best] > 0.5 * (span.stop - span.first)
        found.append(is_found)
        if is_found and best is not None:
            left.discard(best)
            pair = shots_found[best]
            errors.setdefault(span.border, []).extend([pair[0] - span.first, pair[1] - span.stop])
            if max(abs(pair[0] - span.first), abs(pair[1] - span.stop)) > 5 * SAME_FRAME:
                print(f"  inexact: {span} found as {pair}")
        else:
            print(f"  missed: {span}")
    false = [(*shots_found[k], _name_place(spans, shots_found[k])) for k in sorted(left)]
    return Score(found, errors, false)


def _name_place(spans: list[TrueSpan], pair: tuple[int, int]) -> str:
    return ", ".join(f"{one.kind} {one.source}" for one in spans if one.first < pair[1] and one.stop > pair[0])


def find_shots(path: Path) -> tuple[list[tuple[int, int]], float]:
    """Find the shots of a recording; return their spans and the CPU seconds."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        recording = find_recording_shots(path, RunOptions(), ResultCache(Path(folder)), SilentWatcher())
    return [(shot.first, shot.stop) for shot in recording.shots], time.process_time() - began


def measure_recording(folder: Path, minutes: float, height: int, seed: int, footage: Path | None) -> None:
    """Compose a recording, or take the one that is there, find its shots and print how they compare."""
    folder.mkdir(parents=True, exist_ok=True)
    path, truth = folder / "match.mp4", folder / "match.truth.json"
    if not truth.exists():
        began = time.process_time()
        spans = compose_recording(path, minutes, height, seed, footage)
        truth.write_text(json.dumps([asdict(span) for span in spans], indent=1))
        print(f"composed in {time.process_time() - began:.0f} CPU s")
    spans = [TrueSpan(**one) for one in json.loads(truth.read_text())]
    shots_found, seconds = find_shots(path)
    score = score_shots(spans, shots_found)
    with av.open(str(path)) as container:
        length = container.duration / 60e6
    print(f"{length:.1f} min, {len(spans)} parts, {seconds / length:.2f} CPU s per minute of video")
    print(f"{sum(score.found)} of {len(score.found)} shots found, {len(score.false)} false")
    for border, errors in score.errors.items():
        sizes = np.abs(errors)
        print(
            f"  {border}: {np.mean(sizes == 0):.1%} of {len(sizes)} borders exact, largest error {sizes.max()} frames"
        )
    for first, stop, place in score.false:
        print(f"  false: {first} to {stop}: {place}")


def main(arguments: list[str] | None = None) -> int:
    """Compose a recording and measure the search for its shots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", default=Path("out/match"), help="folder of the recording")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--height", type=int, default=360, help="rows of the frames, px")
    parser.add_argument("--seed", type=int, default=1)
    parsed = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    measure_recording(parsed.out, parsed.minutes, parsed.height, parsed.seed, FOOTAGE if FOOTAGE.exists() else None)
    return 0


if __name__ == "__main__":
    sys.exit(main())
