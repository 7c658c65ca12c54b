"""The fan of a prediction: shaded where courses go, more where most go, and nothing where they do not."""

from __future__ import annotations

import numpy as np

from models.core.scene import Table
from models.estimation.forecast.probability_regions import outlyingness
from video.drawing.prediction_fan import Fan, draw_fans
from video.drawing.table_inset import SHIFT, SUPERSAMPLE, furnished
from video.drawing.table_plan import CLOTH, WIDTH, colours_of, draw_plan

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)


def fan(spread: float) -> Fan:
    """Courses from (0.5, 0.6) m along x that open to both sides, evenly."""
    t = np.linspace(0, 1, 20)
    tilt = np.linspace(-spread, spread, 101)
    courses = np.stack([np.broadcast_to(0.5 + 1.5 * t, (101, 20)), 0.6 + tilt[:, None] * t], axis=2)
    nothing = np.empty((0, 2))
    return Fan("red", courses[0, :1], courses, outlyingness(courses), nothing)


def change(picture: np.ndarray, xy: tuple[float, float]) -> float:
    """Levels by which the picture differs from an empty table at a place, m."""
    inset = furnished(TABLE, CLOTH, False, WIDTH)
    column, row = inset.plan(np.array(xy)) // (SUPERSAMPLE << SHIFT)
    return float(np.abs(picture[row, column].astype(int) - np.array(CLOTH)).max())


def test_the_middle_of_a_fan_is_shaded_most_and_its_outside_not_at_all() -> None:
    picture = draw_fans(TABLE, [fan(0.3)], "")
    empty = draw_fans(TABLE, [fan(0.0)], "")
    middle, side, outside = ((1.95, 0.6), (1.95, 0.6 + 0.21), (1.95, 0.6 + 0.29 + 0.06))
    ground = change(empty, outside)
    assert change(picture, middle) > change(picture, side) + 20
    assert change(picture, side) > ground + 20
    assert change(picture, outside) == ground


def test_the_line_is_a_course_that_the_ball_can_go() -> None:
    """Half of the courses bounce to one side, half to the other: their mean would go straight on, where none does."""
    bent = fan(0.3)
    bent.courses[..., 1] = 0.6 + np.where(np.arange(101) % 2, 0.3, -0.3)[:, None] * np.linspace(0, 1, 20)
    assert min(np.abs(bent.middle - course).max() for course in bent.courses) == 0
    assert abs(bent.middle[-1, 1] - 0.6) > 0.2


def test_the_line_of_an_even_fan_is_in_its_middle() -> None:
    even = fan(0.3)
    np.testing.assert_allclose(even.middle[-1], [2.0, 0.6], atol=1e-9)
    even.courses[::2, 15:] = np.nan
    assert abs(even.middle[10, 1] - 0.6) < 0.02


def test_courses_that_end_in_a_pocket_end_there() -> None:
    half = fan(0.3)
    half.courses[:, 10:] = np.nan
    picture = draw_fans(TABLE, [half], "")
    assert change(picture, (1.0, 0.6)) > 40
    assert change(picture, (1.95, 0.6)) == change(draw_fans(TABLE, [], ""), (1.95, 0.6))


def test_a_ball_that_stays_has_no_fan() -> None:
    still = fan(0.0)
    still.courses[:] = still.courses[:, :1]
    picture = draw_fans(TABLE, [still], "")
    np.testing.assert_array_equal(picture[:, 700:], draw_fans(TABLE, [], "")[:, 700:])


def test_a_ball_is_not_hidden_by_where_another_began() -> None:
    ways = [np.array([[0.5, 0.6], [1.5, 0.6]]), np.array([[1.5, 0.6], [2.0, 0.9]])]
    both = draw_plan(TABLE, ["cue", "red"], ways, np.empty((0, 2)), "")
    inset = furnished(TABLE, CLOTH, False, WIDTH)
    for ball, way in enumerate(ways):
        column, row = inset.plan(way[-1]) // (SUPERSAMPLE << SHIFT)
        np.testing.assert_array_equal(both[row, column], colours_of(["cue", "red"])[ball])
