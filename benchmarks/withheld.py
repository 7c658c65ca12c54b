"""Clips with pictures taken out: what remains is coded without loss, what was taken out is the truth to be made."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from PIL import Image

from video.io.clip import Clip, open_clip, read_frames

EVEN_SHARE = 0.15
"""Share of a step by which a withheld picture may be shown off its place: further, its moment is not known."""


@dataclass(frozen=True)
class Withheld:
    """A clip of which every `step`-th distinct picture is visible."""

    name: str
    source: Path
    thin: Path
    step: int
    frames: np.ndarray
    """(D,) frames of the source that the pictures between first and last visible one show; visible at k * step."""
    t: np.ndarray
    """(D,) s of those, by the source's clock."""

    @property
    def visible(self) -> np.ndarray:
        return self.frames[:: self.step]

    def hidden(self) -> list[int]:
        """Places in `frames` of the withheld pictures whose moment is where an even division of the gap puts it."""
        places = []
        for k in range(len(self.frames)):
            row, part = divmod(k, self.step)
            if part:
                first, last = self.t[[row * self.step, (row + 1) * self.step]]
                even = first + (last - first) * part / self.step
                if abs(self.t[k] - even) < EVEN_SHARE * (last - first) / self.step:
                    places.append(k)
        return places


def withhold(source: Path, step: int, folder: Path) -> Withheld:
    """Write the visible pictures of `source` to a clip of their own; their decoded colours stay bit for bit."""
    clip = open_clip(source)
    count = (len(clip.distinct) - 1) // step * step + 1
    frames = clip.distinct[:count]
    thin = folder / f"{source.stem}_1of{step}.mp4"
    if not thin.is_file():
        _write_visible(source, thin, set(frames[::step].tolist()))
        _check_same(clip, open_clip(thin), frames[::step])
    return Withheld(f"{source.stem} 1 of {step}", source, thin, step, frames, clip.t[frames])


def _write_visible(source: Path, thin: Path, visible: set[int]) -> None:
    with av.open(str(source)) as given, av.open(str(thin), "w") as made:
        film = given.streams.video[0]
        out = made.add_stream("libx264", rate=film.average_rate, options={"qp": "0", "preset": "veryfast", "bf": "0"})
        out.width, out.height, out.pix_fmt = film.width, film.height, "yuv420p"
        out.time_base = out.codec_context.time_base = film.time_base
        context, given_context = out.codec_context, film.codec_context
        context.colorspace, context.color_range = given_context.colorspace, given_context.color_range
        context.color_primaries, context.color_trc = given_context.color_primaries, given_context.color_trc
        for frame, picture in enumerate(given.decode(film)):
            if frame in visible:
                picture.pict_type = av.video.frame.PictureType.NONE
                made.mux(out.encode(picture))
        made.mux(out.encode(None))


def _check_same(source: Clip, thin: Clip, visible: np.ndarray) -> None:
    pairs = zip(read_frames(source, indices=visible), read_frames(thin, indices=range(thin.frame_count)), strict=True)
    if not all(np.array_equal(a, b) for (_, a), (_, b) in pairs):
        raise SystemExit(f"{thin.name} does not show the pictures of {source.name} bit for bit")


def pictures_of(held: Withheld) -> list[np.ndarray]:
    """All D pictures of the source, visible and withheld."""
    return [picture for _, picture in read_frames(open_clip(held.source), indices=held.frames)]


def made_by_trueroll(held: Withheld, *options: str) -> list[np.ndarray]:
    """What `trueroll interpolate` makes of the visible ones alone, as a process of its own: D pictures."""
    with tempfile.TemporaryDirectory() as folder:
        frames = Path(folder) / "frames"
        command = [str(Path(sys.executable).with_name("trueroll")), "interpolate", str(held.thin), "--factor"]
        command += [str(held.step), "-o", str(Path(folder) / "out.mp4"), "--frames", str(frames), *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{held.name}: {done.stderr.strip() or done.stdout.strip()}")
        made = [np.asarray(Image.open(path)) for path in sorted(frames.glob("*.png"))]
    if len(made) != len(held.frames):
        raise SystemExit(f"{held.name}: {len(made)} pictures were made of {len(held.frames)}; a repeat was seen anew")
    return made
