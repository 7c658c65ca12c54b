"""The slow motion of a rally has its frames, its rate and, in the clean style, nothing drawn on what was filmed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from support.filmed_rally import film_rally

from models.core.rally import Rally
from models.core.typing import ImageArray
from models.estimation.rally.landing_judgement import judge_landing
from video.io.clip import Clip, read_frames
from video.io.video_options import OverlayStyle, RenderOptions
from video.io.yuv_frame import YuvFrame
from video.overlay.landing_close_up import draw_landing
from video.overlay.rally_annotation import prepare_rally_annotation
from video.overlay.rally_poster import draw_rally_poster
from video.overlay.rally_slow_motion import (
    CLOSE_UP_S,
    find_rally_times,
    find_replay_times,
    magnify_planes,
    render_rally,
)
from video.synthesis.rally_synthesis import InBetweenFrame, build_rally_timeline

SLOW = 4.0


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Clip, Rally]:
    return film_rally(tmp_path_factory.mktemp("rally") / "clip.mp4")


def render(filmed: tuple[Clip, Rally], path: Path, style: OverlayStyle) -> list[ImageArray]:
    clip, rally = filmed
    shares: list[float] = []
    render_rally(clip, rally, path, RenderOptions(slow=SLOW, style=style), shares.append)
    assert shares[-1] == pytest.approx(1.0)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.average_rate == 25
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]


def test_the_clean_style_shows_the_frames_as_they_are(filmed: tuple[Clip, Rally], tmp_path: Path) -> None:
    clip, rally = filmed
    frames = render(filmed, tmp_path / "slow.mp4", "clean")
    assert len(frames) == (len(rally.t) - 1) * SLOW + 1
    for index, image in read_frames(clip, indices=rally.frame[[0, 7, 20]]):
        error = np.abs(frames[round(SLOW * index)].astype(int) - image).mean()
        assert error < 3.0, "nothing is drawn"


@pytest.mark.parametrize("style", ["coach", "umpire"])
def test_the_other_styles_end_with_the_landing(filmed: tuple[Clip, Rally], tmp_path: Path, style: OverlayStyle) -> None:
    clip, rally = filmed
    frames = render(filmed, tmp_path / "slow.mp4", style)
    count = (len(rally.t) - 1) * int(SLOW) + 1
    again = len(find_replay_times(rally, judge_landing(rally), 25 * SLOW)) if style == "umpire" else 0
    assert len(frames) == count + again + round(25 * CLOSE_UP_S)
    assert (again > 0) == (style == "umpire")
    still = np.abs(frames[-1].astype(int) - frames[count + again]).mean()
    assert still < 1.0, "one image at the end"
    (filmed_image,) = (image for _, image in read_frames(clip, indices=rally.frame[[15]]))
    drawn = np.abs(frames[15 * int(SLOW)].astype(int) - filmed_image).max(axis=2) > 40
    assert 0.002 < drawn.mean() < 0.2


def test_a_magnified_view_shows_its_place_in_the_middle() -> None:
    image = np.zeros((120, 160, 3), np.uint8)
    image[60:64, 90:94] = 255
    planes = magnify_planes(YuvFrame.from_rgb(image), np.array([91.5, 61.5]), 4.0).planes
    rows, columns = np.nonzero(planes[0] > 120)
    assert columns.mean() == pytest.approx(79.5, abs=1.0)
    assert rows.mean() == pytest.approx(59.5, abs=1.0)
    assert len(rows) == pytest.approx(256, rel=0.15)


@pytest.mark.parametrize("place", [(-14.0, 3.0, 0.0), (4.0, 3.0, 0.0), (900.0, -80.0, 0.0)])
def test_a_landing_out_of_view_with_a_huge_error_is_drawn_without_trouble(
    filmed: tuple[Clip, Rally], place: tuple[float, float, float]
) -> None:
    clip, rally = filmed
    landing = replace(rally.landings[0], place=np.array(place), covariance=np.diag([350.0, 80.0, 1e-6]))
    wrong = replace(rally, landings=(landing,))
    assert draw_rally_poster(clip, wrong).shape == (clip.height, clip.width, 3)
    assert draw_landing(clip, wrong, judge_landing(wrong)).shape == (720, 960, 3)
    timeline = build_rally_timeline(wrong)
    canvas = np.zeros((clip.height, clip.width, 3), np.uint8)
    annotation = prepare_rally_annotation(timeline, judge_landing(wrong), canvas, SLOW, "coach")
    frame = InBetweenFrame(landing.t + 0.01, YuvFrame.from_rgb(canvas), np.full(2, np.nan), False)
    annotation.draw(frame)


def test_still_parts_are_left_out_on_request(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    whole = find_rally_times(clip, rally, RenderOptions(slow=SLOW))
    part = find_rally_times(clip, rally, RenderOptions(slow=SLOW, trim_still=True))
    assert len(part) <= len(whole)
    assert part[0] <= rally.flights[0].start
    assert part[-1] >= rally.flights[-1].end - 0.05


def test_the_poster_shows_every_place_of_the_last_stroke(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    poster = draw_rally_poster(clip, rally)
    assert poster.shape == (clip.height, clip.width, 3)
    rows = np.flatnonzero(np.isfinite(rally.px[:, 0]))[4:-6:5]
    for x, y in np.rint(rally.px[rows]).astype(int):
        assert poster[y - 2 : y + 3, x - 2 : x + 3].mean() > 170, "a white disc"
