"""A clip as every player takes it: the file itself where it is plain H.264, else a re-encoded copy."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np

from video.clip import Clip, read_frames
from video.decoder import decoded, opened
from video.writer import VideoWriter

PLAYABLE_FORMATS = ("yuv420p", "yuvj420p")
SMOOTH_PX = 1.25e8
"""Pixels that may have to be decoded to show a picture, from the key frame before it on: 60 pictures of 1920 x 1080,
a quarter of a second on one core (benchmarks/recording.py), which is as long as a hand that scrubs will wait."""
LIGHT_CRF, LIGHT_PRESET = 22, "superfast"
"""How a copy is coded that is made for its key frames alone."""


def playable(clip: Clip, copy: Path) -> Path:
    """The clip's own file if browsers and the rerun viewer play it upright and jump to any picture of it at once.

    Else `copy`, written now: H.264 in mp4 with a key frame each second.
    """
    farthest = _decoded_at_most(clip)
    if farthest is None:
        return re_encoded(clip, copy)
    return clip.path if farthest * clip.width * clip.height <= SMOOTH_PX else with_key_frames(clip, copy)


def re_encoded(clip: Clip, copy: Path) -> Path:
    """`copy`, with every picture of the clip upright."""
    every_picture = np.arange(clip.frame_count)
    with VideoWriter(copy, clip.width, clip.height, clip.rate) as writer:
        for _, rgb in read_frames(clip, indices=every_picture):
            writer.write(rgb)
    return copy


def with_key_frames(clip: Clip, copy: Path) -> Path:
    """`copy`, with every picture of a clip that plays everywhere but is slow to jump in."""
    if clip.width % 2 or clip.height % 2:
        return re_encoded(clip, copy)
    with (
        opened(clip.path) as (container, stream),
        VideoWriter(copy, clip.width, clip.height, clip.rate, crf=LIGHT_CRF, preset=LIGHT_PRESET) as writer,
    ):
        for picture in decoded(container, stream):
            writer.write_decoded(picture)
    return copy


def _decoded_at_most(clip: Clip) -> int | None:
    """Pictures to decode before any one is shown; None where the file is not unrotated 8-bit H.264 in mp4."""
    if clip.path.is_dir() or not clip.whole:
        return None
    with av.open(str(clip.path.absolute()), metadata_errors="replace") as container:
        stream = container.streams.video[0]
        codec = stream.codec_context
        upright = (codec.width, codec.height) == (clip.width, clip.height)
        plain = codec.name == "h264" and codec.pix_fmt in PLAYABLE_FORMATS
        if not (upright and plain and "mp4" in container.format.name):
            return None
        packets = [packet for packet in container.demux(stream) if packet.size]
        if any(packet.is_corrupt for packet in packets):
            return None
        keys = [k for k, packet in enumerate(packets) if packet.is_keyframe]
        return int(np.diff([0, *keys, len(packets)]).max())
