"""The least that a run needs: the clip decoded once, and its slow motion encoded once, in CPU seconds."""

from __future__ import annotations

import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av


def measure_cpu(work: Callable[[], None]) -> float:
    """Measure the CPU seconds of this process, all threads together."""
    began = time.process_time()
    work()
    return time.process_time() - began


def measure_mean_cpu(work: Callable[[], None]) -> float:
    """Measure the mean CPU seconds of two runs, because the speed of a shared machine varies."""
    return (measure_cpu(work) + measure_cpu(work)) / 2


def decode_clip(clip: Path) -> None:
    """Decode a clip."""
    with av.open(str(clip)) as film:
        film.streams.video[0].thread_type = "AUTO"
        film.streams.video[0].codec_context.thread_count = 2
        for _ in film.decode(video=0):
            pass


def encode_clip(slow: Path, target: Path) -> None:
    """Decode and encode a slow motion once more (libx264, veryfast, crf 20)."""
    with av.open(str(slow)) as film, av.open(str(target), "w") as again:
        video = film.streams.video[0]
        video.thread_type = "AUTO"
        stream = again.add_stream("libx264", rate=video.average_rate or Fraction(30))
        stream.width, stream.height, stream.pix_fmt = video.width, video.height, "yuv420p"
        stream.codec_context.options = {"crf": "20", "preset": "veryfast"}
        stream.codec_context.thread_count = 2
        for k, frame in enumerate(film.decode(video)):
            frame.pts, frame.time_base = k, 1 / Fraction(stream.codec_context.rate)
            again.mux(stream.encode(frame))
        again.mux(stream.encode(None))


def measure_least_cost(clip: Path, slow: Path, target: Path) -> tuple[float, float]:
    """Measure decoding a clip once, and encoding its slow motion once without decoding it.

    Args:
        slow: Its slow motion.
        target: File of the second encoding.

    Returns:
        CPU seconds of both.
    """
    encode = measure_mean_cpu(lambda: encode_clip(slow, target)) - measure_mean_cpu(lambda: decode_clip(slow))
    return measure_mean_cpu(lambda: decode_clip(clip)), encode
