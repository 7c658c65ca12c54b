"""Frames between the frames of a rally show its object once, where the flight puts it, on the background behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_rally import DISC_PX, SCORE_BOX, film_rally, paint_hall, person_box

from models.core.rally import Rally
from models.core.typing import FloatArray, ImageArray
from models.estimation.rally.rally_views import evaluate_rally
from video.io.clip import Clip, read_frames
from video.io.yuv_frame import YuvFrame
from video.synthesis.rally_synthesis import build_rally_timeline, synthesize_rally_frames

SHIFT_PX = 2.0
"""Of the hall from a frame to the next under the camera that turns."""
BRIGHT = 180
"""Luma from which a pixel belongs to the disc, away from lines."""


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Clip, Rally]:
    return film_rally(tmp_path_factory.mktemp("rally") / "clip.mp4")


def synthesize(clip: Clip, rally: Rally, times: FloatArray) -> list[YuvFrame]:
    return [frame.canvas for frame in synthesize_rally_frames(clip, build_rally_timeline(rally), times)]


def bright_centre(luma: ImageArray, around: FloatArray, reach: int = 9) -> FloatArray:
    """Return the centre (2,) px of the bright pixels around a place; NaN without any."""
    x, y = (round(float(side)) for side in around)
    patch = luma[y - reach : y + reach + 1, x - reach : x + reach + 1].astype(float)
    weight = np.clip(patch - 150, 0, 80)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.array([x + (weight * columns).sum() / weight.sum(), y + (weight * rows).sum() / weight.sum()])


def fast_row(rally: Rally) -> int:
    """Return a row from which on the disc moves by several of its diameters, away from painted lines."""
    return int(np.nanargmax(np.linalg.norm(np.diff(rally.px[:-3], axis=0), axis=1)[:-1]))


def test_the_object_is_where_the_flight_puts_it_and_not_where_the_frames_show_it(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    row = fast_row(rally)
    t = float(0.5 * (rally.t[row] + rally.t[row + 1]))
    (frame,) = synthesize(clip, rally, np.array([t]))
    place = rally.scene.camera.to_pixels(evaluate_rally(rally, np.array([t])).xyz)[0]
    luma = frame.planes[0]
    np.testing.assert_allclose(bright_centre(luma, place), place, atol=0.6)
    hall = YuvFrame.from_rgb(paint_hall(rally)).planes[0].astype(int)
    for side in (row, row + 1):
        x, y = np.rint(rally.px[side]).astype(int)
        assert np.linalg.norm(rally.px[side] - place) > 2 * DISC_PX, "the frames show it elsewhere"
        here = np.s_[y - 6 : y + 7, x - 6 : x + 7]
        assert np.abs(luma[here].astype(int) - hall[here]).mean() < 6, "no ghost, and the hall behind it"


def test_decoded_frames_stay_as_they_are(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    rows = np.array([12, 13])
    frames = synthesize(clip, rally, rally.t[rows])
    for frame, (_, image) in zip(frames, read_frames(clip, indices=rally.frame[rows]), strict=True):
        for plane, decoded in zip(frame.planes, YuvFrame.from_rgb(image).planes, strict=True):
            np.testing.assert_array_equal(plane, decoded)


def test_an_object_that_no_frame_shows_stays_hidden(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    row = fast_row(rally)
    px = rally.px.copy()
    px[row - 2 : row + 4] = np.nan
    t = float(0.5 * (rally.t[row] + rally.t[row + 1]))
    (frame,) = synthesize(clip, replace(rally, px=px), np.array([t]))
    x, y = np.rint(rally.scene.camera.to_pixels(evaluate_rally(rally, np.array([t])).xyz)[0]).astype(int)
    assert frame.planes[0][y - 4 : y + 5, x - 4 : x + 5].max() < BRIGHT


def test_people_move_on_between_frames(filmed: tuple[Clip, Rally]) -> None:
    clip, rally = filmed
    boxes = np.array([[row, *person_box(row)] for row in range(len(rally.t))], float)
    (frame,) = synthesize(clip, replace(rally, players=boxes), np.array([rally.t[10] + 0.5 / 25]))
    left, top, right, bottom = person_box(10)
    red = frame.planes[2][(top + bottom) // 4, : right // 2 + 20].astype(int)  # chroma, at half size
    edge = 2 * float(np.flatnonzero(np.diff((red > 150).astype(int)) < 0)[-1] + 0.75)
    assert edge == pytest.approx(right + 1.5, abs=1.6)
    assert left < edge


@pytest.fixture(scope="module")
def panned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Clip, Rally]:
    motion = np.tile(np.eye(3), (80, 1, 1))
    motion[:, 0, 2] = SHIFT_PX * np.arange(80)
    return film_rally(tmp_path_factory.mktemp("panned") / "clip.mp4", motion)


def test_under_a_camera_that_turns_graphics_keep_their_place(panned: tuple[Clip, Rally]) -> None:
    clip, rally = panned
    (frame,) = synthesize(clip, rally, np.array([rally.t[9] + 0.5 / 25]))
    left, top, right, bottom = SCORE_BOX
    images = [image for _, image in read_frames(clip, indices=rally.frame[[9, 10]])]
    for image in images:
        filmed_luma = YuvFrame.from_rgb(image).planes[0][top:bottom, left:right].astype(int)
        drawn = frame.planes[0][top:bottom, left:right].astype(int)
        assert np.abs(drawn - filmed_luma).mean() < 3


def test_under_a_camera_that_turns_object_and_hall_move_together(panned: tuple[Clip, Rally]) -> None:
    clip, rally = panned
    shifts = SHIFT_PX * np.arange(80)
    row = fast_row(rally)
    t = float(rally.t[row] + 0.25 / 25)
    (frame,) = synthesize(clip, rally, np.array([t]))
    camera = replace(rally.scene.camera, motion=None)
    place = camera.to_pixels(evaluate_rally(rally, np.array([t])).xyz)[0] + [shifts[row] + 0.5, 0]
    np.testing.assert_allclose(bright_centre(frame.planes[0], place), place, atol=0.6)
    hall = YuvFrame.from_rgb(paint_hall(rally)).planes[0].astype(float)
    here = frame.planes[0][150:250, 600:700].astype(float)
    errors = [
        np.abs(here - hall[150:250, 600 - shift : 700 - shift]).mean() for shift in range(2 * row - 3, 2 * row + 5)
    ]
    assert int(np.argmin(errors)) in (3, 4), "the hall is shifted by half a pixel more than in the frame before"
