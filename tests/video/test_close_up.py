"""A close-up shows what a question is about, and hides nothing of it."""

from __future__ import annotations

import numpy as np
import pytest

from video.drawing.palette import FLASH
from video.overlay.close_up import CAPTION, TILE, Outline, Scenery, close_up, strip


def scene(*centres: tuple[float, float], line: np.ndarray | None = None) -> Scenery:
    """Grey, 200 x 150 px, with balls of 8 px."""
    balls = tuple(Outline(f"ball-{k}", np.array(centre), 8.0) for k, centre in enumerate(centres))
    return Scenery(np.full((150, 200, 3), 90, dtype=np.uint8), 7, 0.28, balls, (), line)


def flashes(picture: np.ndarray) -> np.ndarray:
    """(n, 2) rows and columns of the pixels in the colour of a line."""
    return np.argwhere(np.abs(picture.astype(int) - FLASH).max(axis=2) < 30)


def test_the_line_in_question_goes_through_the_ball_that_lies_on_it() -> None:
    line = np.array([[100.0, -1e6], [100.0, 1e6]])
    for picture in (
        close_up(scene((100.0, 75.0), line=line), "yes", []),
        strip([scene((100.0, 75.0), line=line)], 0.3),
    ):
        rows, columns = flashes(picture).T
        assert np.ptp(columns) <= 3
        assert columns.mean() == pytest.approx(picture.shape[1] / 2, abs=2)
        assert np.ptp(rows) > 0.6 * picture.shape[0]
    assert not len(flashes(close_up(scene((100.0, 75.0)), "yes", [])))


@pytest.mark.parametrize("way", [(1, 1), (1, -1), (-1, 1)])
def test_the_caption_of_a_strip_stands_where_no_ball_is(way: tuple[int, int]) -> None:
    """A ball that goes across the tile from one corner or the other: both corners of its way are taken."""
    middle = np.array([100.0, 75.0])
    scenes = [scene(tuple(middle + 40.0 * share * np.array(way))) for share in (-1, -0.5, 0, 0.5, 1)]
    picture = strip(scenes, 0.28)
    tiles = [picture[:, k * (TILE[0] + 4) :][:, : TILE[0]] for k in range(len(scenes))]
    dark = [np.argwhere(tile.max(axis=2) < 60) for tile in tiles]
    for place in dark:
        assert len(place) > 0.5 * CAPTION[0] * CAPTION[1]
    where = {tuple(np.sign(place.mean(axis=0) - np.array(TILE)[::-1] / 2)[::-1]) for place in dark}
    assert len(where) == 1, "in the same corner of all"
    (corner,) = where
    assert corner[0] * way[0] != corner[1] * way[1]
