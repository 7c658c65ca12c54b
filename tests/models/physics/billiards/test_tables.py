"""Presets of tables, and the text that names a table."""

from __future__ import annotations

import pytest

from models.core.errors import OptionError
from models.physics.billiards.tables import TABLE_PRESETS, parse_table, replace_ball_radius


@pytest.mark.parametrize("name", TABLE_PRESETS)
def test_a_preset_is_about_twice_as_long_as_wide_and_holds_small_balls(name: str) -> None:
    table = TABLE_PRESETS[name]
    assert table.name == name
    assert 1.98 < table.length / table.width < 2.02
    assert 0.007 < table.ball_radius / table.length < 0.018  # home tables have the largest balls for their length
    assert table.pockets == (table.game != "carom")
    # Phenolic resin weighs 1.6 to 2.1 g/cm3: a preset with a radius of one ball and the mass of another would not.
    volume = 4 / 3 * 3.14159 * table.ball_radius**3
    assert 1500 < table.ball_mass / volume < 2150


def test_a_preset_is_found_by_its_name_in_any_case() -> None:
    assert parse_table(" Pool-9ft ") is TABLE_PRESETS["pool-9ft"]


def test_a_size_in_metres_makes_a_table_with_the_balls_of_the_nearest_one_sold() -> None:
    table = parse_table("2.54x1.27")
    assert (table.length, table.width, table.ball_radius) == (2.54, 1.27, 0.028575)
    assert parse_table("1.42 x 2.84").game == "carom"
    assert parse_table("3.5×1.75").game == "snooker"


def test_a_ball_radius_replaces_that_of_the_preset_and_keeps_the_material() -> None:
    table = parse_table("pool-9ft", 0.0254)
    assert table.ball_radius == 0.0254
    assert table.ball_mass == pytest.approx(0.170 * (0.0254 / 0.028575) ** 3)


@pytest.mark.parametrize("text", ["", "pool", "2.54", "2.54x", "254x127", "2.54x-1.27", "2.54x0.1", "nanx1"])
def test_what_is_no_table_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(OptionError, match=r"2\.54x1\.27|about half as wide"):
        parse_table(text)


@pytest.mark.parametrize("radius", [0.0, -0.03, 28.575, 0.0615, 0.0085, float("nan")])
def test_a_ball_radius_that_is_not_in_metres_is_refused(radius: float) -> None:
    """One is the diameter of a carom ball, one the radius of a marble."""
    with pytest.raises(OptionError, match=r"0\.028575"):
        replace_ball_radius(TABLE_PRESETS["pool-9ft"], radius)


@pytest.mark.parametrize("radius", [0.012, 0.0535])  # the balls of a toy table, and of bocce
def test_balls_of_other_games_have_radii_too(radius: float) -> None:
    assert replace_ball_radius(TABLE_PRESETS["pool-9ft"], radius).ball_radius == radius
