"""A sample of a clip for checks that must be fast: all timestamps, and the frames of its liveliest part."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from models.core.errors import ClipError
from models.core.typing import BoolArray, FloatArray, ImageArray
from video.io.clip import DEFAULT_FPS, MIN_DISTINCT_FRAMES, Clip, open_clip
from video.io.decoder import (
    DecodingDamage,
    decode_frames,
    decode_frames_from,
    demux_packets,
    open_container,
    pixel_aspect_ratio,
    read_capture_rate,
)
from video.io.duplicate_frames import FrameChangeMeter, classify_frames
from video.io.frame_layout import read_layout
from video.io.image_sequence import ImageSequence
from video.io.refused_files import require_readable_file
from video.io.timestamps import compute_presentation_times, even_times, find_camera_clock, nominal_fps

# Pixels that are decoded: 108 frames of 720p or 48 of 1080p, half a second on one core.
PIXEL_BUDGET = 100_000_000
# Fewest and most frames of a sample of a longer clip; more are no use.
FRAME_RANGE = (24, 300)
# Colour frames, spread over the sample, from which the table is located.
STILLS = 5
# px, width of the small grey frames.
THUMBNAIL_WIDTH = 320
# Start of FFmpeg's AVVideoEncParams: blocks, offset and size of a block, kind of quantiser, quantiser of the frame.
QUANTISER_STRUCT = "IxxxxQQii"
# Kinds of quantiser: AV_VIDEO_ENC_PARAMS_H264 and AV_VIDEO_ENC_PARAMS_MPEG2.
H264_KIND, MPEG2_KIND = 1, 2
# Frames whose quantiser is read; PyAV frees a frame late once its side data was read.
QUANTISER_FRAMES = 40


@dataclass(frozen=True, slots=True)
class ClipSample:
    """Timestamps of a whole clip, and the K frames of a part of it."""

    times: FloatArray
    """(T,) s, presentation times of all frames."""
    bits_per_pixel: float
    """Mean over the whole clip; NaN for images."""
    clip: Clip
    """The part that was decoded, as a clip of K frames."""
    thumbnails: ImageArray
    """(K, h, w) small grey frames."""
    stills: tuple[ImageArray, ...]
    """Colour frames (H, W, 3), evenly spread."""
    quantiser_step: float
    """Grey levels, mean step of the quantiser; NaN where the codec does not state it."""


@dataclass(slots=True)
class _PacketList:
    """Packets of a video in presentation order."""

    times: FloatArray
    size: FloatArray
    """(T,) bytes."""
    is_key: BoolArray
    fps: Fraction
    pixels: int
    clock_rate: float
    """Seconds of `times` per second of the container."""
    pixel_aspect: Fraction


def sample_clip(path: Path, *, fps: Fraction | None = None, aspect: Fraction | None = None) -> ClipSample:
    """Read the timestamps of a clip and decode its liveliest part.

    Args:
        path: A video, or a folder of numbered images.
        fps: Frame rate (1/s) instead of the container's.
        aspect: Width of a pixel over its height instead of the container's.

    Returns:
        The sample.

    Raises:
        ClipError: The file cannot be used; the message is one sentence for the user.
    """
    require_readable_file(path)
    packets = None if path.is_dir() else _read_packets(path, fps, aspect)
    if packets is None:
        clip = open_clip(path, fps=fps, aspect=aspect)
        return _decode_part(clip, clip.t, float("nan"))
    count = int(np.clip(PIXEL_BUDGET // max(packets.pixels, 1), *FRAME_RANGE))
    first, stop = _select_liveliest_part(packets, count)
    t = packets.times[first:stop]
    clip = Clip(
        path, "", 0, 0, packets.fps, t, np.zeros(len(t), np.bool_), False, (), first,
        stop - first == len(packets.times), pixel_aspect=packets.pixel_aspect, clock_rate=packets.clock_rate,
    )  # fmt: skip
    return _decode_part(clip, packets.times, float(8 * packets.size.mean() / packets.pixels))


def _read_packets(path: Path, rate: Fraction | None, aspect: Fraction | None) -> _PacketList | None:
    """Read the packets of a video without decoding them; None where they are too few, or state no size."""
    damage = DecodingDamage()
    with open_container(path) as (container, stream):
        packets = [p for p in _iterate_packets(container, stream) if p.size and not p.is_discard]
        pixels, fps = stream.width * stream.height, stream.guessed_rate or stream.average_rate or DEFAULT_FPS
        time_base, stated, capture_fps = stream.time_base, pixel_aspect_ratio(stream), read_capture_rate(container)
        container.seek(0)
        next(decode_frames(container, stream, damage), None)
    if len(packets) < MIN_DISTINCT_FRAMES or not pixels:
        return None
    has_times = all(p.pts is not None for p in packets)
    packets = sorted(packets, key=lambda p: p.pts) if has_times else packets
    times, _ = compute_presentation_times([p.pts for p in packets], [p.dts for p in packets], time_base, fps)
    size, is_key = np.array([p.size for p in packets], dtype=np.float64), np.array([p.is_keyframe for p in packets])
    if damage.has_fields:
        later = times + np.diff(times, append=2 * times[-1] - times[-2]) / 2
        times, size = np.stack([times, later], axis=1).ravel(), np.repeat(size / 2, 2)
        is_key = np.stack([is_key, np.zeros_like(is_key)], axis=1).ravel()
    aspect = stated if aspect is None else aspect
    if rate is not None:
        return _PacketList(even_times(len(times), rate), size, is_key, rate, pixels, 0.0, aspect)
    clock = find_camera_clock(times, fps, capture_fps)
    return _PacketList(clock.t, size, is_key, nominal_fps(clock.t, capture_fps), pixels, clock.rate, aspect)


def _iterate_packets(container: Any, stream: Any) -> Iterator[Any]:
    """Yield packets up to the first damage."""
    try:
        yield from demux_packets(container, stream)
    except av.error.FFmpegError:
        return


def _select_liveliest_part(packets: _PacketList, count: int) -> tuple[int, int]:
    """Select up to `count` frames from a key frame on whose other frames need the most bytes: there something moves."""
    total = len(packets.times)
    if total <= count:
        return 0, total
    moving = np.concatenate([[0.0], np.cumsum(np.where(packets.is_key, 0.0, packets.size))])
    starts = np.unique(np.append(np.flatnonzero(packets.is_key[: total - count + 1]), 0))
    first = int(starts[np.argmax(moving[starts + count] - moving[starts])])
    return first, first + count


def _decode_part(clip: Clip, times: FloatArray, bits_per_pixel: float) -> ClipSample:
    """Decode the frames of a clip once."""
    wanted = set(np.linspace(0, clip.frame_count - 1, STILLS).round().astype(int).tolist())
    meter, changes, thumbnails = FrameChangeMeter(), list[tuple[float, float]](), list[ImageArray]()
    stills, steps = list[ImageArray](), list[float]()
    layout, damage, damaged = None, DecodingDamage(), list[int]()
    with open_container(clip.path) as (container, stream):
        if not isinstance(container, ImageSequence):
            stream.codec_context.options = {"export_side_data": "venc_params"}
        frames = decode_frames_from(container, stream, clip.first_frame, clip.stored_start, damage)
        for k, frame in enumerate(frames):
            if k == clip.frame_count:
                break
            damaged += [clip.first_frame + k] * damage.is_current
            layout = read_layout(frame, clip.pixel_aspect) if layout is None else layout
            if k < QUANTISER_FRAMES:
                steps.append(_read_quantiser_step(frame))
            grey = layout.extract_luma(frame)
            changes.append(meter.measure_change(grey))
            size = (THUMBNAIL_WIDTH, max(round(THUMBNAIL_WIDTH * grey.shape[0] / grey.shape[1]), 1))
            thumbnails.append(np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8))
            if k in wanted:
                stills.append(layout.extract_rgb(frame))
    if layout is None:
        raise ClipError(f"{clip.path.name} contains no frame that can be decoded")
    decoded = len(thumbnails)
    steps = [step for step in steps if np.isfinite(step)]
    height, width = grey.shape
    is_duplicate, is_mixed, _ = classify_frames(changes, damage.has_fields)
    part = replace(
        clip,
        width=width,
        height=height,
        t=clip.t[:decoded],
        is_duplicate=is_duplicate | is_mixed,
        stored_scale=layout.stored_scale,
        unobserved_frames=tuple(damaged),
    )
    return ClipSample(
        times, bits_per_pixel, part, np.stack(thumbnails), tuple(stills),
        float(np.mean(steps)) if steps else float("nan"),
    )  # fmt: skip


def _read_quantiser_step(frame: Any) -> float:
    """Read the mean step of the quantiser of a frame, grey levels; NaN where the codec does not state it."""
    data = next((bytes(one) for one in getattr(frame, "side_data", ()) if one.type.name == "VIDEO_ENC_PARAMS"), None)
    if data is None:
        return float("nan")
    blocks, offset, size, kind, quantiser = struct.unpack_from(QUANTISER_STRUCT, data)
    if blocks:
        fields = np.frombuffer(data, np.uint8, offset=offset, count=blocks * size).reshape(blocks, size).view(np.int32)
        quantiser = quantiser + float(fields[:, 4].mean())
    if kind == H264_KIND:
        return float(0.625 * 2 ** (quantiser / 6))
    return 2.0 * quantiser if kind == MPEG2_KIND else float("nan")
