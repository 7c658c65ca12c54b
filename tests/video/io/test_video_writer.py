"""Written videos, read back independently of the writer."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from models.core.errors import ClipError
from video.io.video_writer import VideoWriter

ROOT = Path(__file__).resolve().parents[3]


def draw_frame(k: int, width: int = 64, height: int = 48) -> NDArray[np.uint8]:
    rgb = np.full((height, width, 3), (30, 120, 60), np.uint8)
    rgb[10:30, 2 + k : 22 + k] = (220, 40, 30)
    return rgb


def write(path: Path, count: int, rate: Fraction, width: int = 64, height: int = 48) -> Path:
    with VideoWriter(path, width, height, rate) as video:
        for k in range(count):
            video.write(draw_frame(k, width, height))
    return path


@pytest.mark.parametrize("rate", [Fraction(25), Fraction(30000, 1001), Fraction(24859, 1000), Fraction(60)])
def test_every_frame_is_presented_at_exactly_its_time(tmp_path: Path, rate: Fraction) -> None:
    with av.open(str(write(tmp_path / "a.mp4", 30, rate))) as container:
        stream = container.streams.video[0]
        shown = [Fraction(frame.pts) * frame.time_base for frame in container.decode(stream)]
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.codec_context.name in {"h264", "libx264"}
    assert shown == [k / rate for k in range(30)]


def test_colours_come_back_as_they_went_in(tmp_path: Path) -> None:
    with av.open(str(write(tmp_path / "a.mp4", 5, Fraction(30)))) as container:
        first = next(container.decode(video=0)).to_ndarray(format="rgb24").astype(int)
    assert np.abs(first[20, 12] - (220, 40, 30)).max() <= 6
    assert np.abs(first[40, 50] - (30, 120, 60)).max() <= 4


def test_odd_sizes_are_padded_with_their_own_edge(tmp_path: Path) -> None:
    with av.open(str(write(tmp_path / "a.mp4", 5, Fraction(30), 65, 49))) as container:
        first = next(container.decode(video=0)).to_ndarray(format="rgb24").astype(int)
    assert first.shape == (50, 66, 3)
    assert np.abs(first[:, 65] - first[:, 64]).max() <= 6


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    one, two = (write(tmp_path / name, 40, Fraction(30)) for name in ("a.mp4", "b.mp4"))
    assert one.read_bytes() == two.read_bytes()


DIRTY = """
import hashlib, sys
from fractions import Fraction
from pathlib import Path
import numpy as np
from video.io.video_writer import VideoWriter

rng = np.random.default_rng(1)
cloth = rng.normal(90, 6, (520, 900, 1)) + np.array([0.0, 30.0, 60.0])
with VideoWriter(Path(sys.argv[1]), 854, 480, Fraction(30)) as video:
    for k in range(4):
        frame = np.clip(cloth[k : 480 + k, 2 * k : 854 + 2 * k] + rng.normal(0, 2, (480, 854, 1)), 0, 255)
        frame[440 + 3 * k : 470 + 3 * k, 780 + 9 * k : 810 + 9 * k] = (240, 40, 30)
        video.write(frame.astype(np.uint8))
print(hashlib.sha256(Path(sys.argv[1]).read_bytes()).hexdigest())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc fills fresh memory as one asks")
def test_the_bytes_do_not_depend_on_previous_memory_contents(tmp_path: Path) -> None:
    """At this size the macroblock tree of x264 reads uninitialised memory."""
    digests = set()
    for fill_byte in ("0", "3"):
        environment = os.environ | {"MALLOC_PERTURB_": fill_byte, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", DIRTY, str(tmp_path / f"{fill_byte}.mp4")]
        digests.add(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)
    assert len(digests) == 1


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_no_file_remains_when_writing_is_interrupted(tmp_path: Path, error: type[BaseException]) -> None:
    (tmp_path / "a.mp4").write_bytes(b"the one before")

    def broken() -> Iterator[int]:
        yield 0
        raise error

    def attempt() -> None:
        with VideoWriter(tmp_path / "a.mp4", 64, 48, Fraction(30)) as video:
            for k in broken():
                video.write(draw_frame(k))

    with pytest.raises(error):
        attempt()
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]
    assert (tmp_path / "a.mp4").read_bytes() == b"the one before"


def test_the_final_name_appears_only_when_everything_is_written(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", 64, 48, Fraction(30)) as video:
        video.write(draw_frame(0))
        assert not (tmp_path / "a.mp4").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_a_video_without_frames_and_frames_of_another_size_are_wrong_arguments(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="before a frame"), VideoWriter(tmp_path / "a.mp4", 64, 48, Fraction(30)):
        pass
    with VideoWriter(tmp_path / "b.mp4", 64, 48, Fraction(30)) as video:
        video.write(draw_frame(0))
        with pytest.raises(ValueError, match="are needed"):
            video.write(draw_frame(0, 48, 64))
    assert [p.name for p in tmp_path.iterdir()] == ["b.mp4"]


def test_a_missing_folder_gives_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="cannot be written to"):
        VideoWriter(tmp_path / "none" / "a.mp4", 64, 48, Fraction(30))
