"""Writing of H.264 videos with exact times, playable in browsers, ffplay and the rerun viewer."""

from __future__ import annotations

import os
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import av
import numpy as np
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc

from models.core.errors import ClipError
from video.io.clip import Clip, read_frames
from video.io.yuv_frame import Canvas, YuvFrame

# x264 parameters of all videos. `force-cfr`: without it the rerun 0.41 viewer hangs. `mbtree=0`: macroblock-tree rate
# control of x264 0.165 reads uninitialised memory (seen at 64 x 48 and 854 x 480 px), so that two runs may differ.
X264_PARAMETERS = "force-cfr=1:mbtree=0"


class VideoWriter:
    """Writes an H.264 video that appears under its name only when it is complete.

    Pixels are yuv420p in BT.709 limited range, and tagged so. Frame k is presented at exactly k / fps: the time base of
    the stream is 1 / fps, and without B-frames there is no edit list. An odd width or height is made even by repeating
    the last column or row, so pixel coordinates are unchanged. Use it as a context manager; after an exception no file
    remains.

    Args:
        path: the mp4 file to write.
        width: px of the frames.
        height: px of the frames.
        fps: frame rate, 1/s; the mean rate where `time_base` is given.
        crf: x264's constant rate factor; larger is smaller and worse.
        preset: x264's speed preset.
        tuning: x264 parameters that differ from those of the preset.
        threads: encoder threads.
        key_s: s between key frames, for scrubbing.
        time_base: s, clock of frames with uneven times; `write` then needs the time of each.
        direct: write under the final name at once; the caller is responsible for completeness.
    """

    def __init__(
        self,
        path: Path,
        width: int,
        height: int,
        fps: Fraction,
        *,
        crf: int = 22,
        preset: str = "veryfast",
        tuning: str = "",
        threads: int = 2,
        key_s: float = 1.0,
        time_base: Fraction | None = None,
        direct: bool = False,
    ) -> None:
        if width < 2 or height < 2 or fps <= 0:
            raise ValueError(f"VideoWriter needs at least 2 x 2 px and a positive fps; got {width} x {height} at {fps}")
        self._path = path
        self._part_path = path if direct else path.with_name(f".{path.name}.{os.getpid()}.part")
        self._shape = (height, width)
        self._count = 0
        self._last_pts = -1
        self._container = _open_output(self._part_path)
        self._stream = self._container.add_stream("libx264", rate=fps)
        self._is_constant_rate = time_base is None
        context = self._stream.codec_context
        context.thread_count = threads
        context.gop_size = max(1, round(fps * key_s))
        self._time_base = 1 / fps if time_base is None else time_base
        self._configure_codec(crf, preset, tuning)

    def _configure_codec(self, crf: int, preset: str, tuning: str) -> None:
        context = self._stream.codec_context
        context.height, context.width = (side + side % 2 for side in self._shape)
        context.pix_fmt = PIXEL_FORMAT
        context.time_base = self._time_base
        context.max_b_frames = 0
        params = X264_PARAMETERS + (f":{tuning}" if tuning else "")
        context.options = {"crf": str(crf), "preset": preset, "x264-params": params}
        context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.BT709
        context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG

    def write(self, image: Canvas, time: float | None = None) -> None:
        """Append one frame.

        Args:
            image: (H, W, 3) uint8 RGB, or a frame in the planes of the encoder.
            time: s, presentation time, after the previous frame; only for videos with a `time_base`.
        """
        if (time is None) != self._is_constant_rate:
            raise ValueError("frames have times of their own if and only if the video has a time base")
        if not isinstance(image, YuvFrame) and (image.dtype != np.uint8 or image.shape[2:] != (3,)):
            raise ValueError(f"RGB images of uint8 are needed; got {image.shape} {image.dtype}")
        if image.shape[:2] != self._shape:
            raise ValueError(f"frames of {self._shape} are needed; got {image.shape}")
        frame = build_encoder_frame(image)
        self._last_pts = self._count if time is None else max(round(time / self._time_base), self._last_pts + 1)
        frame.pts, frame.time_base = self._last_pts, self._time_base
        self._count += 1
        self._container.mux(self._stream.encode(frame))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._finish_file()
        finally:
            self._container.close()
            if kind is not None or self._part_path != self._path:
                self._part_path.unlink(missing_ok=True)

    def _finish_file(self) -> None:
        if self._count == 0:
            raise ValueError(f"{self._path.name} was closed before a frame was written")
        self._container.mux(self._stream.encode(None))
        self._container.close()
        os.replace(self._part_path, self._path)


def _open_output(part_path: Path) -> av.container.OutputContainer:
    try:
        part_path.touch()
        return av.open(str(part_path), "w", format="mp4", options={"movflags": "+faststart"})
    except OSError as error:
        raise ClipError(f"the video cannot be written to the folder {part_path.parent}: {error.strerror}") from error


PIXEL_FORMAT = "yuv420p"


def build_encoder_frame(image: Canvas) -> av.VideoFrame:
    """Copy the planes of a frame, or convert an image (H, W, 3) by `YuvFrame.from_rgb`."""
    planes = (image if isinstance(image, YuvFrame) else YuvFrame.from_rgb(image)).planes
    frame = av.VideoFrame(planes[0].shape[1], planes[0].shape[0], PIXEL_FORMAT)
    for plane, source in zip(frame.planes, planes, strict=True):
        rows = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)  # padded
        rows[:, : plane.width] = source
    return frame


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
