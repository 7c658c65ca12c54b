"""Files from others are only data: their content is neither run nor followed, and errors are one sentence."""

from __future__ import annotations

import json
import pickle
import zipfile
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from detectors.network.ball_model import open_ball_model
from models.core.errors import ClipError, ModelError
from models.core.scene import Table
from pipeline.engine.value_files import load_value
from pipeline.reporting.text.text_formatting import escape_text
from video.io.clip import open_clip
from video.io.timestamps import nominal_fps


def write_video(path: Path, rate: Fraction = Fraction(25), gap: int = 0, **metadata: str) -> Path:
    with av.open(str(path), "w") as container:
        container.metadata.update(metadata)
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for k in range(10):
            frame = av.VideoFrame.from_ndarray(np.full((64, 96, 3), 20 * k, np.uint8))
            frame.pts, frame.time_base = k + gap * (k > 5), 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def test_metadata_that_is_no_text_is_no_fault(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "a.mp4", title="xxxxxxxx")
    data = clip.read_bytes()
    assert b"xxxxxxxx" in data
    clip.write_bytes(data.replace(b"xxxxxxxx", b"\x80\xff\xfe\x81\xc3(\xa0\xa1"))
    assert open_clip(clip).frame_count == 10


@pytest.mark.parametrize("rate", [Fraction(1, 100), Fraction(100_000)])
def test_a_rate_at_which_nobody_films_is_refused_unless_another_is_given(tmp_path: Path, rate: Fraction) -> None:
    clip = write_video(tmp_path / "a.mov", rate=rate)
    with pytest.raises(ClipError, match="--fps"):
        open_clip(clip)
    assert open_clip(clip, fps=Fraction(30)).t[-1] == pytest.approx(0.3)


def test_times_without_a_common_step_have_a_rate_all_the_same() -> None:
    t = np.cumsum([0.0, 0.04, 0.04, 0.04, 1.0, 1.0, 1.0])
    assert nominal_fps(t, None) in (1, 25)
    assert nominal_fps(np.arange(7) / 30, None) == 30


def test_a_timestamp_years_ahead_is_refused(tmp_path: Path) -> None:
    assert open_clip(write_video(tmp_path / "a.mkv", gap=100)).t[-1] == pytest.approx(4.36)
    with pytest.raises(ClipError, match="after frame 5"):
        open_clip(write_video(tmp_path / "b.mkv", gap=10_000_000))


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXTINF:1,\n{path}\n",
        "ffconcat version 1.0\nfile '{path}'\n",
        "v=0\nc=IN IP4 127.0.0.1\nm=video 9 RTP/AVP 96\n",
    ],
)
def test_a_list_that_names_other_films_is_not_followed(tmp_path: Path, text: str) -> None:
    secret = write_video(tmp_path / "secret.mp4")
    listing = tmp_path / "list.mp4"
    listing.write_text(text.format(path=secret))
    with pytest.raises(ClipError):
        open_clip(listing)


class Trap:
    """Runs when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> object:
        return (Path.touch, (self.mark,))


def test_a_pickle_in_an_entry_of_the_cache_is_not_run(tmp_path: Path) -> None:
    mark = tmp_path / "run"
    with zipfile.ZipFile(tmp_path / "arrays.npz", "w") as arrays:
        array = np.empty(1, object)
        array[0] = Trap(mark)
        with arrays.open("corners.npy", "w") as file:
            np.lib.format.write_array(file, array, allow_pickle=True)
    (tmp_path / "value.json").write_text(json.dumps({"format": 1, "value": {"length": {"array": "corners"}}}))
    with pytest.raises((ValueError, KeyError)):
        load_value(Table, tmp_path)
    assert not mark.exists()


@pytest.mark.parametrize("kind", ["pickle", "nothing", "noise"])
def test_a_file_that_is_no_model_is_refused_and_not_run(tmp_path: Path, kind: str) -> None:
    mark, path = tmp_path / "run", tmp_path / "model.onnx"
    noise = np.random.default_rng(0).bytes(5000)
    path.write_bytes({"pickle": pickle.dumps(Trap(mark)), "nothing": b"", "noise": noise}[kind])
    with pytest.raises(ModelError):
        open_ball_model(path)
    assert not mark.exists()


def test_a_name_cannot_move_the_cursor_or_break_a_line() -> None:
    assert escape_text("a\x1b[2Jb\nc\udcff.mp4") == "a\ufffd[2Jb\ufffdc\ufffd.mp4"
    assert escape_text("Über 🎱.mp4") == "Über 🎱.mp4"
