"""Frames from memory equal decoded ones, and the memory stays within its budget."""

from __future__ import annotations

import pickle
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from video.io import clip as clip_module
from video.io.clip import Clip, open_clip, read_frames
from video.io.clip_digest import compute_clip_digest
from video.io.frame_memory import FrameMemory

WIDTH, HEIGHT, COUNT = 90, 64, 12
AMPLE = 10**9


def write_clip(folder: Path, form: str) -> Path:
    """Write a clip of noise: a video in a pixel format, or a folder of PNGs."""
    rng = np.random.default_rng(3)
    images = rng.integers(0, 256, (COUNT, HEIGHT, WIDTH, 3), dtype=np.uint8)
    if form == "png":
        (folder / "row").mkdir()
        for k, image in enumerate(images):
            Image.fromarray(image).save(folder / "row" / f"{k:03d}.png")
        return folder / "row"
    path = folder / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(30))
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, form
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return path


@pytest.fixture
def openings(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The file of every opening."""
    opened: list[Path] = []
    function = clip_module.open_container
    monkeypatch.setattr(clip_module, "open_container", lambda path: (opened.append(path), function(path))[1])
    return opened


def read_all(clip: Clip, grey: bool = False) -> list[np.ndarray]:
    return [image for _, image in read_frames(clip, indices=range(clip.frame_count), grey=grey)]


@pytest.mark.parametrize("form", ["yuv420p", "yuv444p10le", "png"])
def test_frames_from_memory_equal_decoded_ones(tmp_path: Path, form: str, openings: list[Path]) -> None:
    clip = open_clip(write_clip(tmp_path, form), memory=FrameMemory(AMPLE))
    openings.clear()
    for grey in (False, True):
        decoded = read_all(replace(clip, memory=None), grey)
        for image in read_all(clip, grey):
            image[:] = 0  # a reader may paint on its image
        assert all(map(np.array_equal, read_all(clip, grey), decoded))
    assert len(openings) == 2
    assert [frame for frame, _ in read_frames(clip, indices=[7, 2])] == [2, 7]


def test_a_cached_clip_fills_its_memory_in_the_first_pass(tmp_path: Path, openings: list[Path]) -> None:
    clip = replace(open_clip(write_clip(tmp_path, "yuv420p")), memory=FrameMemory(AMPLE))
    openings.clear()
    next(read_frames(clip))  # a pass that ends early keeps what it has decoded
    assert [frame for frame, _ in read_frames(clip, indices=[1])] == [1]
    assert len(openings) == 2
    assert len(read_all(clip)) == COUNT
    assert len(openings) == 2


def test_a_clip_that_does_not_fit_leaves_nothing_in_memory(tmp_path: Path, openings: list[Path]) -> None:
    memory = FrameMemory(4 * WIDTH * HEIGHT)
    clip = open_clip(write_clip(tmp_path, "yuv420p"), memory=memory)
    assert memory.is_exceeded
    assert memory.frames == []
    assert "more than" in memory.notes[0]
    openings.clear()
    assert all(map(np.array_equal, read_all(clip), read_all(replace(clip, memory=None))))
    assert memory.frames == []
    assert len(openings) == 2


def test_memory_ends_with_its_run_and_stays_in_its_process(tmp_path: Path) -> None:
    with FrameMemory(AMPLE) as memory:
        clip = open_clip(write_clip(tmp_path, "yuv420p"), memory=memory)
        assert memory.is_complete
        assert pickle.loads(pickle.dumps(clip)).memory.frames == []
        assert clip.extract_subclip(2, 9).memory is None
    assert memory.frames == []
    assert len(read_all(clip)) == COUNT
    assert memory.frames == []


def test_a_rewritten_file_has_another_digest(tmp_path: Path) -> None:
    path = tmp_path / "a"
    digests = []
    for content in (b"one", b"two", b"one"):
        path.write_bytes(content)
        digests.append(compute_clip_digest(path))
    assert digests[0] == digests[2] != digests[1]
