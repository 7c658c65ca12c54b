"""Decoding of video files with PyAV: containers to frames in presentation order."""

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
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from models.core.errors import ClipError
from video.io.image_sequence import LOCAL_FILES_ONLY, ImageSequence, decode_image_sequence, open_image_sequence

av.logging.set_level(None)  # decoder errors are reported as notes and exceptions, never on stderr

DECODER_THREADS = 2
"""Frames decoded in parallel; each costs the memory of one frame."""

TIMESTAMPED_FORMATS = ("mov", "matroska")
"""Formats that store a time for each frame; AVI only numbers its packets, transport streams may restart their clock."""
SEEK_MARGIN_S = 0.5
"""s before the wanted frame at which decoding starts: a frame just after a key frame may refer to one before it."""
TIME_TOLERANCE_S = 2e-4
"""s within which two times are equal: millisecond clocks round, and frames at 1000 fps are five times as far apart."""

NON_VIDEO_FORMATS = ("tty", "png_pipe", "jpeg_pipe", "image2", "bmp_pipe", "webp_pipe", "tiff_pipe", "svg_pipe")
"""Formats as which FFmpeg would read a text file or a still image."""


@dataclass(frozen=True, slots=True)
class FrameOrientation:
    """How a stored frame is rotated upright: first columns and rows are swapped, then each is reversed."""

    swap: bool = False
    mirror_x: bool = False
    mirror_y: bool = False

    def rotate_upright(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Rotate a stored image (H, W[, 3]) upright."""
        if self == FrameOrientation():
            return image
        rotated = image.swapaxes(0, 1) if self.swap else image
        rotated = rotated[:, ::-1] if self.mirror_x else rotated
        return np.ascontiguousarray(rotated[::-1] if self.mirror_y else rotated)


@contextmanager
def open_container(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video file, or a folder of numbered images, for decoding.

    Args:
        path: the file or folder.

    Yields:
        The container and its video stream. For a folder one `ImageSequence` takes both roles.

    Raises:
        ClipError: there is no video stream that can be decoded.
    """
    if path.is_dir():
        sequence = open_image_sequence(path)
        yield sequence, sequence
        return
    try:
        container = av.open(str(path.absolute()), options=LOCAL_FILES_ONLY, metadata_errors="replace")
    except (av.error.FFmpegError, OSError) as error:
        raise ClipError(
            f"{path.name} is not a readable video, or its index is truncated: {_describe_error(error)}"
        ) from error
    with container:
        yield container, _select_video_stream(container, path)


def _select_video_stream(container: Any, path: Path) -> Any:
    if container.format.name in NON_VIDEO_FORMATS:
        raise ClipError(f"{path.name} is not a video but {container.format.long_name}; give a clip of the shot")
    streams = [s for s in container.streams.video if not s.disposition & av.stream.Disposition.attached_pic]
    if not streams:
        content = "audio but no video" if container.streams.audio else "no video"
        raise ClipError(f"{path.name} contains {content}; give a clip of the shot")
    streams = [s for s in streams if s.codec_context is not None and s.codec_context.codec is not None]
    if not streams:
        raise ClipError(f"{path.name} is truncated or uses an unsupported codec; convert it to H.264")
    stream = max(streams, key=lambda s: (s.width or 0) * (s.height or 0))
    stream.thread_type, stream.codec_context.thread_count = "AUTO", DECODER_THREADS
    return stream


def demux_packets(container: Any, stream: Any) -> Iterator[Any]:
    """Yield the packets of a stream up to the end of the file.

    PyAV raises IndexError for streams that begin within a file, as in transport streams; by then everything is read.
    """
    with suppress(IndexError):
        yield from container.demux(stream)


def decode_frames(container: Any, stream: Any, damage: list[str] | None = None) -> Iterator[Any]:
    """Yield every frame that can be decoded, in presentation order; append decoding errors to `damage`."""
    errors = [] if damage is None else damage
    if isinstance(container, ImageSequence):
        yield from decode_image_sequence(container, errors)
        return
    packets = demux_packets(container, stream)
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError as error:  # the file is truncated or damaged here
            errors.append(_describe_error(error))
            packet = None
        yield from _decode_packet(stream, packet, errors)
        if packet is None:
            return


def decode_frames_from(container: Any, stream: Any, first: int, start_time: float) -> Iterator[Any]:
    """Yield every frame from index `first` of the file on; its presentation time is `start_time` s.

    Seeks to the key frame before it where timestamps identify the frame again; otherwise decodes from the beginning
    and counts.
    """
    if first == 0 or isinstance(container, ImageSequence):
        yield from islice(decode_frames(container, stream), first, None)
        return
    timed = container.format.name.startswith(TIMESTAMPED_FORMATS)
    zero = next(decode_frames(container, stream), None) if timed else None
    if zero is not None and zero.time is not None:
        after = _seek_frames(container, stream, zero.time + start_time)
        wanted_frame = next(after, None)
        if wanted_frame is not None:
            yield wanted_frame
            yield from after
            return
    container.seek(0)
    stream.codec_context.flush_buffers()
    yield from islice(decode_frames(container, stream), first, None)


def _seek_frames(container: Any, stream: Any, start_time: float) -> Iterator[Any]:
    """Yield the frames from the one at `start_time` s (container's clock) on; none where no frame has this time."""
    try:
        container.seek(max(int((start_time - SEEK_MARGIN_S) / stream.time_base), 0), stream=stream)
    except av.error.FFmpegError:
        return
    stream.codec_context.flush_buffers()
    has_begun = False
    for frame in decode_frames(container, stream):
        if not has_begun:
            if frame.time is None or frame.time > start_time + TIME_TOLERANCE_S:
                return
            has_begun = abs(frame.time - start_time) <= TIME_TOLERANCE_S
        if has_begun:
            yield frame


def _decode_packet(stream: Any, packet: Any, damage: list[str]) -> list[Any]:
    if packet is not None and packet.size == 0:  # the flush at the end is done once, with None
        return []
    try:
        return list(stream.codec_context.decode(packet))
    except av.error.EOFError:
        return []
    except av.error.FFmpegError as error:
        damage.append(_describe_error(error))
        return []


def read_orientation(frame: Any) -> FrameOrientation:
    """Read the rotation and mirroring that the container requests, rounded to a quarter turn.

    Call it for the first frame only: a frame whose side data was read is freed only by the garbage collector.
    """
    for data in frame.side_data:
        if data.type == av.sidedata.sidedata.Type.DISPLAYMATRIX:
            a, b, _, c, d = (int(v) for v in np.frombuffer(data, np.int32)[:5])
            swap = abs(a) < abs(b)
            return FrameOrientation(True, c < 0, b < 0) if swap else FrameOrientation(False, a < 0, d < 0)
    return FrameOrientation()


def convert_to_rgb(frame: Any) -> NDArray[np.uint8]:
    """Convert a frame to RGB (H, W, 3) as stored, not yet upright."""
    return _convert_frame(frame, "rgb24")


def _convert_frame(frame: Any, pixel_format: str) -> NDArray[np.uint8]:
    """Convert a frame to an array of its own; `VideoFrame.reformat` would leave a converter in every kept frame."""
    converted = VideoReformatter().reformat(frame, format=pixel_format, threads=1)
    pixels = np.asarray(converted.to_ndarray(), np.uint8)
    return pixels.copy() if converted is frame else pixels


def extract_luma(frame: Any) -> NDArray[np.uint8]:
    """Copy the luma plane (H, W) as stored, in 8 bits; a colour conversion would cost more than the decoding."""
    depth = _luma_depth(frame.format)
    if depth is None:
        return _convert_frame(frame, "gray")
    plane = frame.planes[0]
    if depth == 8:
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]
        return rows.copy()
    wide = np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)[: frame.height, : frame.width]
    return (wide >> (depth - 8)).astype(np.uint8)


def _luma_depth(pixel_format: Any) -> int | None:
    """Bits per sample of plane 0 if it stores only luma in 8 or 16 bit words; None for every other layout."""
    luma_first = pixel_format.name.startswith(("yuv4", "yuva4", "yuvj4", "nv12", "nv21", "gray"))
    if not luma_first or pixel_format.is_big_endian or len(pixel_format.components) == 2 or pixel_format.is_bit_stream:
        return None
    depth = int(pixel_format.components[0].bits)
    return depth if 8 <= depth <= 16 else None


def pixel_aspect_ratio(stream: Any) -> Fraction:
    """Width of a pixel over its height; 1 where the container does not store it."""
    return Fraction(stream.sample_aspect_ratio or 1)


def _describe_error(error: BaseException) -> str:
    return (getattr(error, "strerror", None) or str(error)).rstrip(".").lower()
