"""Rendered clips of rallies with truth, for training.

    folders of rallies:  simulate_rallies("tennis", seed=1, count=20, folder=Path("rallies"))
    decoded clips:       for clip in generate_rally_clips(rng, rallies, seconds=1.0): clip.frames, clip.truth

The simulator runs as a process of its own, and shares no code with the program.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from models.core.court_camera import CourtCamera
from models.core.typing import ByteArray, FloatArray
from video.io.video_writer import VideoWriter
from video.rendering.court_renderer import CourtRenderer, FrameTruth
from video.rendering.court_scene import (
    CourtLook,
    RallyPath,
    View,
    read_rally,
    sample_camera,
    sample_look,
    sample_motion,
)

WORLD_SCRIPT = Path(__file__).resolve().parents[2] / "worlds" / "rallies.py"
# A clip's object is visible where at least this share of its light is shown, and it changes a pixel by so many levels.
LEAST_SHOWN, LEAST_CONTRAST = 0.5, 12.0


@dataclass(frozen=True, slots=True, eq=False)
class RallyTruth:
    """Truth of a rendered clip of T frames."""

    sport: str
    fps: Fraction
    camera: CourtCamera
    exposure: float
    """s."""
    t: FloatArray
    """(T,) s of the clip at mid-exposure; the rally's own time is `start` later."""
    start: float
    xyz: FloatArray
    """(T, 3) m, place of the object at mid-exposure."""
    px: FloatArray
    """(T, 2) px, its place in the picture; NaN behind the camera."""
    streak: FloatArray
    """(T, 2) px, its displacement during the exposure."""
    radius_px: FloatArray
    """(T,)"""
    shown: FloatArray
    """(T,) share of its light that is not hidden and lies in the frame."""
    contrast: FloatArray
    """(T,) largest change of a pixel that it makes, of 255 levels, before noise and coding."""
    players: FloatArray
    """(T, N, 4) px, left, top, right and bottom."""
    events: tuple[dict[str, Any], ...]
    """`kind`, `t` (s of the clip), `frame` (a float), `place`, and `player` of hits; `after` for what follows the
    landing."""
    rally: RallyPath
    others: FloatArray = field(default_factory=lambda: np.empty((0, 0, 6)))
    """(T, M, 6) place and streak, px, share shown and contrast of the objects of other rallies."""

    @property
    def is_visible(self) -> ByteArray:
        """(T,) bool, whether the object can be seen."""
        return is_object_visible(self.shown, self.contrast)


def is_object_visible(shown: FloatArray, contrast: FloatArray) -> ByteArray:
    """Tell whether objects can be seen by the shares of them that are shown and by their contrasts."""
    return np.asarray((shown >= LEAST_SHOWN) & (contrast >= LEAST_CONTRAST))


@dataclass(frozen=True, slots=True, eq=False)
class RallyClip:
    """Decoded frames of a rendered clip, and their truth."""

    frames: ByteArray
    """(T, H, W, 3) sRGB."""
    truth: RallyTruth


def simulate_rallies(sport: str, seed: int, count: int, folder: Path, **experiment: Any) -> list[Path]:
    """Let the simulator write rallies into a folder; returns their files, see `read_rally`.

    Args:
        experiment: further entries, see `worlds/rallies.py`: `strokes` and `ending`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "experiment.json"
    path.write_text(json.dumps({"sport": sport, "seed": seed, "rallies": count, **experiment}))
    subprocess.run([sys.executable, str(WORLD_SCRIPT), str(path), str(folder)], check=True)
    return [folder / f"{i:04d}.npz" for i in range(count)]


def film_rally(
    rng: np.random.Generator, rally: RallyPath, view: View, fps: Fraction, size: tuple[int, int],
    span: tuple[float, float],
) -> tuple[CourtCamera, CourtLook, FloatArray]:  # fmt: skip
    """Draw a look and a camera for a rally; also return the times (T,), s of the rally, of frames within a span, s."""
    sport = rally.sport
    look = sample_look(rng, sport.name, str(rally.truth["surface"]), view, float(fps))
    camera = sample_camera(rng, sport, view, size)
    t = span[0] + np.arange(int((span[1] - span[0]) * fps)) / float(fps)
    if view == "phone" and rng.random() < 0.5:
        shake = float(rng.uniform(2e-4, 1.5e-3))
        camera = replace(camera, motion=sample_motion(rng, camera, len(t), float(fps), 4 * shake, shake, 0.003))
    elif view == "broadcast" and rng.random() < (0.75 if sport.is_filmed_from_side else 0.25):
        pan, zoom = (0.02, 0.03) if sport.is_filmed_from_side else (0.004, 0.01)
        pan, zoom = pan * rng.uniform(0.2, 1.5), zoom * rng.uniform(0.0, 1.5)
        camera = replace(camera, motion=sample_motion(rng, camera, len(t), float(fps), pan, 0.0, zoom))
    return camera, look, t


def stage_rally(
    rng: np.random.Generator, rally: RallyPath, view: View, fps: Fraction, size: tuple[int, int],
    span: tuple[float, float], others: Sequence[RallyPath] = (),
) -> tuple[CourtRenderer, CourtCamera, CourtLook, FloatArray]:  # fmt: skip
    """Draw what `film_rally` draws, and prepare the renderer for it."""
    camera, look, t = film_rally(rng, rally, view, fps, size, span)
    return CourtRenderer(rng, rally, camera, look, view, t, others), camera, look, t


def generate_rally_clips(
    rng: np.random.Generator, rallies: Sequence[RallyPath | Path], seconds: float = 1.0,
    size: tuple[int, int] = (1280, 720), others: int = 0,
) -> Iterator[RallyClip]:  # fmt: skip
    """Generate short clips for training without end: a random rally, view, look, rate and moment for each.

    Frames are decoded from H.264, as those of files are.

    Args:
        others: number of further objects in a clip, from random moments of the rallies.
    """
    paths = [read_rally(path) if isinstance(path, Path) else path for path in rallies]
    while True:
        rally = paths[int(rng.integers(len(paths)))]
        view: View = "broadcast" if rng.random() < 0.6 else "phone"
        fps = Fraction(int(rng.choice([25, 25, 30, 30, 50, 60])))
        start = float(rng.uniform(0, max(rally.t[-1] - seconds, 0.01)))
        span = (start, start + seconds + 1e-6)
        further = [_delay_rally(rng, paths[int(k)], span) for k in rng.integers(len(paths), size=others)]
        renderer, camera, look, t = stage_rally(rng, rally, view, fps, size, span, further)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "clip.mp4"
            shown = write_frames(path, renderer, look, fps, size, "ultrafast")
            with av.open(str(path)) as container:
                decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        yield RallyClip(np.stack(decoded), collect_truth(rally, camera, look, fps, t, shown))


def _delay_rally(rng: np.random.Generator, rally: RallyPath, span: tuple[float, float]) -> RallyPath:
    """Let a rally begin at another time, so that a span, s, falls within it."""
    start = rng.uniform(rally.t[0], max(rally.t[-1] - (span[1] - span[0]), rally.t[0] + 0.01))
    return replace(rally, t=rally.t + (span[0] - start))


def write_frames(
    path: Path, renderer: CourtRenderer, look: CourtLook, fps: Fraction, size: tuple[int, int], preset: str
) -> list[FrameTruth]:  # fmt: skip
    """Render all frames to a file; returns their truth."""
    shown = []
    with VideoWriter(path, *size, fps, crf=look.crf, preset=preset, threads=1) as writer:
        for k in range(len(renderer.t)):
            image, truth = renderer.render_frame(k)
            writer.write(image)
            shown.append(truth)
    return shown


def collect_truth(
    rally: RallyPath, camera: CourtCamera, look: CourtLook, fps: Fraction, t: FloatArray, shown: Sequence[FrameTruth]
) -> RallyTruth:  # fmt: skip
    """Collect the truth of frames at times t (T,), s of the rally."""
    start, stop = float(t[0]), float(t[-1] + 1 / fps)
    events = tuple(
        {**e, "t": e["t"] - start, "frame": (e["t"] - start) * float(fps)}
        for e in rally.truth["events"]
        if start <= e["t"] < stop
    )
    columns = {
        name: np.array([getattr(truth, name)[0] for truth in shown])
        for name in ("px", "streak", "radius_px", "shown", "contrast")
    }
    columns["players"] = np.array([truth.players for truth in shown])
    columns["others"] = np.array([np.column_stack([one.px, one.streak, one.shown, one.contrast])[1:] for one in shown])
    return RallyTruth(
        rally.sport.name, fps, camera, look.exposure, t - start, start, rally.place_at(t)[0], **columns, events=events,
        rally=rally,
    )  # fmt: skip
