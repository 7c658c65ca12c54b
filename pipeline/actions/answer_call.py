"""A question in words to a call, and the call to pictures of its moment."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from models.core.errors import OptionError, TruerollError
from models.core.scene import Camera
from models.core.typing import FloatArray
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.call_answers import Call
from models.estimation.contact_test.shot_record import Record
from pipeline.chain import SOURCE
from pipeline.engine.atomic_write import aside
from pipeline.io.run_folder import read_scene
from video.io.clip import Clip, clip_digest, open_clip, read_frames
from video.overlay.close_up import Outline, Scenery, close_up, strip

SHAPES = {"contact": 2, "first": 1, "cushion-first": 1, "pocket": 2, "line": 2}
"""Words after the first one."""
USAGE = "ask contact A B, first A, cushion-first A, pocket A top-left, or line x=0.635 A"
LINE_POINTS = 33
"""Of a line in question, so that it may bend with the lens."""
STRIP = 2
"""Pictures before and after the nearest one."""


def ask(record: Record, words: Sequence[str], edge: bool = False) -> Call:
    """The answer to a question; OptionError, one sentence, where it cannot be understood."""
    kind, *rest = words
    if kind not in SHAPES or len(rest) != SHAPES[kind]:
        raise OptionError(f"{USAGE}; got {' '.join(words)!r}")
    if edge and kind != "line":
        raise OptionError(f"--edge belongs to line; got {' '.join(words)!r}")
    try:
        if kind == "contact":
            return call_answers.contact(record, *rest)
        if kind == "first":
            return call_answers.first(record, *rest)
        if kind == "cushion-first":
            return call_answers.cushion_first(record, *rest)
        if kind == "pocket":
            return call_answers.pocket(record, *rest)
        axis, at = _line(rest[0])
        return call_answers.line(record, rest[1], axis, at, edge)
    except ValueError as error:
        raise OptionError(str(error)) from error


def _line(text: str) -> tuple[str, float]:
    match = re.fullmatch(r"([xy])=([+-]?(?:\d+\.?\d*|\.\d+))", text)
    if match is None:
        raise OptionError(f"a line is x=0.635 or y=0.3, in metres; got {text!r}")
    return match.group(1), float(match.group(2))


def picture_call(
    record: Record, call: Call, folder: Path, clip: Path | None, target: Path, words: Sequence[str]
) -> tuple[list[Path], str]:
    """Write a close-up and a strip of the moment; their paths, or none and why."""
    if not np.isfinite(call.t) or record.camera is None:
        return [], "there is no moment to show." if record.camera else "the folder does not say how the table was seen."
    found, why_not = _clip_of(folder, clip)
    if found is None:
        return [], why_not
    shown = record.frame[np.argsort(np.abs(record.shown - call.t), kind="stable")[: 2 * STRIP + 1]]
    try:
        frames = dict(read_frames(_shown_part(folder, open_clip(found)), indices=np.sort(shown)))
    except (TruerollError, ValueError) as error:
        if clip is not None:
            raise
        return [], f"{found} cannot be read: {error}"
    target.mkdir(parents=True, exist_ok=True)
    name = re.sub(r"[^A-Za-z0-9.=-]+", "_", "call " + " ".join(words))
    line = _points(record, *_line(words[1])) if words[0] == "line" else None
    scenery = [
        _scenery(record, record.camera, call, int(frame), picture, line) for frame, picture in sorted(frames.items())
    ]
    nearest = min(scenery, key=lambda scene: abs(scene.t - call.t))
    paths = [target / f"{name}.png", target / f"{name}_strip.png"]
    caption = f"{call.verdict}  {call.probability:.1%}"
    for path, picture in zip(paths, (close_up(nearest, caption, _lines(call)), strip(scenery, call.t)), strict=True):
        with aside(path) as part:
            Image.fromarray(picture).save(part, format="PNG")
    return paths, ""


def _lines(call: Call) -> list[str]:
    """What is written below the close-up."""
    when = f"{call.t:.4f} s" + (f" ± {1e3 * call.t_sigma:.1f} ms" if np.isfinite(call.t_sigma) else "")
    lines = [f"{when}, picture {call.frame:.2f}"]
    if np.isfinite(call.margin):
        lines.append(f"margin {1e3 * call.margin:+.2f} ± {1e3 * call.margin_sigma:.2f} mm")
    return lines


def _clip_of(folder: Path, clip: Path | None) -> tuple[Path | None, str]:
    """The video of a run: as named, else as the run noted it, where that is still the same file."""
    if clip is not None:
        if not clip.is_file():
            raise OptionError(f"A clip was expected; {clip} is no file")
        return clip, ""
    digest = (read_scene(folder / "scene.json").get("clip") or {}).get("sha256")
    try:
        noted = Path(json.loads((folder / SOURCE).read_text(encoding="utf-8"))["path"])
        same = digest is None or clip_digest(noted) == digest
    except (OSError, ValueError, KeyError, TypeError):
        return None, "the clip of this run is not where it was; name it with --clip."
    return (noted, "") if same else (None, f"{noted} is another clip now; name the right one with --clip.")


def _shown_part(folder: Path, clip: Clip) -> Clip:
    """The clip, or the shot of it that the run was made of."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        noted = json.loads((folder / SOURCE).read_text(encoding="utf-8"))
        return clip.between(int(noted["first"]), int(noted["stop"]))
    return clip


def _points(record: Record, axis: str, at: float) -> FloatArray:
    """(n, 2) m along the line across the table at x or y = `at`."""
    along = np.linspace(0, record.table.width if axis == "x" else record.table.length, LINE_POINTS)
    columns = (np.full(LINE_POINTS, at), along)
    return np.column_stack(columns if axis == "x" else columns[::-1])


def _scenery(
    record: Record, camera: Camera, call: Call, frame: int, picture: NDArray[np.uint8], line: FloatArray | None
) -> Scenery:
    """A picture with the fitted outlines of the balls that take part, and the line (n, 2) m in question."""
    t = float(record.shown[np.searchsorted(record.frame, frame)])
    drift = _drift(record, camera, t)
    outlines = _outlines(record, camera, call, t, drift)
    seen = None if line is None else camera.to_pixels(line, record.table.ball_radius) + drift
    return Scenery(picture, frame, t, outlines, _outlines(record, camera, call, call.t, drift), seen)


def _outlines(record: Record, camera: Camera, call: Call, t: float, drift: FloatArray) -> tuple[Outline, ...]:
    """The balls that take part, where the fit puts them at t (s)."""
    found = []
    for name in call.balls:
        place = record.place(record.number(name), t)
        if np.isfinite(place).all():
            centre = camera.to_pixels(place, record.table.ball_radius) + drift
            found.append(Outline(name, centre, float(camera.radius_px(place, record.table.ball_radius))))
    return tuple(found)


def _drift(record: Record, camera: Camera, t: float) -> FloatArray:
    """px (2,) by which the picture at t (s) has moved against the reference picture, as its balls show."""
    rows = np.abs(record.t - t) < 1e-9
    if not rows.any():
        return np.zeros(2)
    there = camera.to_pixels(record.xy[rows], record.table.ball_radius)
    shift: FloatArray = np.nanmedian(record.px[rows] - there, axis=0)
    return shift if np.isfinite(shift).all() else np.zeros(2)
