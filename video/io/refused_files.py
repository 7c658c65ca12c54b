"""Files that are refused as a clip because they are no video, and the sentence that says so.

`require_readable_file` refuses by the path: what does not exist, devices, empty files and folders that are no sequence
of numbered images (whose sentences are in `image_sequence`). `select_video_stream` refuses by the content: text, a
still image, sound without video, a video without a known codec. A file that FFmpeg cannot open at all is refused in
`decoder.open_container`; videos of a wrong length, size or rate in `clip`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av

from models.core.errors import ClipError
from video.io.image_sequence import open_image_sequence

# Formats as which FFmpeg would read a text file or a still image.
NON_VIDEO_FORMATS = ("tty", "png_pipe", "jpeg_pipe", "image2", "bmp_pipe", "webp_pipe", "tiff_pipe", "svg_pipe")


def require_readable_file(path: Path) -> None:
    """Check that a path is a non-empty file or a folder of numbered images; a device would be read forever.

    Args:
        path: the path to check.

    Raises:
        ClipError: it is neither; the message is one sentence for the user.
    """
    if path.is_dir():
        open_image_sequence(path)
        return
    if not path.exists():
        raise ClipError(f"{path} does not exist; give a video file")
    if not path.is_file():
        raise ClipError(f"{path} is not a regular file; give a video file")
    if path.stat().st_size == 0:
        raise ClipError(f"{path.name} is empty (0 bytes); copy or download it again")


def select_video_stream(container: Any, path: Path) -> Any:
    """Select the largest video stream of a container; the cover image of a sound file is none.

    Args:
        container: an open container of PyAV.
        path: its file, for messages.

    Returns:
        The stream.

    Raises:
        ClipError: there is none that can be decoded; the message is one sentence for the user.
    """
    if container.format.name in NON_VIDEO_FORMATS:
        raise ClipError(f"{path.name} is not a video but {container.format.long_name}; give a clip of the shot")
    streams = [s for s in container.streams.video if not s.disposition & av.stream.Disposition.attached_pic]
    if not streams:
        content = "audio but no video" if container.streams.audio else "no video"
        raise ClipError(f"{path.name} contains {content}; give a clip of the shot")
    streams = [s for s in streams if s.codec_context is not None and s.codec_context.codec is not None]
    if not streams:
        raise ClipError(f"{path.name} is truncated or uses an unsupported codec; convert it to H.264")
    return max(streams, key=lambda s: (s.width or 0) * (s.height or 0))
