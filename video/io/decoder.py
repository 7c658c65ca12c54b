"""Decoding of video files with PyAV: containers to frames in presentation order.

Text, still images and sound are refused in `refused_files`.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import av
from av.filter import Graph

from models.core.errors import ClipError
from video.io.image_sequence import (
    LOCAL_FILES_ONLY,
    ImageSequence,
    decode_image_sequence,
    describe_error,
    open_image_sequence,
)
from video.io.refused_files import select_video_stream

av.logging.set_level(None)  # decoder errors are reported as notes and exceptions, never on stderr

# Frames decoded in parallel; each costs the memory of one frame.
DECODER_THREADS = 2

# Formats that store a time for each frame; AVI only numbers its packets, transport streams may restart their clock.
TIMESTAMPED_FORMATS = ("mov", "matroska")
# s before the wanted frame at which decoding starts: a frame just after a key frame may refer to one before it.
SEEK_MARGIN_S = 0.5
# s within which two times are equal: millisecond clocks round, and frames at 1000 fps are five times as far apart.
TIME_TOLERANCE_S = 2e-4

# Metadata with the rate at which the camera took frames. Apple's slow motion stores true timestamps instead.
CAPTURE_RATE_KEYS = ("com.android.capture.fps",)
# The same rate in the NonRealTimeMeta of Sony's XAVC, an XML that FFmpeg does not read.
SONY_CAPTURE_RATE = re.compile(rb'captureFps="(\d+(?:\.\d+)?)[pi]"', re.IGNORECASE)
# Bytes of a box of MP4 in which this XML is searched: it comes before the tables of samples and is some kB long.
HEADER_BYTES = 1 << 22

# Codecs whose packets hold a shown frame each, where there are no fields; others hide frames in packets of their own.
ONE_FRAME_CODECS = ("h264", "hevc")


@dataclass(slots=True)
class DecodingDamage:
    """Damage of a video, found while its frames are decoded.

    Most frames store only their difference from other frames; a damaged packet therefore spoils the frames after it, up
    to the next intact key frame, which is stored whole.
    """

    errors: list[str] = field(default_factory=list)
    """Descriptions of decoding errors."""
    is_current: bool = False
    """Whether the frame that was decoded last is damaged."""
    has_fields: bool = False
    """Whether frames were split into their fields."""
    lost: set[int] = field(default_factory=set)
    """Timestamps of the packets of which no frame came: FFmpeg omits frames of HEVC whose reference is missing."""
    _is_broken: bool = False
    _resumed_at: int | None = None
    """Timestamp of the key frame that ended the last damage; frames shown before it refer to damaged ones."""
    _damaged: set[int] = field(default_factory=set)
    """Timestamps of the damaged frames."""
    _recent: deque[int | None] = field(default_factory=lambda: deque(maxlen=DECODER_THREADS))
    """Timestamps of the packets that may still be in the decoder."""

    def note_packet(self, packet: Any, is_lost: bool) -> None:
        """Note a packet before its frames are judged; `is_lost` where the decoder refused it or one just before."""
        if packet.is_keyframe and not packet.is_corrupt:
            self._resumed_at = packet.pts if self._is_broken else None
            self._is_broken = False
        self._recent.append(packet.pts)
        if packet.pts is not None and not packet.is_discard:
            self.lost.add(packet.pts)
        self._is_broken |= packet.is_corrupt or is_lost
        is_leading = self._resumed_at is not None and packet.pts is not None and packet.pts < self._resumed_at
        if is_lost:
            self._damaged.update(pts for pts in self._recent if pts is not None)
        if (self._is_broken or is_leading) and packet.pts is not None:
            self._damaged.add(packet.pts)

    def judge_frame(self, frame: Any) -> bool:
        """Return whether a frame is damaged; one without a timestamp is as the frame before it."""
        if frame.is_corrupt:
            return True
        return self.is_current if frame.pts is None else frame.pts in self._damaged


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
            f"{path.name} is not a readable video, or its index is truncated: {describe_error(error)}"
        ) from error
    with container:
        stream = select_video_stream(container, path)
        stream.thread_type, stream.codec_context.thread_count = "AUTO", DECODER_THREADS
        yield container, stream


def demux_packets(container: Any, stream: Any) -> Iterator[Any]:
    """Yield the packets of a stream up to the end of the file.

    PyAV raises IndexError for streams that begin within a file, as in transport streams; by then everything is read.
    """
    with suppress(IndexError):
        yield from container.demux(stream)


def decode_frames(container: Any, stream: Any, damage: DecodingDamage | None = None) -> Iterator[Any]:
    """Yield every frame that can be decoded, in presentation order, each field of an interlaced one as a frame.

    Args:
        stream: its video stream.
        damage: collects errors; while a frame is yielded, it states whether this one is damaged.

    Yields:
        Frames of PyAV.
    """
    damage = damage or DecodingDamage()
    if isinstance(container, ImageSequence):
        yield from decode_image_sequence(container, damage.errors)
        return
    splitter, was_damaged = FieldSplitter(), False
    for frame in _decode_stored_frames(container, stream, damage):
        is_damaged = damage.judge_frame(frame)
        damage.lost.discard(frame.pts)
        damage.has_fields |= frame.interlaced_frame
        for image in splitter.split_fields(frame):
            damage.is_current = is_damaged or (was_damaged and image is not frame)  # fields are drawn from both
            yield image
        damage.is_current = was_damaged = is_damaged
    yield from splitter.split_fields(None)


def _decode_stored_frames(container: Any, stream: Any, damage: DecodingDamage) -> Iterator[Any]:
    """Yield every frame that can be decoded, as stored."""
    packets = demux_packets(container, stream)
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError as error:  # the file is truncated or damaged here
            damage.errors.append(describe_error(error))
            packet = None
        yield from _decode_packet(stream, packet, damage)
        if packet is None:
            return


def decode_frames_from(
    container: Any, stream: Any, first: int, start_time: float | None, damage: DecodingDamage | None = None
) -> Iterator[Any]:
    """Yield every frame from index `first` of the file on; the container states `start_time` s for it, None if unknown.

    Seeks to the key frame before it where timestamps identify the frame again; otherwise decodes from the beginning
    and counts.
    """
    if first == 0 or isinstance(container, ImageSequence):
        yield from islice(decode_frames(container, stream, damage), first, None)
        return
    timed = start_time is not None and container.format.name.startswith(TIMESTAMPED_FORMATS)
    zero = next(decode_frames(container, stream), None) if timed else None
    if start_time is not None and zero is not None and zero.time is not None:
        after = _seek_frames(container, stream, zero.time + start_time, damage)
        wanted_frame = next(after, None)
        if wanted_frame is not None:
            yield wanted_frame
            yield from after
            return
    container.seek(0)
    stream.codec_context.flush_buffers()
    yield from islice(decode_frames(container, stream, damage), first, None)


def _seek_frames(container: Any, stream: Any, start_time: float, damage: DecodingDamage | None) -> Iterator[Any]:
    """Yield the frames from the one at `start_time` s (container's clock) on; none where no frame has this time."""
    try:
        container.seek(max(int((start_time - SEEK_MARGIN_S) / stream.time_base), 0), stream=stream)
    except av.error.FFmpegError:
        return
    stream.codec_context.flush_buffers()
    has_begun = False
    for frame in decode_frames(container, stream, damage):
        if not has_begun:
            if frame.time is None or frame.time > start_time + TIME_TOLERANCE_S:
                return
            has_begun = abs(frame.time - start_time) <= TIME_TOLERANCE_S
        if has_begun:
            yield frame


def _decode_packet(stream: Any, packet: Any, damage: DecodingDamage) -> list[Any]:
    if packet is not None and packet.size == 0:  # the flush at the end is done once, with None
        return []
    frames: list[Any] = []
    error_count = len(damage.errors)
    try:
        frames = stream.codec_context.decode(packet)
    except av.error.EOFError:
        pass
    except av.error.FFmpegError as error:
        damage.errors.append(describe_error(error))
    if packet is not None:
        damage.note_packet(packet, is_lost=len(damage.errors) > error_count)
    return frames


def pixel_aspect_ratio(stream: Any) -> Fraction:
    """Width of a pixel over its height; 1 where the container does not store it."""
    return Fraction(stream.sample_aspect_ratio or 1)


def read_capture_rate(container: Any) -> Fraction | None:
    """Read the rate at which the camera took frames, 1/s; None where the file does not state it."""
    if isinstance(container, ImageSequence):
        return None
    stated = [container.metadata[key] for key in CAPTURE_RATE_KEYS if key in container.metadata]
    if container.format.name.startswith("mov"):
        stated += [match[1].decode() for box in _read_mp4_boxes(Path(container.name)) for match in
                   SONY_CAPTURE_RATE.finditer(box)]  # fmt: skip
    for text in stated:
        with suppress(ValueError, ZeroDivisionError):
            rate = Fraction(text).limit_denominator(1001)
            if rate > 0:
                return rate
    return None


def _read_mp4_boxes(path: Path) -> Iterator[bytes]:
    """Read the beginnings of the outer boxes of an MP4 file other than that of its samples."""
    with suppress(OSError), path.open("rb") as file:
        while len(head := file.read(16)) >= 8:
            size, kind = int.from_bytes(head[:4], "big"), head[4:8]
            size = int.from_bytes(head[8:], "big") if size == 1 else size
            start = file.tell() - len(head)
            if kind != b"mdat":
                yield file.read(min(size, HEADER_BYTES))
            if size < 8:  # the last box ends with the file
                return
            file.seek(start + size)


# FFmpeg filter that makes a frame of each field, in the order that the frame states, and passes progressive frames.
FIELD_FILTER = ("bwdif", "mode=send_field:parity=auto:deint=interlaced")


class FieldSplitter:
    """Splits frames that state to be interlaced; progressive frames before the first of them pass unchanged."""

    def __init__(self) -> None:
        self._graph: Graph | None = None

    def split_fields(self, frame: Any) -> Iterator[Any]:
        """Yield the frames that a frame completes; None yields the rest at the end of the video."""
        if self._graph is None and (frame is None or not frame.interlaced_frame):
            yield from () if frame is None else (frame,)
            return
        if self._graph is None:
            self._graph = _build_field_graph(frame)
        self._graph.push(frame)
        yield from pull_frames(self._graph)


def pull_frames(source: Any) -> Iterator[Any]:
    """Yield the frames that a filter or a graph of filters has ready."""
    while True:
        try:
            yield source.pull()
        except (av.error.BlockingIOError, av.error.EOFError):
            return


def _build_field_graph(frame: Any) -> Graph:
    """Build the filter graph for frames like this one."""
    graph = Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    graph.link_nodes(source, graph.add(*FIELD_FILTER), graph.add("buffersink")).configure()
    return graph
