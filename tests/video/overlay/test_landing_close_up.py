"""The close-up of a landing shows lines, place and error where they are, in metres of the court."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_rally import film_rally

from models.core.rally import Rally
from models.core.typing import FloatArray
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.landing_margin import format_margin
from video.drawing.court_plan import draw_court, find_ellipse
from video.drawing.palette import FLASH
from video.io.clip import Clip
from video.overlay.landing_close_up import draw_landing, find_line_edge, frame_landing

SIZE = (960, 720)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Clip, Rally]:
    return film_rally(tmp_path_factory.mktemp("rally") / "clip.mp4")


def test_line_place_and_ellipse_are_at_their_pixels(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    call = judge_landing(rally)
    assert call.landing is not None
    image = draw_landing(clip, rally, call, SIZE).astype(int)
    view = frame_landing(rally, call, call.landing, SIZE)
    (line,) = (one for one in rally.scene.sport.lines if one.name == call.line)
    inside = view.to_pixels(np.array([call.landing.place[0] + 0.25, line.start[1]]))
    beyond = view.to_pixels(np.array([call.landing.place[0] + 0.25, line.start[1] - 1.3 * line.width]))
    assert image[round(inside[1]), round(inside[0])].min() > 215, "the paint of the line"
    assert image[round(beyond[1]), round(beyond[0])].max() < 190, "and not beside it"
    outline = view.to_pixels(call.landing.place[:2] + find_ellipse(call.landing.covariance[:2, :2], 2.0))
    left = outline[np.argmin(outline[:, 0])], outline[np.argmin(outline[:, 1])]
    top = left[1]
    assert np.abs(image[round(top[1]), round(top[0])] - FLASH).max() < 60, "two standard deviations along the court"


def test_the_view_keeps_lengths_and_lies_as_the_image_does(filmed: tuple[Clip, Rally]) -> None:
    _, rally = filmed
    call = judge_landing(rally)
    assert call.landing is not None
    view = frame_landing(rally, call, call.landing, SIZE)
    origin, ahead, aside = view.to_pixels(np.array([[0.0, 0], [1, 0], [0, 1]]))
    np.testing.assert_allclose(ahead - origin, [0, -view.scale], atol=1e-9)
    np.testing.assert_allclose(aside - origin, [view.scale, 0], atol=1e-9)
    px = np.array([[100.0, 50.0], [700.0, 650.0]])
    np.testing.assert_allclose(view.to_pixels(view.to_court(px)[:, :2]), px)


@pytest.mark.parametrize("distance", [0.10, -0.05])
def test_the_distance_ends_on_the_outer_edge_of_the_line(filmed: tuple[Clip, Rally], distance: float) -> None:
    _, rally = filmed
    edge_y = rally.scene.sport.areas["singles"][1][1]
    landing = replace(rally.landings[0], place=np.array([10.0, edge_y + distance, 0.0]))
    rally = replace(rally, landings=(landing,))
    call = judge_landing(rally)
    edge = find_line_edge(rally, call, landing)
    assert edge is not None
    np.testing.assert_allclose(edge, [10.0, edge_y], atol=1e-9)
    assert call.distance == pytest.approx(distance)
    assert ("inside" if distance > 0 else "beyond") in format_margin(call)


def test_without_a_landing_the_close_up_says_so(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    call = judge_landing(replace(rally, landings=(), no_landing=1.0))
    image = draw_landing(clip, rally, call, SIZE)
    assert image.shape == (720, 960, 3)
    assert not format_margin(call)


def spread(points: FloatArray) -> FloatArray:
    return np.asarray(points.max(axis=0) - points.min(axis=0))


def test_the_plan_maps_the_court_as_the_image_shows_it(filmed: tuple[Clip, Rally]) -> None:
    sport = filmed[1].scene.sport
    plan, side = draw_court(sport, 300), draw_court(sport, 300, "side")
    assert max(plan.size) == pytest.approx(300, abs=1)
    near, far, right = plan.to_pixels(np.array([[0.0, 3, 0], [sport.length, 3, 0], [0, sport.width, 0]]))
    assert far[1] < near[1], "the far end is on top"
    assert right[0] > near[0]
    low, high = side.to_pixels(np.array([[1.0, 2, 0], [1.0, 5, 3]]))
    assert high[1] < low[1]
    assert high[0] == low[0]
    np.testing.assert_allclose(spread(find_ellipse(np.diag([0.04, 0.01]), 2.0)), [0.8, 0.4], rtol=5e-3)
