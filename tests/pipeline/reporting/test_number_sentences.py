"""Numbers in a player's words: known sides only, whole cushions, rails for directions, and where the tip hit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.array_columns import concatenate_rows
from models.core.ball_look import BallLook
from models.core.events import Events
from models.core.fit_result import ShotNumber, ShotNumbers, SpinState
from models.core.naming import Naming
from models.core.scene import Table
from pipeline.reporting.text.number_sentences import (
    format_cushions,
    format_direction,
    format_hit,
    format_number,
    format_shot_line,
    list_number_rows,
    name_heading,
)
from pipeline.reporting.text.prediction_sentences import format_place

NAMING = Naming({"cue": BallLook("cue ball"), "red": BallLook("red 3")})
RADIUS = 0.028


def make_touch(gap: float) -> Events:
    """The contact of the cue ball and the red whose free paths miss each other by a gap (m)."""
    one = concatenate_rows([shot.make_fit(np.linspace(0, 0.8, 25)).events], np.array([0]))
    return replace(one, kind=("ball",), a=("red",), b=("cue",), t=np.array([0.9]), gap=np.array([gap]))


def make_numbers(*numbers: ShotNumber, spin: SpinState = "roll", chances: tuple[float, ...] = ()) -> ShotNumbers:
    return ShotNumbers(0.5, "cue", "red", spin, chances, (), (), numbers)


@pytest.mark.parametrize(
    ("name", "unit"), [("top_spin", "rad/s"), ("side_spin_share", ""), ("throw", "deg"), ("contact_spin_share", "")]
)
def test_a_number_whose_error_holds_zero_has_no_side(name: str, unit: str) -> None:
    words = format_number(ShotNumber(name, -17.0, 34.0, unit, True))
    assert words.startswith("may be zero (17 ± 34")
    assert not set(words.replace("(", " ").replace(")", " ").split()) & {"top", "back", "left", "right", "either"}
    assert format_number(ShotNumber(name, -17.0, 3.4, unit, True)).split()[-1] in ("back", "left")


def test_a_number_is_apart_from_its_unit_and_ways_of_balls_stand_elsewhere() -> None:
    spin, way = ShotNumber("top_spin", 14.7, 0.8, "rad/s", True), ShotNumber("length", 1.5, 0.01, "m", True)
    assert format_number(spin) == "14.7 ± 0.8 rad/s top"
    assert [row[2] for row in list_number_rows(make_numbers(spin, way), NAMING, RADIUS)] == ["14.7 ± 0.8 rad/s top"]


@pytest.mark.parametrize(("share", "words"), [(1.0, "11.2 ± 0.1 mm above"), (-0.5, "5.6 ± 0.1 mm below")])
def test_the_tip_hits_where_its_impulse_gives_the_spin(share: float, words: str) -> None:
    """An impulse J at the offset b gives J = m v and J b = 2/5 m R^2 w; a ball hit at 7/5 R above the cloth rolls."""
    number = ShotNumber("top_spin_share", share, 0.01, "", True, "cue")
    rows = {row[0]: row[2] for row in list_number_rows(make_numbers(number), NAMING, RADIUS)}
    assert rows["Cue tip above or below the centre"] == words
    b, v = 1e-3 * float(words.split()[0]) * np.sign(share), 2.0
    assert 5 * v * b / (2 * RADIUS**2) == pytest.approx(share * v / RADIUS, rel=0.01)


def test_a_spin_that_is_not_measured_has_no_place_of_the_tip() -> None:
    vague = ShotNumber("top_spin_share", 0.2, 0.4, "", True, "cue")
    unknown = ShotNumber("side_spin_share", 0.5, 0.01, "", False, "cue")
    assert not [row for row in list_number_rows(make_numbers(vague, unknown), NAMING, RADIUS) if "tip" in row[0]]


@pytest.mark.parametrize(
    ("degrees", "angle", "rails"),
    [
        (15.4, "15.4", "the right short rail and the near long rail"),
        (-19.0, "19.0", "the right short rail and the far long rail"),
        (160.0, "20.0", "the left short rail and the near long rail"),
        (-100.0, "80.0", "the left short rail and the far long rail"),
    ],
)
def test_a_direction_is_that_of_the_rails_it_leads_to(degrees: float, angle: str, rails: str) -> None:
    number = ShotNumber("direction", degrees, 0.1, "deg", True, "cue")
    words = format_direction(number, name_heading(degrees, NAMING))
    assert words == f"{angle} ± 0.1° to the long rails, towards {rails}"


@pytest.mark.parametrize(("count", "words"), [(0.98, "1"), (2.02, "2"), (1.6, "1 or 2"), (0.5, "0 or 1")])
def test_cushions_are_whole(count: float, words: str) -> None:
    assert format_cushions(count) == words


@pytest.mark.parametrize(
    ("chances", "spin", "words"),
    [
        ((0.0, 0.0, 0.02, 0.98), "roll", "natural roll"),
        ((0.0, 0.0, 0.78, 0.22), "follow", "follow or natural roll"),
        ((0.3, 0.3, 0.3, 0.1), "draw", "spin not measurable"),
        ((0.0, 0.0, 0.02, 0.98), "unknown", "spin not measurable"),
    ],
)
def test_a_hit_always_says_its_spin(chances: tuple[float, ...], spin: SpinState, words: str) -> None:
    cut = ShotNumber("cut_angle", 1.0, 0.4, "deg", True, "red")
    full = "full (98 ± 1 % of the ball covered, cut angle 1.0 ± 0.4°)"
    assert format_hit(make_numbers(cut, spin=spin, chances=chances)) == f"{full}, {words}"


@pytest.mark.parametrize(
    ("angle", "sigma", "words"),
    [
        (50.35, 5.0, "quarter ball (23 ± 6 % of the ball covered, cut angle 50 ± 5°)"),
        (-24.7, 1.3, "half ball (58 ± 2 % of the ball covered, cut angle 24.7 ± 1.3°)"),
        (30.0, 8.5, "fullness not measurable"),
    ],
)
def test_how_much_a_hit_covers_follows_from_its_cut_angle(angle: float, sigma: float, words: str) -> None:
    assert format_hit(make_numbers(ShotNumber("cut_angle", angle, sigma, "deg", True, "red"))) == words


def test_the_line_of_a_shot_tells_the_spin_off_the_cue_from_that_at_the_ball() -> None:
    numbers = (
        ShotNumber("top_spin_share", -0.31, 0.01, "", True, "cue"),
        ShotNumber("cut_angle", 8.2, 9.0, "deg", True, "red"),
    )
    line = format_shot_line(make_numbers(*numbers, chances=(0.0, 0.0, 0.0, 1.0)), NAMING, make_touch(np.nan))
    assert line == (
        "the cue ball at about 0.5 s, when it moves already, spin off the cue 0.31 ± 0.01 back,"
        " red 3 first (fullness not measurable, natural roll)"
    )


def test_a_place_is_that_of_the_centre_in_diamonds_where_the_table_has_them() -> None:
    pool, xy = shot.make_scene().table, np.array([0.5, 0.25])
    assert format_place(xy, 0.01, pool, NAMING) == (
        "its centre 25.0 cm (1.0 diamonds) from the far long rail and 50.0 cm (2.0 diamonds) from the left short rail,"
        " each ± 1.0 cm"
    )
    snooker = Table("snooker", "snooker", 2.0, 1.0, 0.026, 0.2, True)
    assert "diamonds" not in format_place(xy, 0.01, snooker, NAMING)
