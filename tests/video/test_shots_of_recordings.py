"""A long recording is cut where the table is still and where the view changes, and a shot shows just its pictures."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from video.calibration.shot_cuts import MARGIN_S, find_shots, motions
from video.io.clip import Clip, open_clip, read_frames

RATE = 25
HEIGHT, WIDTH = 180, 320


def table(colour: tuple[int, int, int], ball: float | None) -> NDArray[np.uint8]:
    """A cloth with wooden rails, and a ball at a share of its length; None: no table at all, only a wall."""
    picture = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    if ball is None:
        picture[::7] = 160
        return picture
    picture[20:160, 20:300] = (90, 60, 40)
    picture[30:150, 30:290] = colour
    x = round(40 + 240 * ball)
    picture[84:96, x - 6 : x + 6] = 240
    return picture


def write(path: Path, pictures: list[NDArray[np.uint8]], suffix: str = "mp4") -> Path:
    with av.open(str(path), "w", format=suffix) as film:
        stream = film.add_stream("libx264", rate=RATE, options={"crf": "12", "bf": "2"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.gop_size = 30
        for k, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture)
            frame.pts, frame.time_base = k, Fraction(1, RATE)
            film.mux(stream.encode(frame))
        film.mux(stream.encode(None))
    return path


GREEN, BLUE = (20, 120, 60), (30, 70, 150)
STILL, MOVING = 60, 30
"""Pictures."""


def match() -> list[NDArray[np.uint8]]:
    """Still, a shot, still, a shot, still; a cut to a wall; another table with a shot that begins at once."""
    ran = np.linspace(0, 1, MOVING)
    green = [0.0] * STILL + list(ran) + [1.0] * STILL + list(1 - ran) + [0.0] * STILL
    blue = [*ran, *([1.0] * STILL)]
    return [table(GREEN, at) for at in green] + [table(GREEN, None)] * STILL + [table(BLUE, at) for at in blue]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return open_clip(write(tmp_path_factory.mktemp("match") / "match.mp4", match()))


def test_a_recording_is_cut_into_its_shots_and_views(recording: Clip) -> None:
    shots = find_shots(recording)
    wall = 3 * STILL + 2 * MOVING
    assert shots.cuts.tolist() == [wall, wall + STILL]
    begins = np.array([STILL, 2 * STILL + MOVING, wall + STILL])
    margin = MARGIN_S * RATE
    assert len(shots) == 3
    assert shots.first[:2] == pytest.approx(begins[:2] - margin, abs=6)
    assert shots.first[2] == begins[2]
    assert shots.stop == pytest.approx(begins + MOVING + margin, abs=6)
    assert np.all(shots.first[1:] >= shots.stop[:-1])


@pytest.mark.parametrize("suffix", ["mp4", "matroska", "avi"])
def test_a_shot_shows_just_the_pictures_of_the_recording(tmp_path: Path, suffix: str) -> None:
    pictures = match()[30:200]
    clip = open_clip(write(tmp_path / f"a.{suffix}", pictures, suffix))
    whole = dict(read_frames(clip, indices=np.arange(clip.frame_count)))
    for first, stop in ((0, 10), (29, 40), (30, 33), (91, 150), (len(whole) - 5, len(whole))):
        part = clip.between(first, stop)
        shown = dict(read_frames(part, indices=np.arange(part.frame_count)))
        assert list(shown) == list(range(stop - first))
        assert all(np.array_equal(shown[k], whole[first + k]) for k in shown)
        assert part.t[0] == 0
        assert part.t == pytest.approx(clip.t[first:stop] - clip.t[first])


def test_a_part_of_a_part_is_refused(recording: Clip) -> None:
    with pytest.raises(ValueError, match="no part"):
        recording.between(0, 10).between(0, 5)
    with pytest.raises(ValueError, match="no part"):
        recording.between(5, 5)


def test_motions_part_where_it_is_still_for_long_and_never_overlap() -> None:
    t = np.arange(400) / 50
    rng = np.random.default_rng(3)
    for _ in range(50):
        change = np.where(np.repeat(rng.random(40) < 0.4, 10), 50.0, 2.0)
        spans = motions(t, change, 0, 400)
        busy = np.flatnonzero(change > 16)
        inside = np.zeros(400, bool)
        for a, b in spans:
            assert 0 <= a < b <= 400
            assert not inside[a:b].any()
            inside[a:b] = True
        alone = [k for k in busy if not inside[k]]
        assert all(np.sum(np.abs(t[busy] - t[k]) < 0.1) <= 11 for k in alone), "only short motions are left out"


def test_a_still_recording_holds_no_shot() -> None:
    assert motions(np.arange(100) / 25, np.full(100, 3.0), 0, 100) == []
    assert motions(np.arange(100) / 25, np.full(100, np.nan), 0, 100) == []
