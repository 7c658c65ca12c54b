"""A close-up shows the balls in question and hides none of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from video.drawing.palette import FLASH
from video.overlay.close_up import (
    CAPTION_SIZE,
    CLOSE_UP_SIZE,
    TILE_SIZE,
    CloseUpFrame,
    NamedOutline,
    draw_close_up,
    draw_frame_strip,
)


def close_up_frame(*centres: tuple[float, float], line: np.ndarray | None = None) -> CloseUpFrame:
    """A grey frame of 200 x 150 px with balls of 8 px."""
    balls = tuple(NamedOutline(f"ball-{k}", np.array(centre), 8.0) for k, centre in enumerate(centres))
    return CloseUpFrame(np.full((150, 200, 3), 90, dtype=np.uint8), 7, 0.28, balls, (), line)


def flashes(image: np.ndarray) -> np.ndarray:
    """(n, 2) rows and columns of the pixels in the colour of the line."""
    return np.argwhere(np.abs(image.astype(int) - FLASH).max(axis=2) < 30)


def test_the_line_in_question_passes_through_the_ball_that_is_on_it() -> None:
    line = np.array([[100.0, -1e6], [100.0, 1e6]])
    for image in (
        draw_close_up(close_up_frame((100.0, 75.0), line=line), "yes", []),
        draw_frame_strip([close_up_frame((100.0, 75.0), line=line)], 0.3),
    ):
        rows, columns = flashes(image).T
        assert np.ptp(columns) <= 3
        assert columns.mean() == pytest.approx(image.shape[1] / 2, abs=2)
        assert np.ptp(rows) > 0.6 * image.shape[0]
    assert not len(flashes(draw_close_up(close_up_frame((100.0, 75.0)), "yes", [])))


@pytest.mark.parametrize("way", [(1, 1), (1, -1), (-1, 1)])
def test_the_caption_of_a_strip_is_where_no_ball_is(way: tuple[int, int]) -> None:
    """A ball crosses the tile from one corner to another: both corners of its path are occupied."""
    middle = np.array([100.0, 75.0])
    frames = [close_up_frame(tuple(middle + 40.0 * share * np.array(way))) for share in (-1, -0.5, 0, 0.5, 1)]
    image = draw_frame_strip(frames, 0.28)
    tiles = [image[:, k * (TILE_SIZE[0] + 4) :][:, : TILE_SIZE[0]] for k in range(len(frames))]
    dark = [np.argwhere(tile.max(axis=2) < 60) for tile in tiles]
    for place in dark:
        assert len(place) > 0.5 * CAPTION_SIZE[0] * CAPTION_SIZE[1]
    where = {tuple(np.sign(place.mean(axis=0) - np.array(TILE_SIZE)[::-1] / 2)[::-1]) for place in dark}
    assert len(where) == 1, "in the same corner of all"
    (corner,) = where
    assert corner[0] * way[0] != corner[1] * way[1]


@pytest.mark.parametrize("balls", [((150.0, 20.0),), ()], ids=["far ball", "fallen ball"])
def test_the_whole_mouth_of_a_pocket_in_question_is_in_the_picture(balls: tuple[tuple[float, float], ...]) -> None:
    mouth = replace(close_up_frame(*balls, line=np.array([[10.0, 30.0], [30.0, 10.0]])), shows_line=True)
    marked = flashes(draw_close_up(mouth, "yes", [])[: CLOSE_UP_SIZE[1]])
    assert (marked.max(axis=0) < np.array(CLOSE_UP_SIZE)[::-1] - 1).all()
    assert marked.min() > 0
    assert np.ptp(marked, axis=0).min() > 50


def test_only_a_picture_with_dashed_outlines_explains_them() -> None:
    """A ball that fell has no outline at the moment of its fall."""
    plain = close_up_frame((100.0, 75.0))
    dashed = replace(plain, moment_outlines=plain.outlines)
    assert len(draw_close_up(plain, "yes", [])) < len(draw_close_up(dashed, "yes", []))
