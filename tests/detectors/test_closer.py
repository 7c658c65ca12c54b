"""The second look where balls crowd."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from support.rendered_balls import Ball, draw, drawn_scene

from detectors.measurement.cloth_background import learn_cloth
from detectors.measurement.working_view import View, view_of
from detectors.network.peak_decoding import LOOKS, Centres
from detectors.network.second_pass import CLOSE_RADIUS_PX, Shown, looked_closer

DOT = (255, 0, 255)
BALLS = ((300.0, 170.0), (309.0, 176.0), (450.0, 120.0))


@dataclass(frozen=True)
class DotModel:
    """Sees dots of one colour exactly, and notes how large the pictures were that it was shown."""

    shown: list[tuple[int, int]] = field(default_factory=list)

    def see(self, rgb: np.ndarray, radius: float) -> Centres:
        self.shown.append(rgb.shape[:2])
        away = np.abs(rgb.astype(int) - DOT).sum(axis=2)
        _, _, _, places = cv2.connectedComponentsWithStats((away < 160).astype(np.uint8))
        return peaks(places[1:], radius, 0.9)


def peaks(centre: np.ndarray, radius: float, score: float) -> Centres:
    count = len(centre)
    one = np.ones(count)
    return Centres(
        centre.reshape(-1, 2), radius * one, np.zeros((count, 2)), score * one, one, one, np.zeros((count, len(LOOKS)))
    )


def dotted() -> tuple[np.ndarray, View]:
    """A picture with a dot, 5 px on a side, in the middle of each ball, and its view."""
    picture = draw([Ball(x, y) for x, y in BALLS], np.random.default_rng(1), noise=0.0)
    for x, y in BALLS:
        picture[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3] = DOT
    return picture, view_of(drawn_scene())


def looked(picture: np.ndarray, view: View, model: DotModel, seen: Centres) -> Centres:
    working = view.picture(picture)
    shown = Shown(picture, working, np.ones(working.shape[:2], dtype=bool), 0)
    return looked_closer(shown, view, learn_cloth([working], view), model, seen)


def test_balls_that_crowd_are_seen_where_the_closer_look_sees_them() -> None:
    picture, view = dotted()
    model = DotModel()
    guessed = view.to_working(np.array(BALLS) + np.array([[2.0, 1.0], [-2.0, 1.0], [1.5, 0.0]]))
    found = looked(picture, view, model, peaks(guessed, view.typical, 0.9))
    truth = view.to_working(np.array(BALLS))
    assert len(found) == 3
    apart = np.linalg.norm(found.centre[:, None] - truth[None], axis=-1).min(axis=0)
    assert apart[:2].max() < 0.3
    # The one that stands alone is left as it was seen.
    assert np.linalg.norm(found.centre - guessed[2], axis=1).min() == 0.0
    assert np.allclose(found.radius, view.typical, rtol=0.05)


def test_the_closer_picture_is_larger_and_shows_only_that_part() -> None:
    picture, view = dotted()
    model = DotModel()
    looked(picture, view, model, peaks(view.to_working(np.array(BALLS[:2])), view.typical, 0.9))
    [(height, width)] = model.shown
    assert view.typical < CLOSE_RADIUS_PX
    assert height * width < 0.3 * view.radius.size


def test_what_no_ball_explains_beside_one_is_looked_at_again() -> None:
    """The network overlooked one of two balls that touch."""
    picture, view = dotted()
    model = DotModel()
    found = looked(picture, view, model, peaks(view.to_working(np.array(BALLS[:1])), view.typical, 0.9))
    truth = view.to_working(np.array(BALLS[:2]))
    assert np.linalg.norm(found.centre[:, None] - truth[None], axis=-1).min(axis=0).max() < 0.3


def test_balls_that_stand_alone_are_looked_at_once() -> None:
    view, model = dotted()[1], DotModel()
    seen = peaks(view.to_working(np.array(BALLS)[[0, 2]]), view.typical, 0.9)
    lonely = draw([Ball(*BALLS[0]), Ball(*BALLS[2])], np.random.default_rng(1))
    found = looked(lonely, view, model, seen)
    assert model.shown == []
    assert np.array_equal(found.centre, seen.centre)
