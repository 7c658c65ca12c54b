"""Clips of all kinds: times, orientation, bit depth, damage, and the messages for unusable files."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import struct
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from models.core.errors import ClipError
from models.core.typing import ImageArray
from video.io.clip import Clip, open_clip, read_frames, read_planes
from video.io.timestamps import compute_presentation_times, nominal_fps


def make_frames(count: int, width: int = 96, height: int = 64) -> list[ImageArray]:
    """Return frames whose brightness encodes their number, with a white mark in the top left corner."""
    images = []
    for k in range(count):
        image = np.full((height, width, 3), 20 + 7 * k, np.uint8)
        image[: height // 4, : width // 4] = 255
        images.append(image)
    return images


def write_video(
    path: Path, images: Iterable[ImageArray], ticks: Sequence[int] | None = None, base: Fraction = Fraction(1, 30),
    codec: str = "libx264", pix_fmt: str = "yuv420p", **options: str,
) -> Path:  # fmt: skip
    """Write a file with frame k presented at ticks[k] * base."""
    images = list(images)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.height, stream.width = images[0].shape[:2]
        stream.codec_context.time_base = base
        stream.pix_fmt, stream.options = pix_fmt, options
        for k, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = (k if ticks is None else ticks[k]), base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_broadcast(path: Path, seconds: int, *, sound: bool = False) -> bytes:
    """Write a transport stream of `seconds` s at 25 fps, with audio for its first second or without."""
    with av.open(str(path), "w", format="mpegts") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        voice = container.add_stream("mp2", rate=48000) if sound else None
        for k in range(25 * seconds):
            frame = av.VideoFrame.from_ndarray(np.full((64, 96, 3), 20 + k % 200, np.uint8))
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        if voice is not None:
            silence = av.AudioFrame.from_ndarray(np.zeros((1, 2 * 48000), np.int16), format="s16", layout="stereo")
            silence.sample_rate, silence.pts = 48000, 0
            container.mux(voice.encode(silence))
            container.mux(voice.encode(None))
    return path.read_bytes()


def read_frame_numbers(clip: Clip) -> list[int]:
    """Read the numbers that the frames of the clip show, in their order."""
    return [round((int(np.median(rgb)) - 20) / 7) for _, rgb in read_frames(clip, indices=range(clip.frame_count))]


def refusal_message(path: Path) -> str:
    with pytest.raises(ClipError) as refused:
        open_clip(path)
    return str(refused.value)


@pytest.mark.parametrize("rate", [Fraction(30000, 1001), Fraction(24000, 1001), Fraction(25), Fraction(60)])
def test_times_and_rate_are_those_of_the_container(tmp_path: Path, rate: Fraction) -> None:
    clip = open_clip(write_video(tmp_path / "a.mp4", make_frames(20), base=1 / rate))
    assert np.allclose(clip.t, np.arange(20) / float(rate), atol=1e-12)
    assert clip.fps == rate
    assert read_frame_numbers(clip) == list(range(20))


def test_a_variable_rate_keeps_each_frame_at_its_time(tmp_path: Path) -> None:
    ticks = [0, 33, 67, 100, 180, 213, 400, 433, 466, 500]
    clip = open_clip(write_video(tmp_path / "a.mp4", make_frames(10), ticks, Fraction(1, 1000)))
    assert np.allclose(clip.t, np.array(ticks) / 1000, atol=1e-12)
    assert clip.fps == 30


def test_the_first_presented_frame_is_at_zero_when_the_file_starts_later(tmp_path: Path) -> None:
    clip = open_clip(write_video(tmp_path / "a.mkv", make_frames(10), range(50, 60)))
    assert clip.t[0] == 0
    assert clip.t[9] == pytest.approx(0.3, abs=1e-3)


def test_fps_overrides_the_container(tmp_path: Path) -> None:
    clip = open_clip(write_video(tmp_path / "a.mp4", make_frames(12)), fps=Fraction(24000, 1001))
    assert np.allclose(clip.t, np.arange(12) * 1001 / 24000, atol=1e-12)
    assert clip.fps == Fraction(24000, 1001)
    assert clip.notes == ()


def test_a_faster_rate_than_that_of_the_container_is_no_broken_file(tmp_path: Path) -> None:
    assert open_clip(write_video(tmp_path / "a.mp4", make_frames(12)), fps=Fraction(240)).notes == ()


def test_a_stream_without_timestamps_gets_even_ones_and_a_note(tmp_path: Path) -> None:
    clip = open_clip(write_video(tmp_path / "a.h264", make_frames(20)))
    assert np.allclose(np.diff(clip.t), 1 / float(clip.fps))
    assert "no usable timestamps" in clip.notes[0]


def test_a_missing_and_a_backward_timestamp_are_placed_between_their_neighbours() -> None:
    t, note = compute_presentation_times([0, 1, None, 3, 2, 5, 6], [None] * 7, Fraction(1, 30), Fraction(30))
    assert np.allclose(t, np.arange(7) / 30)
    assert note.startswith("2 of 7")


def test_millisecond_rounding_does_not_hide_the_rate() -> None:
    t = np.round(np.arange(300) / (30000 / 1001), 3)
    assert nominal_fps(t, None) == Fraction(30000, 1001)


def test_frames_come_one_by_one_in_order_and_only_the_requested_ones(tmp_path: Path) -> None:
    clip = open_clip(write_video(tmp_path / "a.mp4", make_frames(20)))
    grey = dict(read_frames(clip, indices=[7, 3, 11], grey=True))
    assert list(grey) == [3, 7, 11]
    assert all(image.shape == (64, 96) and image.dtype == np.uint8 for image in grey.values())
    assert [frame for frame, _ in read_frames(clip)] == clip.distinct_frames.tolist()
    with pytest.raises(ValueError, match="frames 0 to 19"):
        read_frames(clip, indices=[20])


def test_the_digest_is_that_of_the_file(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", make_frames(8))
    assert open_clip(path).digest == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("matrix", "corner", "size"),
    [
        ((0, 1, -1, 0), "top right", (64, 96)),
        ((-1, 0, 0, -1), "bottom right", (96, 64)),
        ((0, -1, 1, 0), "bottom left", (64, 96)),
        ((-1, 0, 0, 1), "top right", (96, 64)),
    ],
    ids=["clockwise", "upside down", "anticlockwise", "mirrored"],
)
def test_the_display_matrix_rotates_frames_upright(
    tmp_path: Path, matrix: tuple[int, ...], corner: str, size: tuple[int, int]
) -> None:
    path = write_video(tmp_path / "a.mp4", make_frames(8))
    raw = bytearray(path.read_bytes())
    place = raw.index(b"tkhd") + 44  # ISO 14496-12, 8.3.2: the matrix of version 0
    a, b, c, d = (65536 * m for m in matrix)
    raw[place : place + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(raw)
    clip = open_clip(path)
    assert (clip.width, clip.height) == size
    _, rgb = next(read_frames(clip))
    _, grey = next(read_frames(clip, grey=True))
    row, column = (-4 if "bottom" in corner else 3), (-4 if "right" in corner else 3)
    assert rgb.shape == (clip.height, clip.width, 3)
    assert rgb[row, column].min() > 200
    assert grey[row, column] > 200
    assert np.count_nonzero(grey > 150) < 0.1 * grey.size
    _, (luma, chroma) = next(read_planes(clip))
    assert np.array_equal(luma, grey)
    assert chroma.shape == (clip.height // 2, clip.width // 2, 2)


@pytest.mark.parametrize(
    ("suffix", "codec", "pix_fmt"),
    [
        ("mkv", "libx264", "yuv420p10le"),
        ("mkv", "libx264", "yuv444p"),
        ("mkv", "ffv1", "gray"),
        ("mkv", "ffv1", "gray16le"),
        ("mkv", "ffv1", "bgr0"),
        ("avi", "mjpeg", "yuvj420p"),
        ("avi", "rawvideo", "yuyv422"),
        ("webm", "libvpx-vp9", "yuv420p"),
    ],
)
def test_any_pixel_format_is_read_alike(tmp_path: Path, suffix: str, codec: str, pix_fmt: str) -> None:
    clip = open_clip(write_video(tmp_path / f"a.{suffix}", make_frames(12), codec=codec, pix_fmt=pix_fmt))
    assert read_frame_numbers(clip) == list(range(12))
    greys = [int(np.median(grey)) for _, grey in read_frames(clip, grey=True)]
    assert np.all(np.diff(greys) > 2)
    assert 15 <= greys[0] <= 40
    neutral = [chroma for _, (_, chroma) in read_planes(clip)]
    assert all(np.abs(chroma.astype(int) - 128).max() <= 2 for chroma in neutral)


@pytest.mark.parametrize("pix_fmt", ["yuv420p", "yuv444p", "yuv420p10le"])
def test_planes_show_colour_on_its_own_side_of_neutral(tmp_path: Path, pix_fmt: str) -> None:
    images = [np.array([[[20 + 5 * k, 60, 200]]], np.uint8).repeat(64, 0).repeat(96, 1) for k in range(8)]
    clip = open_clip(write_video(tmp_path / "a.mkv", images, pix_fmt=pix_fmt))
    for _, (_, chroma) in read_planes(clip):
        assert chroma.shape == (32, 48, 2)
        assert chroma[..., 0].min() > 180
        assert chroma[..., 1].max() < 120


def test_odd_sizes_are_used_as_stored(tmp_path: Path) -> None:
    clip = open_clip(write_video(tmp_path / "a.mkv", make_frames(8, 97, 65), codec="libx264", pix_fmt="yuv444p"))
    assert next(read_frames(clip))[1].shape == (65, 97, 3)


def test_reading_can_stop_before_the_end(tmp_path: Path) -> None:
    clip = open_clip(write_video(tmp_path / "a.mp4", make_frames(30)))
    frames = read_frames(clip)
    assert next(frames)[0] == 0
    frames.close()  # type: ignore[attr-defined]


def test_no_frame_waits_for_the_garbage_collector(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", make_frames(30))
    gc.collect()
    gc.disable()
    try:
        for _ in read_frames(open_clip(path)):
            pass
        live_frames = sum(issubclass(type(item), av.VideoFrame) for item in gc.get_objects())
    finally:
        gc.enable()
    assert live_frames <= 3


def test_a_truncated_file_is_used_up_to_its_end(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (40, 64, 96, 3), np.uint8)
    path = write_video(tmp_path / "a.mkv", noise)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    clip = open_clip(path)
    assert 10 < clip.frame_count < 30
    assert len(read_frame_numbers(clip)) == clip.frame_count


def test_an_mp4_without_its_index_is_refused(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", make_frames(20))
    path.write_bytes(path.read_bytes()[:900])
    assert "index is truncated" in refusal_message(path)


def test_a_file_that_is_no_clip_gets_one_true_sentence(tmp_path: Path) -> None:
    files = {"empty.mp4": b"", "text.mp4": b"<html>no video</html>", "text.txt": b"hello world\n" * 50}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    assert "does not exist" in refusal_message(tmp_path / "missing.mp4")
    assert "is a folder" in refusal_message(tmp_path)
    assert "is empty" in refusal_message(tmp_path / "empty.mp4")
    assert "not a readable video" in refusal_message(tmp_path / "text.mp4")
    assert "not a video" in refusal_message(tmp_path / "text.txt")


def test_audio_stills_and_single_frames_are_refused(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    assert "audio but no video" in refusal_message(tmp_path / "a.wav")
    assert "1 distinct frame;" in refusal_message(write_video(tmp_path / "one.mp4", make_frames(1)))
    assert "4 distinct frames;" in refusal_message(write_video(tmp_path / "four.mp4", make_frames(4)))
    assert "16 x 16 px" in refusal_message(write_video(tmp_path / "small.mp4", make_frames(8, 16, 16)))


def test_the_decoder_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write_video(tmp_path / "a.mp4", make_frames(30, 320, 180), crf="5")
    raw = bytearray(path.read_bytes())
    raw[200:2000] = np.random.default_rng(1).integers(0, 255, 1800, np.uint8).tobytes()
    path.write_bytes(raw)
    capfd.readouterr()
    with contextlib.suppress(ClipError):
        open_clip(path)
    assert capfd.readouterr() == ("", "")


def test_opening_reports_its_progress(tmp_path: Path) -> None:
    reports: list[float] = []
    open_clip(write_video(tmp_path / "a.mp4", make_frames(20)), progress=reports.append)
    assert reports == sorted(reports)
    assert reports[-1] == 1.0
    assert len(reports) > 10


def test_a_stream_that_begins_within_a_broadcast_does_no_harm(tmp_path: Path) -> None:
    """The second stream starts far enough from both ends that FFmpeg's probing does not find it."""
    padding = b"\x47\x1f\xff\x10" + b"\xff" * 184
    alone = write_broadcast(tmp_path / "alone.ts", 8)
    parts = alone, 30_000 * padding, write_broadcast(tmp_path / "sound.ts", 1, sound=True), 3_000 * padding, alone
    late = tmp_path / "late.ts"
    late.write_bytes(b"".join(parts))
    assert open_clip(late).frame_count == 425
