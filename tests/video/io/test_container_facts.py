"""A clip honours what its file states: colours, pixel aspect, fields, capture rate, hidden and lost frames."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from av.filter import Graph
from av.video.reformatter import ColorPrimaries, Colorspace, ColorTrc

from models.core.errors import ClipError
from models.core.srgb import decode_srgb
from models.core.typing import FloatArray, ImageArray
from video.filming_check.clip_sample import sample_clip
from video.io.clip import open_clip, read_frames

WIDTH, HEIGHT, COUNT = 192, 128, 40
PATCHES = np.array(
    [[255, 255, 255], [20, 130, 70], [220, 40, 40], [30, 40, 160], [230, 190, 40], [25, 25, 25], [120, 60, 150]],
    np.uint8,
)
"""sRGB: white, cloth, and the paint of balls."""
TO_BT2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
TO_P3 = np.array([[0.8225, 0.1774, 0.0], [0.0332, 0.9669, 0.0], [0.0171, 0.0724, 0.9108]])
"""Linear light of BT.709 to that of wider primaries (ITU-R BT.2087; SMPTE EG 432-1)."""


def encode_pq(nits: FloatArray) -> FloatArray:
    """Encode light by SMPTE ST 2084."""
    y = (nits / 10000) ** (2610 / 16384)
    return np.asarray(((3424 / 4096 + 2413 / 128 * y) / (1 + 2392 / 128 * y)) ** (2523 / 32))


def encode_hlg(nits: FloatArray) -> FloatArray:
    """Encode the light that a display of 1000 cd/m^2 shall show by BT.2100."""
    luminance = np.maximum(nits @ [0.2627, 0.6780, 0.0593], 1e-9)[..., None]
    scene = nits / 1000 * (luminance / 1000) ** (1 / 1.2 - 1)
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), a * np.log(np.maximum(12 * scene - b, 1e-9)) + c)


def encode_gamma(light: FloatArray) -> FloatArray:
    return np.asarray(np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


def draw_patches(count: int) -> ImageArray:
    """Draw stripes of the patches, the cloth wide, and a white bar that moves."""
    image = np.repeat(PATCHES[[1, 1, 1, 1, 0, 1, 2, 3, 4, 5, 6, 1]], WIDTH // 12, axis=0)[None].repeat(HEIGHT, axis=0)
    frames = np.stack([image] * count)
    for k, frame in enumerate(frames):
        frame[:16, 2 * k : 2 * k + 8] = 255
    return frames


def write_deep_video(path: Path, levels: FloatArray, trc: ColorTrc, primaries: ColorPrimaries) -> Path:
    """Write frames of levels 0 to 1 (T, H, W, 3) losslessly in 10 bits with these tags."""
    is_wide = primaries == ColorPrimaries.BT2020
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv444p10le"
        stream.options = {"qp": "0"}
        context = stream.codec_context
        context.color_trc, context.color_primaries, context.color_range = trc, primaries, 1
        context.colorspace = 9 if is_wide else 1
        for k, image in enumerate(levels):
            frame = av.VideoFrame.from_ndarray(
                np.rint(65535 * np.clip(image, 0, 1)).astype(np.uint16), format="rgb48le"
            )
            space = Colorspace.BT2020 if is_wide else Colorspace.ITU709
            frame = frame.reformat(format="yuv444p10le", dst_colorspace=space, dst_color_range=1)
            frame.pts, frame.time_base = k, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize("white", [100.0, 203.0, 1000.0])
@pytest.mark.parametrize("transfer", [ColorTrc.SMPTE2084, ColorTrc.ARIB_STD_B67], ids=["PQ", "HLG"])
def test_colours_of_high_dynamic_range_become_those_of_a_standard_display(
    tmp_path: Path, transfer: ColorTrc, white: float
) -> None:
    shown = draw_patches(24)
    encode: Callable[[FloatArray], FloatArray] = encode_pq if transfer == ColorTrc.SMPTE2084 else encode_hlg
    levels = encode(white * (decode_srgb(shown / 255) @ TO_BT2020.T))
    clip = open_clip(write_deep_video(tmp_path / "a.mp4", levels, transfer, ColorPrimaries.BT2020))
    (_, rgb), *_ = read_frames(clip, indices=[4])
    assert np.abs(rgb.astype(int) - shown[4]).max() <= 8
    assert any("are converted to those of a standard display" in note for note in clip.notes)
    assert np.abs(sample_clip(clip.path).stills[0].astype(int) - shown[0]).max() <= 8


def test_lamps_in_view_leave_the_table_bright(tmp_path: Path) -> None:
    """Beside a lamp of 1000 cd/m^2, a linear scale would give cloth of 9 cd/m^2 a level of 24."""
    shown = decode_srgb(draw_patches(8) / 255)
    nits = np.where(np.arange(WIDTH)[:, None] < 8, 1000.0, 40.0 * shown)
    levels = encode_pq(nits @ TO_BT2020.T)
    clip = open_clip(write_deep_video(tmp_path / "a.mp4", levels, ColorTrc.SMPTE2084, ColorPrimaries.BT2020))
    (_, rgb), *_ = read_frames(clip, indices=[4])
    assert 45 < rgb[100, 40, 1] < 130


def test_a_wide_gamut_becomes_that_of_a_standard_display(tmp_path: Path) -> None:
    shown = draw_patches(8)
    levels = encode_gamma(decode_srgb(shown / 255) @ TO_P3.T)
    clip = open_clip(write_deep_video(tmp_path / "a.mp4", levels, ColorTrc.BT709, ColorPrimaries.SMPTE432))
    (_, rgb), *_ = read_frames(clip, indices=[4])
    assert np.abs(rgb.astype(int) - shown[4]).max() <= 4


def test_a_frame_in_standard_colours_is_not_converted_twice(tmp_path: Path) -> None:
    shown = draw_patches(8)
    clip = open_clip(write_deep_video(tmp_path / "a.mp4", shown / 255, ColorTrc.BT709, ColorPrimaries.BT709))
    (_, rgb), *_ = read_frames(clip, indices=[4])
    assert np.abs(rgb.astype(int) - shown[4]).max() <= 2
    assert clip.notes == ()


def write_plain_video(
    path: Path, images: ImageArray, *, options: dict[str, str] | None = None, **settings: Any
) -> Path:
    """Write frames at 30 fps as H.264.

    Args:
        path: the file.
        images: (T, H, W, 3).
        options: options of the container.
        settings: attributes of the codec; `encoder` are its options, `metadata` is that of the container, `field_order`
            is tff or bff.

    Returns:
        The file.
    """
    order = settings.pop("field_order", "")
    with av.open(str(path), "w", options=options or {}) as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "10", **settings.pop("encoder", {})}
        container.metadata.update(settings.pop("metadata", {}))
        for name, value in settings.items():
            setattr(stream.codec_context, name, value)
        for k, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 30)
            container.mux(stream.encode(mark_interlaced(frame, order) if order else frame))
        container.mux(stream.encode(None))
    return path


def mark_interlaced(frame: Any, order: str) -> Any:
    """Mark a frame as interlaced, which PyAV can by a filter only."""
    graph = Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    graph.link_nodes(source, graph.add("setfield", order), graph.add("buffersink")).configure()
    graph.push(frame)
    return graph.pull()


def draw_moving_disc(count: int, stretch: tuple[float, float] = (1.0, 1.0), step: float = 3.0) -> ImageArray:
    """Draw a disc that moves to the right by `step` px per frame, as an ellipse of half axes 12 times `stretch`."""
    images = np.full((count, HEIGHT, WIDTH, 3), 60, np.uint8)
    for k, image in enumerate(images):
        centre = (round(16 * (30 + step * k)), 16 * 64)
        axes = (round(16 * 12 * stretch[0]), round(16 * 12 * stretch[1]))
        cv2.ellipse(image, centre, axes, 0, 0, 360, (230, 230, 230), -1, cv2.LINE_AA, 4)
    return images


def measure_disc(image: ImageArray) -> tuple[float, float, float]:
    """Measure where the disc is along x, and its width and height, px."""
    bright = np.maximum(image[..., 1].astype(float) - 80, 0)
    x, y = bright.sum(axis=0), bright.sum(axis=1)
    return (
        float((x * np.arange(len(x))).sum() / x.sum()),
        float(np.count_nonzero(x > 0.1 * x.max())),
        float(np.count_nonzero(y > 0.1 * y.max())),
    )


@pytest.mark.parametrize(
    ("aspect", "size"), [(Fraction(4, 3), (256, 128)), (Fraction(8, 9), (192, 144)), (Fraction(64, 45), (273, 128))]
)
def test_oblong_pixels_become_square(tmp_path: Path, aspect: Fraction, size: tuple[int, int]) -> None:
    images = draw_moving_disc(24, (1 / float(aspect), 1.0))
    clip = open_clip(write_plain_video(tmp_path / "a.mp4", images, sample_aspect_ratio=aspect))
    (_, rgb), (_, other) = read_frames(clip, indices=[0, 10])
    x, width, height = measure_disc(rgb)
    assert rgb.shape[1::-1] == (clip.width, clip.height) == size
    assert abs(width / height - 1) < 0.08
    assert x == pytest.approx((30 + 0.5) / clip.stored_scale[0] - 0.5, abs=0.4)
    (_, grey), *_ = read_frames(clip, indices=[10], grey=True)
    assert grey.shape == other.shape[:2]
    assert abs(measure_disc(other)[0] - measure_disc(np.repeat(grey[..., None], 3, axis=2))[0]) < 0.3
    assert sample_clip(clip.path).stills[0].shape == rgb.shape
    assert any("with square pixels" in note for note in clip.notes)


def test_a_stated_aspect_can_be_replaced(tmp_path: Path) -> None:
    clip = write_plain_video(tmp_path / "a.mp4", draw_moving_disc(8))
    assert open_clip(clip, aspect=Fraction(4, 3)).width == 256
    wrong = write_plain_video(tmp_path / "b.mp4", draw_moving_disc(8), sample_aspect_ratio=Fraction(4, 3))
    assert open_clip(wrong, aspect=Fraction(1)).width == WIDTH


def test_an_aspect_of_less_than_a_hundredth_is_not_worth_resampling(tmp_path: Path) -> None:
    clip = open_clip(write_plain_video(tmp_path / "a.mp4", draw_moving_disc(8), sample_aspect_ratio=Fraction(616, 617)))
    assert (clip.width, clip.height, clip.notes) == (WIDTH, HEIGHT, ())


def weave_fields(frames: ImageArray, first_line: int) -> ImageArray:
    """Weave pairs of frames into interlaced ones whose first field starts at `first_line`."""
    woven = frames[::2].copy()
    woven[:, 1 - first_line :: 2] = frames[1::2, 1 - first_line :: 2]
    return woven


@pytest.mark.parametrize("order", ["tff", "bff"])
def test_the_fields_of_interlaced_video_become_frames(tmp_path: Path, order: str) -> None:
    frames = draw_moving_disc(2 * COUNT, step=1.5)
    woven = weave_fields(frames, 0 if order == "tff" else 1)
    clip = open_clip(write_plain_video(tmp_path / "a.mp4", woven, encoder={"flags": "+ildct"}, field_order=order))
    assert clip.frame_count == 2 * COUNT
    assert float(clip.fps) == 60
    np.testing.assert_allclose(clip.t, np.arange(2 * COUNT) / 60, atol=1e-4)
    x = np.array([measure_disc(rgb)[0] for _, rgb in read_frames(clip, indices=range(clip.frame_count))])
    np.testing.assert_allclose(x[2:-2], 30 + 1.5 * np.arange(2 * COUNT)[2:-2], atol=0.3)
    assert "it is interlaced; each field is a frame" in clip.notes
    part = clip.extract_subclip(50, 60)
    places = [measure_disc(rgb)[0] for _, rgb in read_frames(part, indices=part.frames)]
    np.testing.assert_allclose(places, x[50:60], atol=0.3)
    sample = sample_clip(clip.path)
    np.testing.assert_allclose(np.diff(sample.times), 1 / 60, atol=1e-4)


def test_two_fields_of_one_moment_are_one_observation(tmp_path: Path) -> None:
    """Cameras store 25 whole frames per second as 50 fields; they state interlaced frames all the same."""
    frames = draw_moving_disc(COUNT)
    clip = open_clip(write_plain_video(tmp_path / "a.mp4", frames, encoder={"flags": "+ildct"}, field_order="tff"))
    np.testing.assert_array_equal(clip.distinct_frames[2:-2], np.arange(0, 2 * COUNT, 2)[2:-2])


def test_slow_motion_runs_at_the_rate_at_which_it_was_filmed(tmp_path: Path) -> None:
    images = draw_moving_disc(COUNT)
    slow = write_plain_video(
        tmp_path / "a.mp4", images, options={"movflags": "use_metadata_tags"},
        metadata={"com.android.capture.fps": "120.000000"},
    )  # fmt: skip
    clip = open_clip(slow)
    np.testing.assert_allclose(clip.t, np.arange(COUNT) / 120, atol=1e-5)
    assert float(clip.fps) == 120
    assert any("it was filmed at 120 fps and stores 30 fps" in note for note in clip.notes)
    np.testing.assert_allclose(np.diff(sample_clip(slow).times), 1 / 120, atol=1e-5)
    ((_, shown),) = read_frames(clip.extract_subclip(20, 30), indices=[20])
    assert measure_disc(shown)[0] == pytest.approx(30 + 3 * 20, abs=0.3)
    stated = open_clip(slow, fps=Fraction(50))
    np.testing.assert_allclose(stated.t, np.arange(COUNT) / 50)
    ((_, shown),) = read_frames(stated.extract_subclip(20, 30), indices=[20])
    assert measure_disc(shown)[0] == pytest.approx(30 + 3 * 20, abs=0.3)


def test_a_camera_that_drops_frames_is_no_slow_motion(tmp_path: Path) -> None:
    kept = write_plain_video(
        tmp_path / "a.mp4", draw_moving_disc(COUNT), options={"movflags": "use_metadata_tags"},
        metadata={"com.android.capture.fps": "40.000000"},
    )  # fmt: skip
    assert float(open_clip(kept).fps) == 30


def test_slow_motion_of_sony_runs_at_the_rate_at_which_it_was_filmed(tmp_path: Path) -> None:
    """XAVC states it in an XML of its own box, before or after the samples."""
    plain = write_plain_video(tmp_path / "a.mp4", draw_moving_disc(COUNT))
    xml = b'<NonRealTimeMeta><VideoFrame videoCodec="AVC" captureFps="119.88p" formatFps="29.97p"/></NonRealTimeMeta>'
    box = (len(xml) + 20).to_bytes(4, "big") + b"meta" + bytes(4) + (len(xml) + 8).to_bytes(4, "big") + b"xml " + xml
    (tmp_path / "b.mp4").write_bytes(plain.read_bytes() + box)
    clip = open_clip(tmp_path / "b.mp4")
    assert float(clip.fps) == pytest.approx(119.88, rel=1e-4)
    np.testing.assert_allclose(np.diff(sample_clip(clip.path).times), 1 / 119.88, atol=1e-5)
    (tmp_path / "c.mp4").write_bytes(plain.read_bytes() + box.replace(b"119.88p", b"30.000p"))
    assert float(open_clip(tmp_path / "c.mp4").fps) == 30


@pytest.mark.parametrize(("size", "colourspace", "is_hd"), [
    ((1280, 720), None, True), ((720, 1280), None, True), ((640, 360), None, False), ((640, 360), 1, True),
    ((1280, 720), 5, False),
])  # fmt: skip
def test_untagged_high_definition_has_the_colours_of_its_standard(
    tmp_path: Path, size: tuple[int, int], colourspace: int | None, is_hd: bool
) -> None:
    """In BT.601, as FFmpeg decodes all of it, a green cloth is off by 14 levels."""
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.options = (
            *size,
            "yuv420p",
            {"qp": "2", "preset": "ultrafast"},
        )
        if colourspace is not None:
            stream.codec_context.colorspace = colourspace
        for k in range(6):
            image = np.full((size[1], size[0], 3), (20, 130, 70), np.uint8)
            image[20:60, 20 * k : 20 * k + 40] = 255
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame = frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709 if is_hd else Colorspace.ITU601)
            frame.pts, frame.time_base = k, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    (_, rgb), *_ = read_frames(open_clip(path), indices=[4])
    assert np.abs(rgb[-20, -20].astype(int) - [20, 130, 70]).max() <= 2


def test_frames_that_the_decoder_omits_are_said_to_be_lost(tmp_path: Path) -> None:
    """A frame of HEVC whose reference is missing never comes, and no error tells."""
    whole, cut = tmp_path / "whole.mp4", tmp_path / "cut.mp4"
    with av.open(str(whole), "w") as container:
        stream = container.add_stream("libx265", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"x265-params": "keyint=20:min-keyint=20:scenecut=0:bframes=0:log-level=none:pools=1"}
        for k, image in enumerate(draw_moving_disc(COUNT)):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with av.open(str(whole)) as source, av.open(str(cut), "w") as out:
        copy = out.add_stream_from_template(source.streams.video[0])
        for k, packet in enumerate(source.demux(video=0)):
            if packet.dts is not None and k != 10:
                packet.stream = copy
                out.mux(packet)
    assert open_clip(whole).missing_parts == ()
    assert any("frames from 0.37 to 0.63 s cannot be decoded" in note for note in open_clip(cut).missing_parts)


def test_frames_hidden_by_an_edit_list_are_no_frames(tmp_path: Path) -> None:
    whole = write_plain_video(tmp_path / "whole.mp4", draw_moving_disc(COUNT), encoder={"bf": "0"})
    cut = tmp_path / "cut.mp4"
    with av.open(str(whole)) as source, av.open(str(cut), "w") as out:
        stream = source.streams.video[0]
        copy, shift = out.add_stream_from_template(stream), round(10 / 30 / stream.time_base)
        for packet in source.demux(stream):
            if packet.dts is not None:
                packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
                packet.stream = copy
                out.mux(packet)
    clip = open_clip(cut)
    assert clip.frame_count == COUNT - 10
    assert clip.t[0] == 0
    ((_, first),) = read_frames(clip, indices=[0])
    assert measure_disc(first)[0] == pytest.approx(30 + 3 * 10, abs=0.3)
    assert len(sample_clip(cut).times) == COUNT - 10


def write_lossy_stream(path: Path, lost_frame: int) -> Path:
    """Write 60 frames with a key frame every 20 as a transport stream, and lose a part of one frame."""
    noise = np.random.default_rng(0).integers(0, 60, (60, HEIGHT, WIDTH, 3), dtype=np.uint8)
    write_plain_video(
        path, draw_moving_disc(60, step=2.0) // 2 + noise, encoder={"g": "20", "sc_threshold": "0", "bf": "0"}
    )
    with av.open(str(path)) as container:
        places = {round(p.pts * p.time_base * 30): p.pos for p in container.demux(video=0) if p.pts is not None}
    first = min(places.values())
    start = places[lost_frame] // 188 * 188 + 5 * 188
    assert first < start
    content = path.read_bytes()
    path.write_bytes(content[:start] + content[start + 3 * 188 :])
    return path


def test_frames_from_a_loss_to_the_next_key_frame_are_not_observed(tmp_path: Path) -> None:
    clip = open_clip(write_lossy_stream(tmp_path / "a.ts", 45))
    shown = dict(read_frames(clip, indices=range(clip.frame_count)))
    assert 20 < min(clip.unobserved_frames) <= 45
    assert max(clip.unobserved_frames) >= 57
    assert not set(clip.unobserved_frames) & set(clip.distinct_frames.tolist())
    assert any(note.startswith("it is damaged") and "not observed" in note for note in clip.missing_parts)
    assert len(shown) == clip.frame_count


def test_observation_resumes_at_the_next_intact_key_frame(tmp_path: Path) -> None:
    clip = open_clip(write_lossy_stream(tmp_path / "a.ts", 25))
    assert 1 <= len(clip.unobserved_frames) <= 20
    assert set(clip.unobserved_frames) <= set(range(19, 41))
    assert set(range(42, clip.frame_count)) <= set(clip.distinct_frames.tolist())
    part = clip.extract_subclip(10, clip.frame_count)
    assert part.unobserved_frames == clip.unobserved_frames


def test_a_clip_with_hardly_an_intact_frame_is_refused(tmp_path: Path) -> None:
    path = write_lossy_stream(tmp_path / "a.ts", 2)
    with av.open(str(path)) as container:
        places = [p.pos for p in container.demux(video=0) if p.is_keyframe and p.pos is not None]
    content = path.read_bytes()
    path.write_bytes(content[: places[1] // 188 * 188])
    with pytest.raises(ClipError, match="intact and distinct frame"):
        open_clip(path)


def write_at_ticks(path: Path, ticks: FloatArray) -> Path:
    """Write frames of a moving disc at these times, ms."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for tick, image in zip(ticks, draw_moving_disc(len(ticks), step=1.5), strict=True):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(tick), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def test_timestamps_that_jitter_about_even_times_are_replaced_by_them(tmp_path: Path) -> None:
    even = 40.0 * np.arange(80)
    late = even + np.random.default_rng(3).uniform(-12, 12, 80)
    clip = open_clip(write_at_ticks(tmp_path / "a.mkv", late - late[0]))
    np.testing.assert_allclose(clip.t, even / 1000, atol=4e-3)
    np.testing.assert_allclose(np.diff(clip.t), np.diff(clip.t)[0], atol=1e-9)
    assert any("its timestamps jitter by" in note for note in clip.notes)
    np.testing.assert_allclose(np.diff(sample_clip(clip.path).times), 0.04, atol=1e-4)
    ((_, shown),) = read_frames(clip.extract_subclip(50, 60), indices=[50])
    assert measure_disc(shown)[0] == pytest.approx(30 + 1.5 * 50, abs=0.3)


@pytest.mark.parametrize("kind", ["lost frames", "drifting rate"])
def test_times_that_are_truly_uneven_stay(tmp_path: Path, kind: str) -> None:
    steps = np.full(79, 40.0)
    if kind == "lost frames":
        steps[[20, 50]] = 80
    else:
        steps += 8 * np.sin(np.arange(79) / 12)
    ticks = np.rint(np.concatenate([[0], np.cumsum(steps)]))
    clip = open_clip(write_at_ticks(tmp_path / "a.mkv", ticks))
    np.testing.assert_allclose(clip.t, ticks / 1000, atol=1e-6)


def mix_frames(frames: ImageArray, ratio: Fraction) -> ImageArray:
    """Convert the frame rate as converters do: each new frame is the mean of both around it, weighted by its time."""
    place = np.arange(int((len(frames) - 1) / ratio) + 1) * float(ratio)
    first = np.minimum(np.floor(place).astype(int), len(frames) - 2)
    share = (place - first)[:, None, None, None]
    return np.asarray(np.rint((1 - share) * frames[first] + share * frames[first + 1]), dtype=np.uint8)


@pytest.mark.parametrize("ratio", [Fraction(5, 6), Fraction(6, 5), Fraction(4, 5), Fraction(5, 4), Fraction(2, 5)])
@pytest.mark.parametrize(("step", "cut"), [(6.0, 0), (30.0, 0), (6.0, 2)])
def test_frames_that_a_conversion_mixed_are_left_out(tmp_path: Path, ratio: Fraction, step: float, cut: int) -> None:
    frames = draw_moving_disc(60, step=0.0)
    for k, image in enumerate(frames):
        frames[k] = np.roll(image, round(step * k), axis=1)
    clip = open_clip(write_plain_video(tmp_path / "a.mp4", mix_frames(frames, ratio)[cut:]))
    kept = clip.distinct_frames
    taken = float(ratio) * (30 * clip.t[kept] + cut)
    assert clip.t[0] == 0
    np.testing.assert_allclose(taken, np.round(taken), atol=0.02)
    assert len(kept) >= 0.3 * clip.frame_count
    assert any("were mixed of those of a camera" in note for note in clip.notes)
    for (_, rgb), at in zip(read_frames(clip), taken, strict=True):
        ghost = np.sort(np.abs(rgb.astype(int) - frames[round(at)]).ravel())[-300:]  # its area is four times as large
        assert np.median(ghost) < 0.3 * 170


@pytest.mark.parametrize("step", [1.0, 6.0, 30.0])
def test_frames_of_a_camera_are_not_taken_for_mixed_ones(tmp_path: Path, step: float) -> None:
    frames = draw_moving_disc(60, step=0.0)
    for k, image in enumerate(frames):
        frames[k] = np.roll(image, round(step * k), axis=1)
    clip = open_clip(write_plain_video(tmp_path / "a.mp4", frames))
    assert clip.unobserved_frames == ()
    assert clip.notes == ()
