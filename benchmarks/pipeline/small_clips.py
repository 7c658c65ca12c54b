"""Small clips for batches that run hundreds of times: pieces of the samples, at most a second long and scaled down."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_videos"
# Samples and the second at which their piece begins: a few balls, one of them struck.
SOURCES = (("carom_match", 0.3), ("overhead_pool", 0.1))


def write_small(
    source: Path,
    target: Path,
    *,
    height: int = 240,
    start: float = 0.2,
    seconds: float = 0.5,
    codec: str = "libx264",
    form: str = "yuv420p",
) -> Path:
    """Write a scaled piece of a video; the suffix of `target` selects the container."""
    with av.open(str(source)) as film, av.open(str(target), "w") as small:
        video = film.streams.video[0]
        rate = video.average_rate or Fraction(30)
        width = 2 * round(video.width * height / video.height / 2)
        fast = {"crf": "18", "preset": "veryfast"} if codec == "libx264" else {}
        stream = small.add_stream(codec, rate=rate, options=fast)
        stream.width, stream.height, stream.pix_fmt = width, height, form
        chosen = (p for p in film.decode(video) if p.time is not None and start <= p.time < start + seconds)
        for k, frame in enumerate(chosen):
            smaller = frame.reformat(width, height, form, interpolation="AREA")
            smaller.pts, smaller.time_base = k, 1 / rate
            small.mux(stream.encode(smaller))
        small.mux(stream.encode(None))
    return target


def write_clips(folder: Path, count: int) -> list[Path]:
    """Write `count` clips of different content, cut from the samples in turn."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for k in range(count):
        name, start = SOURCES[k % len(SOURCES)]
        later = 0.02 * (k // len(SOURCES))
        paths.append(write_small(SAMPLES / f"{name}.mp4", folder / f"{k:03d} {name}.mp4", start=start + later))
    return paths
