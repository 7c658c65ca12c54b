"""Names of balls from their paint: the colours of a set give numbers, and what is not clear stays without."""

from __future__ import annotations

import numpy as np
import pytest

from models.tracking.ball_names import PAINT, STANDARD_SET, TELEVISION_SET, name_balls


def to_lab(name: str) -> np.ndarray:
    """CIE L*a*b* of a paint."""
    lightness, chroma, hue = PAINT[name]
    return np.array([lightness, chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))])


def name_all(paint: np.ndarray, kind: str, is_certain: bool = True, shows_class: bool = True) -> list[tuple[str, int]]:
    """Name balls of one class."""
    ids = [f"{kind}-{k + 1}" for k in range(len(paint))]
    certain, shows = np.full(len(ids), is_certain), np.full(len(ids), shows_class)
    return list(name_balls(ids, [kind] * len(ids), paint, certain, shows, "pool"))


@pytest.mark.parametrize("colours", [STANDARD_SET, TELEVISION_SET])
@pytest.mark.parametrize(("kind", "first"), [("solid", 1), ("stripe", 9)])
def test_all_seven_colours_of_a_set_get_their_numbers(
    colours: tuple[tuple[str, ...], ...], kind: str, first: int
) -> None:
    order = np.random.default_rng(0).permutation(7)
    named = name_all(np.array([to_lab(colours[k][0]) for k in order]), kind)
    assert named == [(f"{colours[k][0]} {k + first}", k + first) for k in order]


def test_light_that_shifts_all_colours_gives_no_wrong_number() -> None:
    rng = np.random.default_rng(1)
    numbered = 0
    for _ in range(300):
        own = rng.permutation(7)[: rng.integers(1, 8)]
        paint = np.array([to_lab(STANDARD_SET[k][0]) for k in own])
        paint += rng.normal(0, [8, 4, 4]) + rng.normal(0, 3, paint.shape)
        numbers = [number for _, number in name_all(paint, "solid")]
        assert all(number in (0, k + 1) for number, k in zip(numbers, own, strict=True)), (own, numbers)
        numbered += np.count_nonzero(numbers)
    assert numbered > 300


def test_an_uncertain_paint_gives_no_number() -> None:
    assert all(number == 0 for _, number in name_all(np.array([to_lab("red"), to_lab("green")]), "solid", False))


def test_a_ball_that_may_be_solid_or_striped_gets_its_colour_and_no_number() -> None:
    paint = np.array([to_lab("red"), to_lab("green")])
    assert name_all(paint, "solid", shows_class=False) == [("red", 0), ("green", 0)]
    assert name_all(paint, "stripe", shows_class=False) == [("red ball", 0), ("green ball", 0)]


def test_a_ball_whose_paint_no_frame_shows_is_called_by_its_class_and_no_number_of_its_id() -> None:
    nothing = np.full((2, 3), np.nan)
    assert name_all(nothing, "stripe") == [("stripe A", 0), ("stripe B", 0)]
    assert name_all(nothing[:1], "solid") == [("solid", 0)]


def test_solids_show_that_the_set_is_one_for_television_also_for_its_stripes() -> None:
    ids, kinds = ["solid-1", "solid-2", "stripe-1"], ["solid", "solid", "stripe"]
    paint = np.array([to_lab("red"), to_lab("pink"), to_lab("pink")])
    names = [name for name, _ in name_balls(ids, kinds, paint, np.ones(3, bool), np.ones(3, bool), "pool")]
    assert names == ["red 3", "pink 4", "pink 12"]


def test_two_balls_of_one_colour_have_names_that_differ_and_at_most_one_number() -> None:
    named = name_all(np.array([to_lab("red"), to_lab("red") + 2]), "solid")
    assert len({name for name, _ in named}) == 2
    assert sum(number > 0 for _, number in named) <= 1


def test_balls_of_other_games_are_called_by_their_class() -> None:
    paint = np.array([to_lab("red"), to_lab("green")])
    assert name_balls(["red", "green"], ["red", "green"], paint, np.ones(2, bool), np.ones(2, bool), "snooker") == (
        ("red", 0),
        ("green", 0),
    )
