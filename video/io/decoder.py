"""From a file to decoded pictures, one after another, in presentation order."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from models.core.errors import ClipError
from video.io.image_sequence import FILES_ONLY, PictureRow, decoded_sequence, open_sequence

av.logging.set_level(None)  # the decoder's complaints become our sentences, never lines on stderr

THREADS = 2
"""Pictures decoded at a time; each costs one picture of memory."""

TIMED = ("mov", "matroska")
"""Formats with a time of its own for each picture; AVI numbers its packets, transport streams begin their time anew."""
JUMP_S = 0.5
"""s before a picture to which is jumped: a picture just after a key frame may lean on one before it."""
SAME_S = 2e-4
"""s within which two times are the same: millisecond containers round, and a thousand pictures per second differ by
five times as much."""

NO_FILM = ("tty", "png_pipe", "jpeg_pipe", "image2", "bmp_pipe", "webp_pipe", "tiff_pipe", "svg_pipe")
"""Formats by which FFmpeg takes a text or a still picture for a video."""


@dataclass(frozen=True, slots=True)
class Turn:
    """How a stored picture is put upright: columns and rows exchanged first, then each reversed."""

    swap: bool = False
    mirror_x: bool = False
    mirror_y: bool = False

    def upright(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The picture (H, W[, 3]) as it is meant to be seen."""
        if self == Turn():
            return picture
        turned = picture.swapaxes(0, 1) if self.swap else picture
        turned = turned[:, ::-1] if self.mirror_x else turned
        return np.ascontiguousarray(turned[::-1] if self.mirror_y else turned)


@contextmanager
def opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """The container and its picture stream; ClipError where there is none that can be decoded.

    For a folder of numbered pictures a row of them stands for both.
    """
    if path.is_dir():
        row = open_sequence(path)
        yield row, row
        return
    try:
        container = av.open(str(path.absolute()), options=FILES_ONLY, metadata_errors="replace")
    except (av.error.FFmpegError, OSError) as error:
        raise ClipError(
            f"{path.name} is no video that can be read, or its index is cut off: {_reason(error)}"
        ) from error
    with container:
        yield container, _picture_stream(container, path)


def _picture_stream(container: Any, path: Path) -> Any:
    if container.format.name in NO_FILM:
        raise ClipError(f"{path.name} is no video but {container.format.long_name}; give a clip of the shot")
    films = [s for s in container.streams.video if not s.disposition & av.stream.Disposition.attached_pic]
    if not films:
        has = "sound but no pictures" if container.streams.audio else "no pictures"
        raise ClipError(f"{path.name} holds {has}; give a clip of the shot")
    films = [s for s in films if s.codec_context is not None and s.codec_context.codec is not None]
    if not films:
        raise ClipError(f"{path.name} is cut off or coded in a way this decoder does not know; convert it to H.264")
    stream = max(films, key=lambda s: (s.width or 0) * (s.height or 0))
    stream.thread_type, stream.codec_context.thread_count = "AUTO", THREADS
    return stream


def packets_of(container: Any, stream: Any) -> Iterator[Any]:
    """Packets of a stream, to the end of the file.

    PyAV trips over streams that begin within a file, as they may in a transport stream; all is read by then.
    """
    with suppress(IndexError):
        yield from container.demux(stream)


def decoded(container: Any, stream: Any, damage: list[str] | None = None) -> Iterator[Any]:
    """Every picture that can be decoded, in presentation order; what could not is told to `damage`."""
    told = [] if damage is None else damage
    if isinstance(container, PictureRow):
        yield from decoded_sequence(container, told)
        return
    packets = packets_of(container, stream)
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError as error:  # the file breaks off or is spoilt here
            told.append(_reason(error))
            packet = None
        yield from _unpacked(stream, packet, told)
        if packet is None:
            return


def decoded_from(container: Any, stream: Any, first: int, begins: float) -> Iterator[Any]:
    """Every picture from number `first` of the file on, which is shown `begins` s after its first one.

    Jumps to the key frame before it where the timestamps allow to know it again, and counts from the beginning where
    they do not.
    """
    if first == 0 or isinstance(container, PictureRow):
        yield from islice(decoded(container, stream), first, None)
        return
    timed = container.format.name.startswith(TIMED)
    zero = next(decoded(container, stream), None) if timed else None
    if zero is not None and zero.time is not None:
        after = _jumped(container, stream, zero.time + begins)
        found = next(after, None)
        if found is not None:
            yield found
            yield from after
            return
    container.seek(0)
    stream.codec_context.flush_buffers()
    yield from islice(decoded(container, stream), first, None)


def _jumped(container: Any, stream: Any, wanted: float) -> Iterator[Any]:
    """Pictures from the one shown at `wanted` s on; none where no picture has just this time."""
    try:
        container.seek(max(int((wanted - JUMP_S) / stream.time_base), 0), stream=stream)
    except av.error.FFmpegError:
        return
    stream.codec_context.flush_buffers()
    begun = False
    for picture in decoded(container, stream):
        if not begun:
            if picture.time is None or picture.time > wanted + SAME_S:
                return
            begun = abs(picture.time - wanted) <= SAME_S
        if begun:
            yield picture


def _unpacked(stream: Any, packet: Any, told: list[str]) -> list[Any]:
    if packet is not None and packet.size == 0:  # the flush at the end is done once, with None
        return []
    try:
        return list(stream.codec_context.decode(packet))
    except av.error.EOFError:
        return []
    except av.error.FFmpegError as error:
        told.append(_reason(error))
        return []


def turn_of(picture: Any) -> Turn:
    """The rotation and mirroring that the container asks for, to the next quarter turn.

    To be asked of the first picture alone: a picture whose side data was looked at waits for the garbage collector.
    """
    for data in picture.side_data:
        if data.type == av.sidedata.sidedata.Type.DISPLAYMATRIX:
            a, b, _, c, d = (int(v) for v in np.frombuffer(data, np.int32)[:5])
            swap = abs(a) < abs(b)
            return Turn(True, c < 0, b < 0) if swap else Turn(False, a < 0, d < 0)
    return Turn()


def rgb_of(picture: Any) -> NDArray[np.uint8]:
    """(H, W, 3) as stored, not yet upright."""
    return np.asarray(picture.reformat(format="rgb24", threads=1).to_ndarray(), np.uint8)


def luma_of(picture: Any) -> NDArray[np.uint8]:
    """(H, W) of plane 0 as stored, 8 bits: no colour conversion, which would cost more than the decoding."""
    depth = _luma_depth(picture.format)
    if depth is None:
        return np.asarray(picture.to_ndarray(format="gray"), np.uint8)
    plane = picture.planes[0]
    if depth == 8:
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: picture.height, : picture.width]
        return rows.copy()
    wide = np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)[: picture.height, : picture.width]
    return (wide >> (depth - 8)).astype(np.uint8)


def _luma_depth(form: Any) -> int | None:
    """Bits of a plane 0 that holds luma alone, one sample per 8 or 16 bit word; None for every other layout."""
    luma_first = form.name.startswith(("yuv4", "yuva4", "yuvj4", "nv12", "nv21", "gray"))
    if not luma_first or form.is_big_endian or len(form.components) == 2 or form.is_bit_stream:
        return None
    depth = int(form.components[0].bits)
    return depth if 8 <= depth <= 16 else None


def pixel_aspect(stream: Any) -> Fraction:
    """Width of a pixel against its height; 1 where the container does not say."""
    return Fraction(stream.sample_aspect_ratio or 1)


def _reason(error: BaseException) -> str:
    return (getattr(error, "strerror", None) or str(error)).rstrip(".").lower()
