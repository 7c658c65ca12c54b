"""Recordings are segmented at stillness and cuts, and a subclip contains exactly its frames."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.stages.shot_stages import find_single_span
from video.calibration import shot_segmentation
from video.calibration.shot_segmentation import MARGIN_S, find_motion_intervals, list_shot_spans, segment_shots
from video.io.clip import Clip, open_clip, read_frames

RATE = 25
HEIGHT, WIDTH = 180, 320


def draw_table_frame(colour: tuple[int, int, int], ball: float | None, row: int = 90) -> NDArray[np.uint8]:
    """Draw a cloth with wooden rails and a ball at a share of its length; None draws only a wall."""
    image = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    if ball is None:
        image[::7] = 160
        return image
    image[20:160, 20:300] = (90, 60, 40)
    image[30:150, 30:290] = colour
    x = round(40 + 240 * ball)
    image[row - 6 : row + 6, x - 6 : x + 6] = 240
    return image


def write_video(path: Path, images: list[NDArray[np.uint8]], suffix: str = "mp4") -> Path:
    with av.open(str(path), "w", format=suffix) as film:
        stream = film.add_stream("libx264", rate=RATE, options={"crf": "12", "bf": "2"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.gop_size = 30
        for k, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image)
            frame.pts, frame.time_base = k, Fraction(1, RATE)
            film.mux(stream.encode(frame))
        film.mux(stream.encode(None))
    return path


GREEN, BLUE = (20, 120, 60), (30, 70, 150)
STILL, MOVING = 60, 30
"""Frames."""


def match_frames() -> list[NDArray[np.uint8]]:
    """Return a match: two shots with stillness around them, a cut to a wall, and another table with a shot at once."""
    ran = np.linspace(0, 1, MOVING)
    green = [0.0] * STILL + list(ran) + [1.0] * STILL + list(1 - ran) + [0.0] * STILL
    blue = [*ran, *([1.0] * STILL)]
    return (
        [draw_table_frame(GREEN, at) for at in green]
        + [draw_table_frame(GREEN, None)] * STILL
        + [draw_table_frame(BLUE, at) for at in blue]
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return open_clip(write_video(tmp_path_factory.mktemp("match") / "match.mp4", match_frames()))


def test_a_recording_is_segmented_into_its_shots_and_views(recording: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shot_segmentation, "locate_table", lambda image: None)  # the drawn tables have no noses
    shots = segment_shots(recording)
    wall = 3 * STILL + 2 * MOVING
    assert recording.views.tolist() == [[0, wall], [wall, wall + STILL], [wall + STILL, recording.frame_count]]
    begins = np.array([STILL, 2 * STILL + MOVING, wall + STILL])
    margin = MARGIN_S * RATE
    assert len(shots) == 3
    assert shots.first_frames[:2] == pytest.approx(begins[:2] - margin, abs=6)
    assert shots.first_frames[2] == begins[2]
    assert shots.stop_frames[:2] == pytest.approx(begins[:2] + MOVING + margin, abs=6)
    assert shots.stop_frames[2] == recording.frame_count, "a short view with one shot is the shot"
    assert np.all(shots.first_frames[1:] >= shots.stop_frames[:-1])


def test_a_fixed_camera_that_is_cut_to_itself_shows_two_shots_to_the_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shot_segmentation, "locate_table", lambda image: None)
    ran, still = list(np.linspace(0, 0.8, MOVING)), STILL // 4
    first = [draw_table_frame(GREEN, at, 60) for at in [0.0] * still + ran + [0.8] * still]
    second = [draw_table_frame(GREEN, 0.9 - at, 120) for at in [0.0] * still + ran + [0.8] * still]
    for k, image in enumerate(first + second):  # a scoreboard beside the table, which changes while balls roll
        image[4:12, 100 + 12 * (k > 25) : 108 + 12 * (k > 25)] = 250
    clip = open_clip(write_video(tmp_path / "a.mp4", first + second))
    assert clip.views.tolist() == [[0, len(first + second)]]
    shots = segment_shots(clip)
    spans = list(zip(shots.first_frames.tolist(), shots.stop_frames.tolist(), strict=True))
    assert spans == [(0, len(first)), (len(first), len(first + second))]
    assert shots.views.tolist() == [list(span) for span in spans]
    assert not find_single_span(clip)
    whole = open_clip(write_video(tmp_path / "b.mp4", first))
    assert len(whole.jumps), "digits that change may be balls until the cloth is known"
    assert list_shot_spans(whole, segment_shots(whole)) == []


@pytest.mark.parametrize("suffix", ["mp4", "matroska", "avi"])
def test_a_subclip_contains_exactly_its_frames_of_the_recording(tmp_path: Path, suffix: str) -> None:
    images = match_frames()[30:200]
    clip = open_clip(write_video(tmp_path / f"a.{suffix}", images, suffix))
    whole = dict(read_frames(clip, indices=np.arange(clip.frame_count)))
    for first, stop in ((0, 10), (29, 40), (30, 33), (91, 150), (len(whole) - 5, len(whole))):
        part = clip.extract_subclip(first, stop)
        shown = dict(read_frames(part, indices=part.frames))
        assert list(shown) == list(range(first, stop))
        assert all(np.array_equal(shown[k], whole[k]) for k in shown)
        assert np.array_equal(part.t, clip.t[first:stop])


def test_a_part_of_a_part_keeps_its_numbers_and_lies_within_it(recording: Clip) -> None:
    part = recording.extract_subclip(2, 10).extract_subclip(4, 7)
    assert (part.frames.tolist(), part.t.tolist()) == ([4, 5, 6], recording.t[4:7].tolist())
    for first, stop in ((0, 5), (5, 11), (5, 5)):
        with pytest.raises(ValueError, match="no part"):
            recording.extract_subclip(2, 10).extract_subclip(first, stop)


def test_motion_intervals_are_separated_by_stillness_and_never_overlap() -> None:
    t = np.arange(400) / 50
    rng = np.random.default_rng(3)
    for _ in range(50):
        change = np.where(np.repeat(rng.random(40) < 0.4, 10), 50.0, 2.0)
        spans = find_motion_intervals(t, change, 0, 400)
        busy = np.flatnonzero(change > 16)
        inside = np.zeros(400, bool)
        for a, b in spans:
            assert 0 <= a < b <= 400
            assert not inside[a:b].any()
            inside[a:b] = True
        alone = [k for k in busy if not inside[k]]
        assert all(np.sum(np.abs(t[busy] - t[k]) < 0.1) <= 11 for k in alone), "only short motions are left out"


def test_a_still_recording_contains_no_shot() -> None:
    assert find_motion_intervals(np.arange(100) / 25, np.full(100, 3.0), 0, 100) == []
    assert find_motion_intervals(np.arange(100) / 25, np.full(100, np.nan), 0, 100) == []
