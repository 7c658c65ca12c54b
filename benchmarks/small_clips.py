"""Small clips for batches that are run hundreds of times: a second or less of a sample, a few hundred lines high."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av

ROOT = Path(__file__).resolve().parent.parent
SAMPLES = ROOT / "sample_videos"
SOURCES = (("carom_match", 0.3), ("overhead_pool", 0.1))
"""Sample and the second at which its piece begins: a few balls, of which one is struck."""


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
    """A piece of a film, made smaller; the name's suffix says the container."""
    with av.open(str(source)) as film, av.open(str(target), "w") as small:
        seen = film.streams.video[0]
        rate = seen.average_rate or Fraction(30)
        width = 2 * round(seen.width * height / seen.height / 2)
        fast = {"crf": "18", "preset": "veryfast"} if codec == "libx264" else {}
        stream = small.add_stream(codec, rate=rate, options=fast)
        stream.width, stream.height, stream.pix_fmt = width, height, form
        shown = (p for p in film.decode(seen) if p.time is not None and start <= p.time < start + seconds)
        for k, picture in enumerate(shown):
            smaller = picture.reformat(width, height, form, interpolation="AREA")
            smaller.pts, smaller.time_base = k, 1 / rate
            small.mux(stream.encode(smaller))
        small.mux(stream.encode(None))
    return target


def write_clips(folder: Path, count: int) -> list[Path]:
    """So many clips of different content, of the samples in turn."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for k in range(count):
        name, start = SOURCES[k % len(SOURCES)]
        later = 0.02 * (k // len(SOURCES))
        made.append(write_small(SAMPLES / f"{name}.mp4", folder / f"{k:03d} {name}.mp4", start=start + later))
    return made
