"""A folder of numbered pictures as a clip: each picture has its number for a time."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

from models.core.errors import ClipError

FEWEST = 5
"""Pictures in a row; fewer are no film."""
MOST_OTHERS = 0.2
"""Share of the files beside the pictures: notes, a thumbnail. With more it is a folder of things."""
MOST_MISSING = 0.5
"""Share of the numbers that may be missing between the first and the last; photos of a holiday miss more."""
RATE = Fraction(25)
"""Pictures per second: numbers have no unit, and --fps gives them one. FFmpeg takes the same."""
NUMBERED = re.compile(r"(?P<before>.*?)(?P<number>\d{1,18})(?P<after>\D*)", re.DOTALL)
"""A name with its last number."""
FILES_ONLY = {"protocol_whitelist": "file"}
"""A film cannot send for another place: what it names is not fetched."""
HEADS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"II*\x00", b"MM\x00*", b"P5", b"P6", b"v/1\x01", b"SDPX")
"""First bytes of png, jpeg, bmp, tiff (both orders), netpbm, exr and dpx."""
FORMATS = (
    "png_pipe", "jpeg_pipe", "bmp_pipe", "tiff_pipe", "webp_pipe", "pgm_pipe", "ppm_pipe", "exr_pipe", "dpx_pipe",
    "image2",
)  # fmt: skip
"""What FFmpeg calls them: nothing else is decoded here, whatever a file of the folder holds."""


def is_sequence(folder: Path) -> bool:
    """Whether the folder holds numbered pictures and little else."""
    try:
        return len(numbered_pictures(folder)) >= FEWEST
    except OSError:
        return False


def numbered_pictures(folder: Path) -> dict[int, Path]:
    """The pictures of the folder by number, ascending; empty where it is no sequence."""
    files = [path for path in folder.iterdir() if not path.name.startswith(".")]
    rows: dict[tuple[str, str], dict[int, Path]] = {}
    for path in files:
        if found := NUMBERED.fullmatch(path.name if not path.suffix[1:].isalpha() else path.stem):
            rows.setdefault((found["before"], found["after"] + path.suffix), {})[int(found["number"])] = path
    row = max(rows.values(), key=len, default={})
    most = len(files) * (1 - MOST_OTHERS)
    if len(row) < FEWEST or len(row) < most or len(row) < (max(row) - min(row) + 1) * (1 - MOST_MISSING):
        return {}
    ordered = dict(sorted(row.items()))
    return ordered if _is_picture(next(iter(ordered.values()))) else {}


def _is_picture(path: Path) -> bool:
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(12)
    return head.startswith(HEADS) or (head[:4] == b"RIFF" and head[8:] == b"WEBP")


def sequence_digest(folder: Path) -> str:
    """SHA-256 over the numbers and bytes of the pictures."""
    whole = hashlib.sha256()
    for number, path in numbered_pictures(folder).items():
        with path.open("rb") as file:
            whole.update(f"{number} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return whole.hexdigest()


@dataclass(frozen=True, slots=True)
class _Streams:
    audio: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True)
class PictureRow:
    """Stands for both the container and the stream of a film."""

    pictures: dict[int, Path]
    streams: _Streams = field(default_factory=_Streams)
    guessed_rate: Fraction = RATE
    average_rate: Fraction = RATE
    time_base: Fraction = 1 / RATE
    sample_aspect_ratio: Fraction | None = None

    @property
    def duration(self) -> int:
        """In units of the time base."""
        return max(self.pictures) - min(self.pictures) + 1


def open_sequence(folder: Path) -> PictureRow:
    """ClipError where the folder is no sequence."""
    pictures = numbered_pictures(folder)
    if not pictures:
        raise ClipError(
            f"{folder.name} is a folder without a row of numbered pictures; "
            "give a video file, or use `trueroll batch` for a folder of clips"
        )
    return PictureRow(pictures)


def decoded_sequence(row: PictureRow, damage: list[str]) -> Iterator[Any]:
    """The pictures that can be decoded, each at the time of its number; what could not is told to `damage`."""
    first = min(row.pictures)
    for number, path in row.pictures.items():
        picture = _decoded(path, damage)
        if picture is not None:
            picture.pts, picture.time_base = number - first, row.time_base
            yield picture


def _decoded(path: Path, damage: list[str]) -> Any:
    try:
        if path.is_symlink() or not path.is_file():
            raise OSError("it is no ordinary file")
        with av.open(str(path.absolute()), options=FILES_ONLY, metadata_errors="replace") as container:
            if container.format.name not in FORMATS or not container.streams.video:
                raise OSError("it is no picture")
            return next(container.decode(video=0), None)
    except (av.error.FFmpegError, OSError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).rstrip(".").lower()
        damage.append(f"{path.name}: {reason}")
        return None
