"""What a batch will write, estimated before it writes anything, and whether the disks hold it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from models.core.errors import OptionError
from video.io.video_options import RenderOptions

SHOT_BYTES = 2.5e6
"""Of the report, the recording and the tables of a shot; its page alone takes 1.6 MB."""
FRAME_PIXEL_BYTES = 0.05
"""Per pixel and frame of the clip, of what is kept besides the slow motion."""
SLOW_PIXEL_BYTES = 0.013
"""Per pixel and frame of the slow motion."""
ERROR_FACTOR = 2.0
"""By which noise of the camera and motion change these sizes."""


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
    last = "report.html" if options.no_video else "slow.mp4"
    slow = 0.0 if options.no_video else SLOW_PIXEL_BYTES * options.slow
    missing = [film for film in films if not (film.folder / last).exists()]
    return sum(SHOT_BYTES + film.frames * film.pixels * (FRAME_PIXEL_BYTES + slow) for film in missing)


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
    is_one_disk = os.stat(places[0]).st_dev == os.stat(places[1]).st_dev
    free = [float(shutil.disk_usage(place).free) for place in places]
    left = min(free[0] - 2 * need if is_one_disk else free[0] - need, free[1] - need)
    room = (
        f"{_format_bytes(free[0])} are free"
        if is_one_disk
        else f"{_format_bytes(free[0])} and {_format_bytes(free[1])} are free"
    )
    sentence = f"about {_format_bytes(need)} of results and as much in the cache {cache}; {room}"
    if left + (2 if is_one_disk else 1) * need * (1 - 1 / ERROR_FACTOR) < 0:
        raise OptionError(f"{sentence[0].upper()}{sentence[1:]}; free some, or use --no-video or a smaller --slow")
    return sentence if left >= 0 else f"{sentence}, which may not do: free some, or use --no-video or a smaller --slow"


def _find_existing(folder: Path) -> Path:
    """Return a folder, or the nearest one above it that exists."""
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    return place


def _format_bytes(count: float) -> str:
    """Format a size with a unit of thousands."""
    return f"{count / 1e9:.3g} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
