"""Folders of numbered images, read like a video: the number of an image is its time."""

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

# Fewest numbered images that form a sequence.
MIN_IMAGES = 5
# Largest share of other files in the folder, such as notes or a thumbnail.
MAX_OTHER_SHARE = 0.2
# Largest share of numbers missing between the first and the last image; a folder of selected photos misses more.
MAX_MISSING_SHARE = 0.5
# Frame rate, 1/s, of numbered images unless --fps sets it; FFmpeg uses the same value.
SEQUENCE_FPS = Fraction(25)
# A file name split at its last number.
NUMBERED_NAME = re.compile(r"(?P<before>.*?)(?P<number>\d{1,18})(?P<after>\D*)", re.DOTALL)
# FFmpeg options that forbid a file to load anything over the network.
LOCAL_FILES_ONLY = {"protocol_whitelist": "file"}
# First bytes of png, jpeg, bmp, tiff (both byte orders), netpbm, exr and dpx files.
IMAGE_SIGNATURES = (
    b"\x89PNG\r\n\x1a\n",
    b"\xff\xd8\xff",
    b"BM",
    b"II*\x00",
    b"MM\x00*",
    b"P5",
    b"P6",
    b"v/1\x01",
    b"SDPX",
)
# FFmpeg's names of the image formats; files of any other format are not decoded here.
IMAGE_FORMATS = (
    "png_pipe", "jpeg_pipe", "bmp_pipe", "tiff_pipe", "webp_pipe", "pgm_pipe", "ppm_pipe", "exr_pipe", "dpx_pipe",
    "image2",
)  # fmt: skip


def is_image_sequence(folder: Path) -> bool:
    """Check whether a folder contains numbered images and little else.

    Args:
        folder: the folder to examine.

    Returns:
        True if it can be read as an image sequence; False also where it cannot be listed.
    """
    try:
        return len(find_numbered_images(folder)) >= MIN_IMAGES
    except OSError:
        return False


def find_numbered_images(folder: Path) -> dict[int, Path]:
    """Find the numbered images of a folder, in ascending order; empty where the folder is no sequence."""
    files = [path for path in folder.iterdir() if not path.name.startswith(".")]
    rows: dict[tuple[str, str], dict[int, Path]] = {}
    for path in files:
        if match := NUMBERED_NAME.fullmatch(path.name if not path.suffix[1:].isalpha() else path.stem):
            rows.setdefault((match["before"], match["after"] + path.suffix), {})[int(match["number"])] = path
    row = max(rows.values(), key=len, default={})
    least = len(files) * (1 - MAX_OTHER_SHARE)
    if len(row) < MIN_IMAGES or len(row) < least or len(row) < (max(row) - min(row) + 1) * (1 - MAX_MISSING_SHARE):
        return {}
    ordered = dict(sorted(row.items()))
    return ordered if _is_image_file(next(iter(ordered.values()))) else {}


def _is_image_file(path: Path) -> bool:
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(12)
    return head.startswith(IMAGE_SIGNATURES) or (head[:4] == b"RIFF" and head[8:] == b"WEBP")


def compute_sequence_digest(folder: Path) -> str:
    """Compute the SHA-256 (hexadecimal) of the numbers and contents of a folder's images."""
    whole = hashlib.sha256()
    for number, path in find_numbered_images(folder).items():
        with path.open("rb") as file:
            whole.update(f"{number} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return whole.hexdigest()


@dataclass(frozen=True, slots=True)
class _Streams:
    audio: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True)
class ImageSequence:
    """Numbered images of a folder, in the roles of both a PyAV container and its stream."""

    image_paths: dict[int, Path]
    streams: _Streams = field(default_factory=_Streams)
    guessed_rate: Fraction = SEQUENCE_FPS
    average_rate: Fraction = SEQUENCE_FPS
    time_base: Fraction = 1 / SEQUENCE_FPS
    sample_aspect_ratio: Fraction | None = None

    @property
    def duration(self) -> int:
        """Duration in units of the time base."""
        return max(self.image_paths) - min(self.image_paths) + 1


def open_image_sequence(folder: Path) -> ImageSequence:
    """Open a folder as an image sequence; raise ClipError where it is none."""
    images = find_numbered_images(folder)
    if not images:
        raise ClipError(
            f"{folder.name} is a folder without a sequence of numbered images; "
            "give a video file, or use `trueroll batch` for a folder of clips"
        )
    return ImageSequence(images)


def decode_image_sequence(sequence: ImageSequence, damage: list[str]) -> Iterator[Any]:
    """Yield the images that can be decoded, each at the time of its number; append decoding errors to `damage`."""
    first = min(sequence.image_paths)
    for number, path in sequence.image_paths.items():
        frame = _decode_image(path, damage)
        if frame is not None:
            frame.pts, frame.time_base = number - first, sequence.time_base
            yield frame


def _decode_image(path: Path, damage: list[str]) -> Any:
    try:
        if path.is_symlink() or not path.is_file():
            raise OSError("it is not a regular file")
        with av.open(str(path.absolute()), options=LOCAL_FILES_ONLY, metadata_errors="replace") as container:
            if container.format.name not in IMAGE_FORMATS or not container.streams.video:
                raise OSError("it is not an image")
            return next(container.decode(video=0), None)
    except (av.error.FFmpegError, OSError) as error:
        damage.append(f"{path.name}: {describe_error(error)}")
        return None


def describe_error(error: BaseException) -> str:
    """Describe an error in a few words."""
    return (getattr(error, "strerror", None) or str(error)).rstrip(".").lower()
