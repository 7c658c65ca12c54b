"""A clip as every player takes it: the file itself where it is plain H.264, else a re-encoded copy."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np

from video.io.clip import Clip, read_frames
from video.io.video_writer import VideoWriter

PLAYABLE_FORMATS = ("yuv420p", "yuvj420p")


def playable(clip: Clip, copy: Path) -> Path:
    """The clip's own file if browsers and the rerun viewer play it upright, else `copy`, written now (H.264 in mp4)."""
    return clip.path if _plays_everywhere(clip) else re_encoded(clip, copy)


def re_encoded(clip: Clip, copy: Path) -> Path:
    """`copy`, with every picture of the clip upright."""
    every_picture = np.arange(clip.frame_count)
    with VideoWriter(copy, clip.width, clip.height, clip.rate) as writer:
        for _, rgb in read_frames(clip, indices=every_picture):
            writer.write(rgb)
    return copy


def _plays_everywhere(clip: Clip) -> bool:
    """mp4 with unrotated 8-bit H.264 in square pixels."""
    if clip.path.is_dir() or not clip.whole:
        return False
    with av.open(str(clip.path.absolute()), metadata_errors="replace") as container:
        stream = container.streams.video[0]
        codec = stream.codec_context
        upright = (codec.width, codec.height) == (clip.width, clip.height)
        return (
            "mp4" in container.format.name
            and codec.name == "h264"
            and codec.pix_fmt in PLAYABLE_FORMATS
            and upright
            and not any(packet.is_corrupt for packet in container.demux(stream))
        )
