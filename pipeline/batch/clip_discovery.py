"""Clips in a folder, by what the files hold and not by their names, and a folder of results for each."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from pipeline.chain import FILES, SOURCE
from video.io.image_sequence import is_sequence

RESULTS = frozenset(name for names in FILES.values() for name in names)
"""Names of the files of a run."""
SUMMARIES = ("summary.csv", "summary.parquet", "summary.html")
OURS = frozenset((*RESULTS, *SUMMARIES, SOURCE))
FILMS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".ts", ".mpg")
"""Who names a file so wants to know what is wrong with it."""
SOUNDS = (".m4a", ".m4b", ".mka", ".weba", ".oga", ".opus", ".wma", ".mp3", ".wav", ".aac", ".flac")
"""Sound in the containers of films."""
HEAD = 400
"""bytes: two packets of an MPEG transport stream and a bit; every other container shows itself before."""
PACKET = 188
"""bytes of a packet of an MPEG transport stream (ISO 13818-1)."""
STARTS = (b"\x1a\x45\xdf\xa3", b"\x00\x00\x01\xba", b"\x30\x26\xb2\x75\x8e\x66", b"FLV\x01")
"""First bytes of Matroska and WebM, MPEG program streams, ASF and FLV."""
STILL_BRANDS = (b"heic", b"heix", b"mif1", b"avif", b"crx ", b"jp2 ", b"jpx ", b"M4A ", b"M4B ")
"""Brands of ISO base media files (ISO 14496-12) that are pictures or sound."""


def find_clips(folder: Path, besides: Path | None = None) -> Iterator[Path]:
    """Every film below `folder`, and every folder of numbered pictures, in the order of their names.

    Files are told by their first bytes; one that is named as a film and is none is among them, because whoever gave it
    wants to know. Left out: hidden files, links, what is no ordinary file, what runs made, and all below `besides`.
    """
    for place, folders, files in os.walk(folder):
        here = Path(place)
        folders[:] = sorted(name for name in folders if _is_entered(here / name, besides))
        for name in [name for name in folders if is_sequence(here / name)]:
            folders.remove(name)
            yield here / name
        yield from (here / name for name in sorted(files) if is_clip(here / name))


def _is_entered(folder: Path, besides: Path | None) -> bool:
    if folder.name.startswith(".") or folder.is_symlink():
        return False
    return besides is None or folder.resolve() != besides.resolve()


def is_clip(path: Path) -> bool:
    """Whether this file is a film, by its first bytes or else by its name."""
    if path.name.startswith(".") or path.is_symlink() or not path.is_file() or _is_result(path):
        return False
    return path.suffix.lower() in FILMS or (path.suffix.lower() not in SOUNDS and _starts_as_film(path))


def _is_result(path: Path) -> bool:
    """Whether a run wrote it: its folder notes which clip it was made of."""
    return path.name in RESULTS and path.with_name(SOURCE).is_file()


def _starts_as_film(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except OSError:
        return False
    if head[4:8] == b"ftyp":
        return head[8:12] not in STILL_BRANDS
    if head[:4] == b"RIFF":
        return head[8:12] == b"AVI "
    transport = len(head) > PACKET and head[0] == head[PACKET] == 0x47
    return transport or head.startswith(STARTS) or head[4:8] in (b"moov", b"mdat", b"wide")


def largest_first(clips: Iterable[Path]) -> list[Path]:
    """Clips in the order in which workers that share them end soonest: the longest one, taken last, would be waited
    for alone. Files of one size may be copies, and of copies that begin together one waits for the other; so all but
    the first of a size come after those, when they cost nothing."""
    sizes: set[int] = set()
    first, repeated = list[Path](), list[Path]()
    for size, clip in sorted(((_size(clip), clip) for clip in clips), key=lambda one: (-one[0], one[1])):
        (repeated if size in sizes else first).append(clip)
        sizes.add(size)
    return first + repeated


def _size(clip: Path) -> int:
    """Bytes of a film, or of a folder of pictures; 0 where it is gone meanwhile."""
    with suppress(OSError):
        files = clip.iterdir() if clip.is_dir() else [clip]
        return sum(path.stat().st_size for path in files)
    return 0


def folders_of(clips: Iterable[Path], root: Path, out: Path) -> dict[Path, Path]:
    """A folder per clip that mirrors the batch: by the stem, with the suffix where two clips would meet (a.mp4, a.mov),
    or where the folder would bear the name of a file of ours.

    Names that differ in case only meet on some file systems.
    """
    places = {clip: out / clip.relative_to(root).with_suffix("") for clip in clips}
    shared = Counter(str(place).lower() for place in places.values())
    taken = {place for place, count in shared.items() if count == 1 and Path(place).name not in OURS}
    found = {}
    for clip, place in places.items():
        if str(place).lower() not in taken:
            place = _unlike(taken, place.with_name(clip.name.replace(".", "_")))
            taken.add(str(place).lower())
        found[clip] = place
    return found


def _unlike(taken: set[str], place: Path) -> Path:
    """This place, or one with as many strokes as make it another."""
    while str(place).lower() in taken or place.name in OURS:
        place = place.with_name(f"{place.name[:200]}_")
    return place
