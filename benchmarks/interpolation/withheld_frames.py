"""Clips with withheld frames: the visible ones are stored losslessly, the withheld ones are the truth."""

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

# Largest deviation of a withheld frame from an even division of its gap, as a share of the frame interval.
EVEN_SHARE = 0.15


@dataclass(frozen=True)
class WithheldClip:
    """A clip of which every `step`-th distinct frame is visible."""

    name: str
    source: Path
    thin: Path
    step: int
    frames: np.ndarray
    """(D,) frames of the source from the first to the last visible one; visible at k * step."""
    t: np.ndarray
    """(D,) presentation times of those in the source, s."""

    @property
    def visible(self) -> np.ndarray:
        return self.frames[:: self.step]

    def withheld_places(self) -> list[int]:
        """Return the indices in `frames` of the withheld frames whose time divides their gap evenly."""
        places = []
        for k in range(len(self.frames)):
            row, part = divmod(k, self.step)
            if part:
                first, last = self.t[[row * self.step, (row + 1) * self.step]]
                even = first + (last - first) * part / self.step
                if abs(self.t[k] - even) < EVEN_SHARE * (last - first) / self.step:
                    places.append(k)
        return places


def withhold(source: Path, step: int, folder: Path) -> WithheldClip:
    """Write the visible frames of `source` to a clip; their decoded colours stay identical bit for bit."""
    clip = open_clip(source)
    count = (len(clip.distinct_frames) - 1) // step * step + 1
    frames = clip.distinct_frames[:count]
    thin = folder / f"{source.stem}_1of{step}.mp4"
    if not thin.is_file():
        _write_visible(source, thin, set(frames[::step].tolist()))
        _check_same(clip, open_clip(thin), frames[::step])
    return WithheldClip(f"{source.stem} 1 of {step}", source, thin, step, frames, clip.times_of(frames))


def _write_visible(source: Path, thin: Path, visible: set[int]) -> None:
    with av.open(str(source)) as container, av.open(str(thin), "w") as target:
        film = container.streams.video[0]
        out = target.add_stream("libx264", rate=film.average_rate, options={"qp": "0", "preset": "veryfast", "bf": "0"})
        out.width, out.height, out.pix_fmt = film.width, film.height, "yuv420p"
        out.time_base = out.codec_context.time_base = film.time_base
        context, film_context = out.codec_context, film.codec_context
        context.colorspace, context.color_range = film_context.colorspace, film_context.color_range
        context.color_primaries, context.color_trc = film_context.color_primaries, film_context.color_trc
        for number, frame in enumerate(container.decode(film)):
            if number in visible:
                frame.pict_type = av.video.frame.PictureType.NONE
                target.mux(out.encode(frame))
        target.mux(out.encode(None))


def _check_same(source: Clip, thin: Clip, visible: np.ndarray) -> None:
    pairs = zip(read_frames(source, indices=visible), read_frames(thin, indices=range(thin.frame_count)), strict=True)
    if not all(np.array_equal(a, b) for (_, a), (_, b) in pairs):
        raise SystemExit(f"{thin.path.name} does not contain the frames of {source.path.name} bit for bit")


def read_all_frames(withheld: WithheldClip) -> list[np.ndarray]:
    """Read all D frames of the source, visible and withheld."""
    return [image for _, image in read_frames(open_clip(withheld.source), indices=withheld.frames)]


def interpolate_with_trueroll(withheld: WithheldClip, *options: str) -> list[np.ndarray]:
    """Run `trueroll interpolate` on the visible frames as a process; returns D frames."""
    with tempfile.TemporaryDirectory() as folder:
        frames = Path(folder) / "frames"
        command = [str(Path(sys.executable).with_name("trueroll")), "interpolate", str(withheld.thin), "--factor"]
        command += [str(withheld.step), "-o", str(Path(folder) / "out.mp4"), "--frames", str(frames), *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{withheld.name}: {done.stderr.strip() or done.stdout.strip()}")
        images = [np.asarray(Image.open(path)) for path in sorted(frames.glob("*.png"))]
    if len(images) != len(withheld.frames):
        raise SystemExit(
            f"{withheld.name}: {len(images)} frames were made instead of {len(withheld.frames)}; "
            "a frame was taken for a duplicate"
        )
    return images
