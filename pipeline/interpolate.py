"""Plain in-between frames of a clip: the chain up to its fit, then pictures to a video and, if wanted, to PNGs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from PIL import Image

from models.errors import OptionError
from models.fit import Trust
from pipeline.cache import Cache
from pipeline.chain import fit_graph, fitted, refuse_closed
from pipeline.graph import Watcher
from pipeline.options import RunOptions
from pipeline.publish import folder_aside
from pipeline.verdict import run_trust
from video.between import between, even_rate, times_between
from video.writer import VideoWriter

TICK = Fraction(1, 90000)
"""s, of videos whose pictures come unevenly."""


@dataclass(frozen=True, slots=True)
class Interpolated:
    """What came out."""

    pictures: int
    originals: int
    rate: float
    """Pictures per second, on average."""
    trust: Trust
    notes: tuple[str, ...]


def interpolate_clip(
    clip: Path, video: Path, frames: Path | None, factor: int, options: RunOptions, cache: Cache, watcher: Watcher
) -> Interpolated:
    """Write (D - 1) factor + 1 pictures of the D distinct ones of a clip, and as PNGs into `frames` if it is given.

    Raises a TruerollError, one sentence, where the clip cannot be used; nothing is left half-written then.
    """
    for place in (video.parent, *([frames] if frames is not None else [])):
        refuse_closed(place)
    if video.exists() and video.samefile(clip):
        raise OptionError(f"The video would overwrite the clip {clip} itself; name another with -o")
    if frames is not None and frames.is_dir() and any(frames.iterdir()):
        raise OptionError(f"--frames needs a new or an empty folder; {frames} holds files")
    seen, scene, tracks, fit = fitted(fit_graph(clip, options), clip, cache, watcher)
    progress, start = watcher.started("interpolate"), time.perf_counter()
    times, exact = times_between(seen, factor), even_rate(seen, factor)
    rate = exact or Fraction((len(times) - 1) / float(times[-1] - times[0])).limit_denominator(1001)
    video.parent.mkdir(parents=True, exist_ok=True)
    base = TICK if exact is None else None
    with VideoWriter(video, seen.width, seen.height, rate, crf=16, time_base=base) as writer, _folder(frames) as folder:
        for k, picture in enumerate(between(seen, scene, tracks, fit, factor)):
            writer.write(picture, None if base is None else float(times[k]))
            if folder is not None:
                Image.fromarray(picture).save(folder / f"{k:06d}.png", compress_level=1)
            progress((k + 1) / len(times))
    watcher.finished("interpolate", time.perf_counter() - start, False)
    return Interpolated(len(times), len(seen.distinct), float(rate), run_trust(seen, fit), seen.notes)


@contextmanager
def _folder(frames: Path | None) -> Iterator[Path | None]:
    """A folder to fill that appears as `frames` at the end, or None where no pictures are wanted."""
    if frames is None:
        yield None
        return
    frames.parent.mkdir(parents=True, exist_ok=True)
    with folder_aside(frames, frames.parent, f".{frames.name}.") as folder:
        yield folder
