"""Playable files of clips: the original where it is plain H.264 in mp4, else a re-encoded copy."""

from __future__ import annotations

from pathlib import Path

import av

from video.io.clip import Clip, read_frames
from video.io.video_writer import VideoWriter

# Pixel formats that browsers and the rerun viewer can play.
PLAYABLE_FORMATS = ("yuv420p", "yuvj420p")


def ensure_playable(clip: Clip, copy_path: Path) -> Path:
    """Provide a file of the clip that browsers and the rerun viewer can play upright.

    Args:
        copy_path: the mp4 file to write where the original is not playable.

    Returns:
        The clip's own file where it is playable, else `copy_path`, now written as H.264.
    """
    return clip.path if _is_playable(clip) else re_encode_clip(clip, copy_path)


def re_encode_clip(clip: Clip, copy_path: Path) -> Path:
    """Write all frames of a clip upright as H.264 in mp4.

    Args:
        copy_path: the mp4 file to write.

    Returns:
        `copy_path`.
    """
    with VideoWriter(copy_path, clip.width, clip.height, clip.fps) as writer:
        for _, rgb in read_frames(clip, indices=clip.frames):
            writer.write(rgb)
    return copy_path


def _is_playable(clip: Clip) -> bool:
    """Check for mp4 with unrotated 8-bit H.264 in square pixels, without damage, fields or hidden frames."""
    if clip.path.is_dir() or not clip.is_whole_file:
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
            and stream.frames in (0, clip.frame_count)
            and not any(packet.is_corrupt for packet in container.demux(stream))
        )
