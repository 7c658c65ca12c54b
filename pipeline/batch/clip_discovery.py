"""Finds clips in a folder by their content, assigns a folder of results to each, and watches for new ones."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from pipeline.chain import STAGE_FILES
from pipeline.io.run_folder import SOURCE_FILE
from video.io.clip_digest import FileState, read_file_state
from video.io.image_sequence import is_image_sequence

RESULT_NAMES = frozenset(name for names in STAGE_FILES.values() for name in names)
"""Names of the files of a run folder."""
SUMMARY_NAMES = ("summary.csv", "summary.parquet", "summary.html")
RESERVED_NAMES = frozenset((*RESULT_NAMES, *SUMMARY_NAMES, SOURCE_FILE))
VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".ts", ".mpg")
"""A file with such a suffix counts as a clip even if its content is no video, so that the batch reports it."""
AUDIO_SUFFIXES = (".m4a", ".m4b", ".mka", ".weba", ".oga", ".opus", ".wma", ".mp3", ".wav", ".aac", ".flac")
"""Audio files that use the containers of videos."""
HEADER_BYTES = 400
"""Bytes that are read: two packets of an MPEG transport stream and more; other containers need fewer."""
PACKET_BYTES = 188
"""Size of a packet of an MPEG transport stream, bytes (ISO 13818-1)."""
SIGNATURES = (b"\x1a\x45\xdf\xa3", b"\x00\x00\x01\xba", b"\x30\x26\xb2\x75\x8e\x66", b"FLV\x01")
"""First bytes of Matroska and WebM, MPEG program streams, ASF and FLV."""
NON_VIDEO_BRANDS = (b"heic", b"heix", b"mif1", b"avif", b"crx ", b"jp2 ", b"jpx ", b"M4A ", b"M4B ")
"""Brands of ISO base media files (ISO 14496-12) that are images or audio."""


def find_clips(folder: Path, excluded: Path | None = None) -> Iterator[Path]:
    """Find every video below a folder, and every folder of numbered images, in the order of their names.

    Files are recognised by their first bytes. A file with the suffix of a video is included whatever its content, so
    that the batch reports it. Hidden files, links, special files and files written by runs are left out.

    Args:
        folder: The folder.
        excluded: A folder that is not searched.

    Yields:
        Paths below `folder`.
    """
    for place, folders, files in os.walk(folder):
        here = Path(place)
        folders[:] = sorted(name for name in folders if _should_enter(here / name, excluded))
        for name in [name for name in folders if is_image_sequence(here / name)]:
            folders.remove(name)
            yield here / name
        yield from (here / name for name in sorted(files) if is_clip(here / name))


def _should_enter(folder: Path, excluded: Path | None) -> bool:
    """Whether to search this subfolder."""
    if folder.name.startswith(".") or folder.is_symlink():
        return False
    return excluded is None or folder.resolve() != excluded.resolve()


def is_clip(path: Path) -> bool:
    """Whether this file is a video, by its first bytes or its name.

    Args:
        path: The file.

    Returns:
        False also for hidden files, links and files written by runs.
    """
    if path.name.startswith(".") or path.is_symlink() or not path.is_file() or _is_result(path):
        return False
    return path.suffix.lower() in VIDEO_SUFFIXES or (
        path.suffix.lower() not in AUDIO_SUFFIXES and _has_video_signature(path)
    )


def _is_result(path: Path) -> bool:
    """Whether a run wrote this file: its folder then notes the source clip."""
    return path.name in RESULT_NAMES and path.with_name(SOURCE_FILE).is_file()


def _has_video_signature(path: Path) -> bool:
    """Whether the first bytes are those of a video container."""
    try:
        with path.open("rb") as file:
            head = file.read(HEADER_BYTES)
    except OSError:
        return False
    if head[4:8] == b"ftyp":
        return head[8:12] not in NON_VIDEO_BRANDS
    if head[:4] == b"RIFF":
        return head[8:12] == b"AVI "
    transport = len(head) > PACKET_BYTES and head[0] == head[PACKET_BYTES] == 0x47
    return transport or head.startswith(SIGNATURES) or head[4:8] in (b"moov", b"mdat", b"wide")


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
            place = _make_unique(taken, place.with_name(clip.name.replace(".", "_")))
            taken.add(str(place).lower())
        folders[clip] = place
    return folders


def _make_unique(taken: set[str], place: Path) -> Path:
    """Append underscores to a path until it is unique."""
    while str(place).lower() in taken or place.name in RESERVED_NAMES:
        place = place.with_name(f"{place.name[:200]}_")
    return place


POLL_INTERVAL_S = 1.0
"""Time between two searches of the folder, s."""
SETTLE_S = 3.0
"""Time without a change after which a file counts as complete, s. A file that changes later is run again."""


def watch_folder(folder: Path, excluded: Path, idle_s: float | None) -> Iterator[Path | None]:
    """Yield the clips below a folder when they are complete, and again when they have changed.

    Args:
        folder: The folder.
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
        for clip in find_clips(folder, excluded):
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
