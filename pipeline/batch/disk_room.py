"""What a batch will write, estimated before it writes anything, and whether the disks hold it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from models.core.errors import OptionError
from pipeline.stages.render_stage import SLOW_FILE
from video.io.video_options import RenderOptions

# Of a shot, mostly its page, and of each of its frames, mostly in the trajectory: 4.5 MB for 149 frames.
SHOT_BYTES, FRAME_BYTES = 3.5e6, 8e3
# Of a frame of the slow motion, and of each of its pixels: 12 kB at 720p and 19 kB at 1080p.
SLOW_FRAME_BYTES, SLOW_PIXEL_BYTES = 7e3, 0.0057
# By which the noise of a camera and the motion of people change these sizes.
ERROR_FACTOR = 2.0


@dataclass(frozen=True, slots=True)
class FilmLength:
    """A clip or a shot that is going to be run."""

    folder: Path
    """Folder of its results."""
    pixels: int
    """Of a frame."""
    frames: float


def estimate_bytes(films: Iterable[FilmLength], options: RenderOptions) -> float:
    """Estimate the size of the results of films, bytes; those that lie in their folders already are left out.

    The cache takes as much again.
    """
    last = "report.html" if options.no_video else SLOW_FILE
    slow = 0.0 if options.no_video else options.slow
    return sum(
        SHOT_BYTES + film.frames * (FRAME_BYTES + slow * (SLOW_FRAME_BYTES + SLOW_PIXEL_BYTES * film.pixels))
        for film in films
        if not (film.folder / last).exists()
    )


def describe_room(need: float, out: Path, cache: Path) -> str:
    """Say what results and cache will take, and what is free.

    Args:
        need: bytes of the results, and of the cache too.
        out: Folder of the results; it need not exist.
        cache: Folder of the cache.

    Returns:
        A sentence without a full stop.

    Raises:
        OptionError: Even half of it does not fit.
    """
    places = [_find_existing(out), _find_existing(cache)]
    disks = [os.stat(place).st_dev for place in places]
    free = [float(shutil.disk_usage(place).free) for place in places]
    fits = min(room / max(need * disks.count(disk), 1.0) for room, disk in zip(free, disks, strict=True))
    room = " and ".join(map(_format_bytes, free[: len(set(disks))]))
    sentence = f"about {_format_bytes(need)} of results and as much in the cache; {room} are free"
    advice = "free some, or use --no-video or a smaller --slow"
    if fits * ERROR_FACTOR < 1:
        raise OptionError(f"{sentence[0].upper()}{sentence[1:]}; {advice}")
    return sentence if fits >= 1 else f"{sentence}, which may not do: {advice}"


def _find_existing(folder: Path) -> Path:
    """Return a folder, or the nearest one above it that exists."""
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    return place


def _format_bytes(count: float) -> str:
    """Format a size with a unit of thousands."""
    return f"{count / 1e9:.3g} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
