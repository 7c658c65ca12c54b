"""Plain in-between frames of a clip: the chain up to its fit, then pictures to a video and, if wanted, to PNGs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from models.errors import OptionError
from models.fit import Trust
from models.progress import Progress
from pipeline.cache import Cache
from pipeline.chain import fit_graph, fitted, refuse_closed
from pipeline.graph import Watcher
from pipeline.options import RunOptions
from pipeline.publish import folder_aside
from pipeline.verdict import run_trust
from video.between import between, even_rate, times_between
from video.clip import Clip
from video.writer import VideoWriter

Picture = NDArray[np.uint8]

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
    pictures = between(seen, scene, tracks, fit, factor)
    count = _written(seen, pictures, video, frames, factor, progress)
    watcher.finished("interpolate", time.perf_counter() - start, False)
    times = times_between(seen, factor)
    return Interpolated(
        count, len(seen.distinct), (count - 1) / float(times[-1] - times[0]), run_trust(seen, fit), seen.notes
    )


def _written(
    clip: Clip, pictures: Iterator[Picture], video: Path, frames: Path | None, factor: int, progress: Progress
) -> int:
    """Write the pictures to their places, all of which appear at the end; how many."""
    times, rate = times_between(clip, factor), even_rate(clip, factor)
    mean = Fraction((len(times) - 1) / float(times[-1] - times[0])).limit_denominator(1001)
    video.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        folder = None
        if frames is not None:
            frames.parent.mkdir(parents=True, exist_ok=True)
            folder = stack.enter_context(folder_aside(frames, frames.parent, f".{frames.name}."))
        base = None if rate is not None else TICK
        writer = stack.enter_context(VideoWriter(video, clip.width, clip.height, rate or mean, crf=16, time_base=base))
        for k, picture in enumerate(pictures):
            writer.write(picture, None if base is None else float(times[k]))
            if folder is not None:
                Image.fromarray(picture).save(folder / f"{k:06d}.png", compress_level=1)
            progress((k + 1) / len(times))
    return len(times)
