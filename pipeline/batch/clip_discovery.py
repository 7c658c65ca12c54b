"""Finds clips in a folder by their content, assigns a folder of results to each, and watches for new ones."""

from __future__ import annotations

import os
import shutil
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from models.core.errors import ClipError, OptionError
from pipeline.io.run_folder import SOURCE_FILE, STAGE_FILES
from video.io.clip_digest import FileState, read_file_state
from video.io.decoder import open_container
from video.io.image_sequence import is_image_sequence
from video.io.video_options import RenderOptions

# Names of the files of a run folder.
RESULT_NAMES = frozenset(name for names in STAGE_FILES.values() for name in names)
SUMMARY_NAMES = ("summary.csv", "summary.parquet", "summary.html")
RESERVED_NAMES = frozenset((*RESULT_NAMES, *SUMMARY_NAMES, SOURCE_FILE))
# A file with such a suffix counts as a clip even if its content is no video, so that the batch reports it.
VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".ts", ".mpg")
# Brands of ISO base media files (ISO 14496-12) that are still images.
STILL_BRANDS = (b"heic", b"heix", b"mif1", b"avif", b"crx ", b"jp2 ", b"jpx ")
# Formats of animated images, which are no recordings.
ANIMATION_FORMATS = ("gif", "apng", "webp_anim")
# GoPro names the small copy of GX010123.MP4 GL010123.LRV; other cameras keep the name.
SMALL_COPY_PREFIX = "GL"
# Difference of the lengths of a recording and its small copy, s and share: the copy may have another frame rate.
SAME_LENGTH_S, SAME_LENGTH_SHARE = 0.5, 0.02


@dataclass(frozen=True, slots=True)
class LeftOutFile:
    """A file below the folder of a batch that is not run."""

    path: Path
    original: Path | None = None
    """The clip of which it is a smaller copy; None for a file without video."""


@dataclass(frozen=True, slots=True)
class FolderContent:
    """The clips below a folder, and the other files."""

    clips: tuple[Path, ...]
    left_out: tuple[LeftOutFile, ...]


class VideoFacts(NamedTuple):
    """Size and length of a video, as its container states them."""

    pixels: int
    seconds: float
    """NaN where it states none."""
    frames: float = 0.0
    """0 where it states neither a length nor a rate."""


def survey_folder(folder: Path, excluded: Path | None = None) -> FolderContent:
    """Find every video below a folder, and every folder of numbered images, in the order of their names.

    Files are recognised by their content, in any container that FFmpeg reads. A file with the suffix of a video is
    included whatever its content, so that the batch reports it. Hidden files, links, special files and files written
    by runs are ignored; a smaller copy that a camera writes beside its recording is left out.

    Args:
        excluded: A folder that is not searched.

    Returns:
        Paths below `folder`.
    """
    clips, left_out = list[Path](), list[LeftOutFile]()
    for place, folders, files in os.walk(folder):
        here = Path(place)
        folders[:] = sorted(
            name
            for name in folders
            if not (name.startswith(".") or (here / name).is_symlink())
            and (excluded is None or (here / name).resolve() != excluded.resolve())
        )
        for name in [name for name in folders if is_image_sequence(here / name)]:
            folders.remove(name)
            clips.append(here / name)
        videos: dict[Path, VideoFacts | None] = {}
        for path in (here / name for name in sorted(files)):
            is_result = path.name in RESULT_NAMES and path.with_name(SOURCE_FILE).is_file()
            if path.name.startswith(".") or path.is_symlink() or not path.is_file() or is_result:
                continue
            facts = _probe_video(path, read_file_state(path))
            if facts is None and path.suffix.lower() not in VIDEO_SUFFIXES:
                left_out.append(LeftOutFile(path))
            else:
                videos[path] = facts
        originals = {path: _find_original(path, videos) for path in videos}
        clips += [path for path, original in originals.items() if original is None]
        left_out += [LeftOutFile(path, original) for path, original in originals.items() if original is not None]
    return FolderContent(tuple(clips), tuple(left_out))


@lru_cache(maxsize=4096)
def _probe_video(path: Path, state: FileState) -> VideoFacts | None:
    """Read size and length of a video in this state; None where the file contains no video."""
    try:
        with path.open("rb") as file:
            if file.read(12)[4:] in [b"ftyp" + brand for brand in STILL_BRANDS]:
                return None
        with open_container(path) as (container, stream):
            if container.format.name in ANIMATION_FORMATS:
                return None
            seconds = container.duration / 1e6 if container.duration else float("nan")  # FFmpeg's AV_TIME_BASE
            rate = float(stream.guessed_rate or stream.average_rate or 0)
            frames = float(np.nan_to_num(seconds * rate))
            return VideoFacts(stream.width * stream.height, seconds, frames) if stream.width else None
    except (ClipError, OSError):
        return None


def measure_film(clip: Path) -> VideoFacts:
    """Read size and length of a clip from its header; zeros where it states none, as a folder of images."""
    facts = _probe_video(clip, read_file_state(clip)) if clip.is_file() else None
    return facts or VideoFacts(0, 0.0)


def _find_original(path: Path, videos: Mapping[Path, VideoFacts | None]) -> Path | None:
    """Find the clip of the same name and length that has more pixels."""
    facts = videos[path]
    for other, larger in videos.items():
        if facts is None or larger is None or larger.pixels <= facts.pixels or not _share_name(path, other):
            continue
        if abs(larger.seconds - facts.seconds) <= max(SAME_LENGTH_S, SAME_LENGTH_SHARE * larger.seconds):
            return other
    return None


def _share_name(small: Path, large: Path) -> bool:
    """Whether two files are named as a small copy and its original."""
    one, other = small.stem.upper(), large.stem.upper()
    return one == other or (one.startswith(SMALL_COPY_PREFIX) and other[:1] == "G" and one[2:] == other[2:])


def order_largest_first(clips: Iterable[Path]) -> list[Path]:
    """Order clips so that several workers finish early: the largest first.

    Files of equal size may be copies. Copies that start together wait for each other, so all but the first of a size
    come last, when the cache has their result.

    Args:
        clips: Videos or folders of images.

    Returns:
        The same clips in the new order.
    """
    sizes: set[int] = set()
    first, repeated = list[Path](), list[Path]()
    for size, clip in sorted(((_measure_size(clip), clip) for clip in clips), key=lambda one: (-one[0], one[1])):
        (repeated if size in sizes else first).append(clip)
        sizes.add(size)
    return first + repeated


def _measure_size(clip: Path) -> int:
    """Return the size of a video or of a folder of images, bytes; 0 if it has disappeared."""
    with suppress(OSError):
        files = clip.iterdir() if clip.is_dir() else [clip]
        return sum(path.stat().st_size for path in files)
    return 0


def assign_folders(clips: Iterable[Path], root: Path, out: Path) -> dict[Path, Path]:
    """Assign a folder of results to each clip, mirroring the tree of the batch.

    A folder is named after the stem of its clip. The suffix is added where two clips would share a folder (a.mp4,
    a.mov), also if their names differ only in case, and where the folder would have the name of an output file.

    Args:
        clips: Clips below `root`.
        root: Folder of the batch.
        out: Folder of the results.

    Returns:
        The folder of each clip.
    """
    places = {clip: out / clip.relative_to(root).with_suffix("") for clip in clips}
    shared = Counter(str(place).lower() for place in places.values())
    taken = {place for place, count in shared.items() if count == 1 and Path(place).name not in RESERVED_NAMES}
    folders = {}
    for clip, place in places.items():
        if str(place).lower() not in taken:
            place = place.with_name(clip.name.replace(".", "_"))
            while str(place).lower() in taken or place.name in RESERVED_NAMES:
                place = place.with_name(f"{place.name[:200]}_")
            taken.add(str(place).lower())
        folders[clip] = place
    return folders


# Time between two searches of the folder, s.
POLL_INTERVAL_S = 1.0
# Time without a change after which a file counts as complete, s. A file that changes later is run again.
SETTLE_S = 3.0


def watch_folder(folder: Path, excluded: Path, idle_s: float | None) -> Iterator[Path | None]:
    """Yield the clips below a folder when they are complete, and again when they have changed.

    Args:
        excluded: A folder that is not searched.
        idle_s: Time without a new clip after which to end, s; None never ends.

    Yields:
        A clip, or None when there is none now.
    """
    observed: dict[Path, tuple[FileState, float]] = {}
    delivered: dict[Path, FileState] = {}
    last = time.monotonic()
    while idle_s is None or time.monotonic() - last < idle_s:
        began = time.monotonic()
        for clip in survey_folder(folder, excluded).clips:
            state = read_file_state(clip)
            if delivered.get(clip) == state:
                continue
            if observed.get(clip, (None, 0.0))[0] != state:
                observed[clip] = (state, began)
                last = began
            elif began - observed[clip][1] >= SETTLE_S:
                delivered[clip] = state
                yield clip
                last = time.monotonic()
        while time.monotonic() - began < POLL_INTERVAL_S:
            yield None


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
    last = STAGE_FILES["report" if options.no_video else "render"][0]
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
