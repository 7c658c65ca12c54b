"""Writes H.264 that browsers, ffplay and the rerun viewer play, with exact times."""

from __future__ import annotations

import os
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import av
import numpy as np
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc
from numpy.typing import NDArray

from models.core.errors import ClipError
from video.io.yuv_planes import FORMAT, planes_of

STEADY = "force-cfr=1:mbtree=0"
"""Parameters of x264 without which videos are not what they should be: `force-cfr` keeps the rerun 0.41 viewer from
hanging; how x264 0.165 spreads bits over a tree of blocks reads memory that nobody wrote, at 64 x 48 and 854 x 480 px
for two, so that two runs would differ in bytes now and then."""


class VideoWriter:
    """A video that appears under its name when it is complete, and not at all when something fails.

    H.264 in yuv420p, BT.709 limited range, tagged so. Picture k is shown at exactly k / rate: the stream's time base is
    1 / rate, and without B-frames there is no edit list. Pictures that come unevenly are written with a `time_base` (s)
    and the time of each; `rate` is then what it is on average. `tuning` holds parameters of x264 that differ from the
    preset's. A key frame comes each `key_s` s, for scrubbing. With `direct` it is written under its name at once: the
    caller then sees to it that the name is not yet the final one. An odd width or height is made even by repeating the
    last column or row, so pixel coordinates stay.
    """

    def __init__(
        self,
        path: Path,
        width: int,
        height: int,
        rate: Fraction,
        *,
        crf: int = 22,
        preset: str = "veryfast",
        tuning: str = "",
        threads: int = 2,
        key_s: float = 1.0,
        time_base: Fraction | None = None,
        direct: bool = False,
    ) -> None:
        if width < 2 or height < 2 or rate <= 0:
            raise ValueError(
                f"VideoWriter wants at least 2 x 2 px and a positive rate; got {width} x {height} at {rate}"
            )
        self._path = path
        self._aside = path if direct else path.with_name(f".{path.name}.{os.getpid()}.part")
        self._shape = (height, width, 3)
        self._pad = ((0, height % 2), (0, width % 2), (0, 0))
        self._count = 0
        self._last = -1
        self._container = _opened(self._aside)
        self._stream = self._container.add_stream("libx264", rate=rate)
        self._even = time_base is None
        context = self._stream.codec_context
        context.thread_count = threads
        context.gop_size = max(1, round(rate * key_s))
        self._base = 1 / rate if time_base is None else time_base
        self._set_up(crf, preset, tuning)

    def _set_up(self, crf: int, preset: str, tuning: str) -> None:
        context = self._stream.codec_context
        context.width, context.height = self._shape[1] + self._pad[1][1], self._shape[0] + self._pad[0][1]
        context.pix_fmt = FORMAT
        context.time_base = self._base
        context.max_b_frames = 0
        params = STEADY + (f":{tuning}" if tuning else "")
        context.options = {"crf": str(crf), "preset": preset, "x264-params": params}
        context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.BT709
        context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG

    def write(self, rgb: NDArray[np.uint8], at: float | None = None) -> None:
        """Append one picture: uint8 (height, width, 3); with a `time_base`, shown at `at` s, after the one before."""
        if (at is None) != self._even:
            raise ValueError("a picture has a time of its own exactly where the video has a time base")
        if rgb.shape != self._shape or rgb.dtype != np.uint8:
            raise ValueError(f"a picture of {self._shape} uint8 is wanted; got {rgb.shape} {rgb.dtype}")
        even = np.pad(rgb, self._pad, mode="edge") if self._pad != ((0, 0), (0, 0), (0, 0)) else rgb
        picture = planes_of(np.ascontiguousarray(even))
        self._last = self._count if at is None else max(round(at / self._base), self._last + 1)
        picture.pts, picture.time_base = self._last, self._base
        self._count += 1
        self._container.mux(self._stream.encode(picture))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._finish()
        finally:
            self._container.close()
            if kind is not None or self._aside != self._path:
                self._aside.unlink(missing_ok=True)

    def _finish(self) -> None:
        if self._count == 0:
            raise ValueError(f"{self._path.name} was closed before a picture was written")
        self._container.mux(self._stream.encode(None))
        self._container.close()
        os.replace(self._aside, self._path)


def _opened(aside: Path) -> av.container.OutputContainer:
    try:
        aside.touch()
        return av.open(str(aside), "w", format="mp4", options={"movflags": "+faststart"})
    except OSError as error:
        raise ClipError(
            f"a video was to be written to {aside.parent}, which cannot be written to: {error.strerror}"
        ) from error
