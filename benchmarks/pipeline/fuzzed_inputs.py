"""Artificial video files for fuzzing: valid ones of unusual kinds, and corrupted copies."""

from __future__ import annotations

import os
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

from benchmarks.pipeline.small_clips import SAMPLES, write_small

SPOILT = ("flip", "truncate", "splice", "zero", "size", "repeat", "delete", "header")


# Videos of a shot: corruption in them reaches the later stages as frames.
TABLES = (
    ("table.mp4", "libx264", "yuv420p"), ("table.mkv", "libx264", "yuv420p"), ("table.mov", "mpeg4", "yuv420p"),
    ("table.avi", "mjpeg", "yuvj420p"), ("table.webm", "libvpx-vp9", "yuv420p"), ("table.ts", "mpeg2video", "yuv420p"),
)  # fmt: skip
# One in so many corrupted copies is of a video of a table, which takes a hundred times as long as one without.
TABLE_EVERY = 8

av.logging.set_level(None)


def write_inputs(folder: Path, count: int, rng: np.random.Generator) -> int:
    """Write each unusual kind once, then corrupted copies until there are `count` files; returns their number."""
    folder.mkdir(parents=True)
    kinds = folder / "kinds"
    kinds.mkdir()
    _write_kinds(kinds)
    whole = [
        path for path in sorted(kinds.iterdir()) if path.is_file() and not path.is_symlink() and path.stat().st_size
    ]
    small = [path for path in whole if path.stat().st_size < 200_000]
    done = len(list(kinds.iterdir()))
    tables = [path for path in whole if path.stem == "table"]
    for k in range(count - done):
        of = tables if k // len(SPOILT) % TABLE_EVERY == 0 else small
        source = of[int(rng.integers(len(of)))]
        how = SPOILT[k % len(SPOILT)]
        other = small[int(rng.integers(len(small)))].read_bytes()
        place = folder / f"{k // 250:02d}"
        place.mkdir(exist_ok=True)
        spoilt = spoil(source.read_bytes(), other, how, rng)
        (place / f"{k:05d} {how}{source.suffix}").write_bytes(spoilt)
    return max(count, done)


def spoil(data: bytes, other: bytes, how: str, rng: np.random.Generator) -> bytes:
    """Return the bytes with one kind of corruption."""
    size = len(data)
    at, length = int(rng.integers(size)), int(rng.integers(1, max(size // 4, 2)))
    match how:
        case "flip":
            spoilt = np.frombuffer(data, np.uint8).copy()
            for place in rng.integers(size, size=int(rng.integers(1, 200))):
                spoilt[place] ^= 1 << int(rng.integers(8))
            return spoilt.tobytes()
        case "truncate":
            return data[:at]
        case "splice":
            return data[:at] + other[int(rng.integers(len(other))) :]
        case "zero":
            return data[:at] + bytes(min(length, size - at)) + data[at + length :]
        case "size":  # a four-byte number near the start becomes huge, zero or negative
            at = int(rng.integers(min(size, 2048)))
            number = (0x7FFFFFFF, 0xFFFFFFFF, 0, 1, 0x80000000)[int(rng.integers(5))]
            return data[:at] + number.to_bytes(4, "big") + data[at + 4 :]
        case "repeat":
            return data[:at] + data[at : at + length] * 3 + data[at + length :]
        case "delete":
            return data[:at] + data[at + length :]
        case _:  # the first bytes of one file, the rest of another
            return other[: int(rng.integers(1, 512))] + data[int(rng.integers(1, 512)) :]


def _write_kinds(folder: Path) -> None:
    """Write one video of every unusual kind that this FFmpeg can encode."""
    for k, (name, codec, form) in enumerate(TABLES):
        sample = SAMPLES / ("overhead_pool.mp4" if k % 2 else "carom_match.mp4")
        write_small(sample, folder / name, height=180, seconds=0.4, codec=codec, form=form)
    for name, codec, form, size, rate in (
        ("plain.mp4", "libx264", "yuv420p", (96, 64), 25), ("plain.mov", "libx264", "yuv420p", (96, 64), 25),
        ("plain.mkv", "libx264", "yuv420p", (96, 64), 25), ("plain.avi", "mpeg4", "yuv420p", (96, 64), 25),
        ("plain.webm", "libvpx", "yuv420p", (96, 64), 25), ("plain.ts", "mpeg2video", "yuv420p", (96, 64), 25),
        ("mjpeg.avi", "mjpeg", "yuvj420p", (96, 64), 25), ("million.mov", "mjpeg", "yuvj420p", (96, 64), 1_000_000),
        ("slowest.mkv", "libx264", "yuv420p", (96, 64), Fraction(1, 1000)),
        ("hdr.mkv", "libx265", "yuv420p10le", (96, 64), 25),
        ("alpha.webm", "libvpx-vp9", "yuva420p", (96, 64), 25),
        ("alpha.mov", "prores_ks", "yuva444p10le", (96, 64), 25),
        ("alpha.mkv", "ffv1", "bgra", (96, 64), 25), ("huge.mkv", "png", "gray", (16384, 16384), 25),
        ("long.mkv", "mjpeg", "yuvj420p", (16384, 64), 25), ("tiny.mkv", "ffv1", "yuv420p", (2, 2), 25),
        ("lossless.mkv", "ffv1", "gray16le", (96, 64), 25), ("raw.avi", "rawvideo", "yuv420p", (96, 64), 25),
    ):  # fmt: skip
        _write_film(folder / name, codec, form, size, Fraction(rate), count=6 if size[0] > 8000 else 12)
    _write_film(
        folder / "interlaced.mkv", "libx264", "yuv420p", (96, 64), Fraction(25), options={"flags": "+ildct+ilme"}
    )
    _write_sound(folder / "sound.mp4")
    _write_sound(folder / "sound.mkv")
    (folder / "empty.mp4").touch()
    (folder / "text.mp4").write_text("this is no film\n" * 100)
    (folder / "page.mkv").write_text("<script>alert(1)</script>")
    (folder / "list.ts").write_text("#EXTM3U\n#EXTINF:1,\n/etc/passwd\n")
    (folder / "concat.mp4").write_text("ffconcat version 1.0\nfile '/etc/passwd'\n")
    (folder / "sparse.mp4").touch()
    os.truncate(folder / "sparse.mp4", 1 << 28)
    (folder / "loop.mp4").symlink_to(folder / "loop.mp4")
    (folder / "zero.mp4").symlink_to("/dev/zero")
    (folder / "above").symlink_to(folder, target_is_directory=True)
    os.mkfifo(folder / "pipe.mp4")
    Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(folder / "still.mp4", format="PNG")
    row = folder / "row"
    row.mkdir()
    for k in range(8):
        Image.fromarray(np.full((64, 96 + (k == 5), 3), 20 * k, np.uint8)).save(row / f"{k:04d}.png")


def _write_film(
    path: Path, codec: str, form: str, size: tuple[int, int], rate: Fraction, count: int = 12, options: Any = None
) -> None:
    try:
        with av.open(str(path), "w", options={"strict": "experimental"}) as film:
            stream = film.add_stream(codec, rate=rate, options=options or {})
            stream.width, stream.height, stream.pix_fmt = *size, form
            for k, image in enumerate(_generate_images(size, count)):
                frame = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=form)
                frame.pts, frame.time_base = k, 1 / rate
                film.mux(stream.encode(frame))
            film.mux(stream.encode(None))
    except (av.FFmpegError, ValueError, OSError):  # this build has no such encoder
        path.unlink(missing_ok=True)


def _generate_images(size: tuple[int, int], count: int) -> Iterator[np.ndarray]:
    for k in range(count):
        image = np.zeros((size[1], size[0]), np.uint8)
        image[: size[1] // 2, : (k + 1) * size[0] // count] = 200
        yield image


def _write_sound(path: Path) -> None:
    with av.open(str(path), "w") as film:
        stream = film.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.zeros((2, 1024), np.float32), format="fltp", layout="stereo")
        frame.rate = 44100
        film.mux(stream.encode(frame))
        film.mux(stream.encode(None))
