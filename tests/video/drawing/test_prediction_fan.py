"""Prediction fans are shaded where samples go, most where most go, and not elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.ball_look import describe_unseen_balls
from models.core.naming import TableView, build_naming
from models.core.scene import Table
from video.drawing.prediction_fan import PredictionFan, draw_prediction_fans
from video.drawing.table_plan import (
    CLOTH_COLOUR,
    PLAN_WIDTH,
    SHIFT,
    SUPERSAMPLE,
    build_empty_inset,
    draw_table_plan,
)

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
NAMING = build_naming(TABLE, None, ("cue", "red"), describe_unseen_balls(("cue", "red"), ("cue", "red")))


def fan(spread: float) -> PredictionFan:
    """Samples from (0.5, 0.6) m along x that diverge evenly to both sides."""
    t = np.linspace(0, 1, 20)
    tilt = np.linspace(-spread, spread, 101)
    courses = np.stack([np.broadcast_to(0.5 + 1.5 * t, (101, 20)), 0.6 + tilt[:, None] * t], axis=2)
    nothing = np.empty((0, 2))
    return PredictionFan("red", courses[0, :1], courses, nothing)


def change(image: np.ndarray, xy: tuple[float, float]) -> float:
    """Levels by which the image differs from an empty table at a place, m."""
    inset = build_empty_inset(TABLE, CLOTH_COLOUR, TableView(), PLAN_WIDTH)
    column, row = inset.to_fixed_point(np.array(xy)) // (SUPERSAMPLE << SHIFT)
    return float(np.abs(image[row, column].astype(int) - np.array(CLOTH_COLOUR)).max())


def test_the_middle_of_a_fan_is_shaded_most_and_its_outside_not_at_all() -> None:
    image = draw_prediction_fans(TABLE, NAMING, [fan(0.3)], "")
    empty = draw_prediction_fans(TABLE, NAMING, [fan(0.0)], "")
    middle, side, outside = ((1.95, 0.6), (1.95, 0.6 + 0.21), (1.95, 0.6 + 0.29 + 0.1))
    ground = change(empty, outside)
    assert change(image, middle) > change(image, side) + 20
    assert change(image, side) > ground + 20
    assert change(image, outside) == ground


@pytest.mark.parametrize(("step", "is_closed"), [(7, True), (20, False)])
def test_a_gap_between_paths_is_closed_where_no_ball_fits_into_it(step: int, is_closed: bool) -> None:
    """Paths end 6 mm times the step apart; a ball has 57 mm."""
    sparse, far = fan(0.3), 0.3 * (2 * (50 + step / 2) / 100 - 1)
    sparse.samples[:] = sparse.samples[50 + step * np.round((np.arange(101) - 50) / step).clip(-2, 2).astype(int)]
    image = draw_prediction_fans(TABLE, NAMING, [sparse], "")
    empty = change(draw_prediction_fans(TABLE, NAMING, [], ""), (1.95, 0.6 + far * 0.97))
    assert (change(image, (1.95, 0.6 + far * 0.97)) > empty + 20) == is_closed


def test_the_text_stands_below_the_table_and_hides_nothing() -> None:
    without, with_text = (draw_prediction_fans(TABLE, NAMING, [fan(0.3)], text) for text in ("", "two\nlines"))
    assert with_text.shape[0] > without.shape[0]
    np.testing.assert_array_equal(with_text[: without.shape[0]], without)


def test_the_medoid_is_a_path_that_the_ball_can_take() -> None:
    """Half of the samples rebound to one side, half to the other; their mean would go straight on, where none does."""
    bent = fan(0.3)
    bent.samples[..., 1] = 0.6 + np.where(np.arange(101) % 2, 0.3, -0.3)[:, None] * np.linspace(0, 1, 20)
    assert min(np.abs(bent.medoid_path - course).max() for course in bent.samples) == 0
    assert abs(bent.medoid_path[-1, 1] - 0.6) > 0.2


def test_the_medoid_of_an_even_fan_is_in_its_middle() -> None:
    even = fan(0.3)
    np.testing.assert_allclose(even.medoid_path[-1], [2.0, 0.6], atol=1e-9)
    even.samples[::2, 15:] = np.nan
    assert abs(even.medoid_path[10, 1] - 0.6) < 0.02


def test_samples_that_end_in_a_pocket_end_there() -> None:
    half = fan(0.3)
    half.samples[:, 10:] = np.nan
    image = draw_prediction_fans(TABLE, NAMING, [half], "")
    assert change(image, (1.0, 0.6)) > 40
    assert change(image, (1.95, 0.6)) == change(draw_prediction_fans(TABLE, NAMING, [], ""), (1.95, 0.6))


def test_a_resting_ball_has_no_fan() -> None:
    still = fan(0.0)
    still.samples[:] = still.samples[:, :1]
    image = draw_prediction_fans(TABLE, NAMING, [still], "")
    np.testing.assert_array_equal(image[:, 700:], draw_prediction_fans(TABLE, NAMING, [], "")[:, 700:])


def test_the_end_of_a_ball_is_not_hidden_by_the_start_of_another() -> None:
    ways = [np.array([[0.5, 0.6], [1.5, 0.6]]), np.array([[1.5, 0.6], [2.0, 0.9]])]
    both = draw_table_plan(TABLE, NAMING, ["cue", "red"], ways, np.empty((0, 2)), "")
    inset = build_empty_inset(TABLE, CLOTH_COLOUR, TableView(), PLAN_WIDTH)
    for ball, way in enumerate(ways):
        column, row = inset.to_fixed_point(way[-1]) // (SUPERSAMPLE << SHIFT)
        np.testing.assert_array_equal(both[row, column], NAMING.looks[("cue", "red")[ball]].colour)
