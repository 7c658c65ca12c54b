"""Classification of tables, and warnings where another table is nearly as probable."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import ImageArray
from models.physics.billiards.tables import TABLE_PRESETS
from video.calibration.ball_size import BallSizes
from video.calibration.table_classifier import (
    ALTERNATIVES_PREFIX,
    BAULK_SHARE,
    SURE_PROBABILITY,
    TABLE_PRIOR,
    classify_table,
    find_baulk_line,
)

CLOTH_CORNERS = np.array([[100.0, 60.0], [1180.0, 60.0], [1180.0, 600.0], [100.0, 600.0]])


def _make_sizes(name: str, sigma: float = 0.03, factor: float = 1.0) -> BallSizes:
    share = factor * TABLE_PRESETS[name].ball_radius / TABLE_PRESETS[name].length
    return BallSizes(share, sigma * share, 20)


@pytest.mark.parametrize("name", ["pool-9ft", "pool-8ft", "pool-7ft", "snooker-12ft", "carom-match", "carom-210"])
def test_well_measured_balls_identify_the_table(name: str) -> None:
    assert classify_table(_make_sizes(name), TABLE_PRESETS[name].pockets, has_d=False).table.name == name


def test_a_nine_foot_table_with_clear_balls_gives_no_warning() -> None:
    guess = classify_table(_make_sizes("pool-9ft"), pockets=True, has_d=False)
    assert guess.probabilities["pool-9ft"] > SURE_PROBABILITY
    assert guess.warnings == ()
    assert guess.scale_sigma == 0


def test_a_guessed_table_is_as_uncertain_in_all_lengths_as_its_alternatives_differ() -> None:
    guess = classify_table(_make_sizes("pool-8ft", sigma=0.08), pockets=True, has_d=False)
    assert guess.warnings
    assert 0.05 < guess.scale_sigma < 0.2, "the next sizes are 12 % smaller and 16 % larger"


def test_probabilities_of_all_presets_add_up_to_one() -> None:
    guess = classify_table(_make_sizes("pool-8ft", sigma=0.08), pockets=True, has_d=False)
    assert set(guess.probabilities) == set(TABLE_PRIOR)
    assert sum(guess.probabilities.values()) == pytest.approx(1)
    assert guess.probabilities[guess.table.name] == max(guess.probabilities.values())
    assert guess.probabilities["carom-match"] == 0


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.03])
def test_a_table_that_may_be_eight_or_nine_feet_gives_a_warning_with_the_effect_on_lengths(factor: float) -> None:
    guess = classify_table(_make_sizes("pool-8ft", sigma=0.07, factor=factor), pockets=True, has_d=False)
    (doubt,) = guess.warnings
    assert doubt.startswith(ALTERNATIVES_PREFIX)
    named = doubt.removeprefix(ALTERNATIVES_PREFIX).split()[0]
    assert doubt.endswith(f"If you know the size, run it again with the table stated, such as {named}.")
    if guess.table.name == "pool-8ft":
        assert "pool-9ft (every length and speed 14 % larger)" in doubt
    else:
        assert "pool-8ft (every length and speed 12 % smaller)" in doubt


def test_balls_that_no_preset_has_leave_the_nearest_table_and_say_that_it_is_a_guess() -> None:
    guess = classify_table(_make_sizes("home-4ft", factor=1.4), pockets=True, has_d=False)
    assert guess.table.name == "home-4ft", "not the most common of all tables"
    (doubt,) = guess.warnings
    assert doubt.startswith(ALTERNATIVES_PREFIX)


def test_without_balls_the_most_common_table_is_chosen_with_a_warning() -> None:
    guess = classify_table(BallSizes(np.nan, np.nan, 0), pockets=True, has_d=False)
    assert guess.table.name == "pool-9ft"
    assert "no ball could be measured" in guess.note
    assert guess.warnings


def test_without_a_view_of_the_pockets_the_size_of_the_table_is_a_guess() -> None:
    guess = classify_table(_make_sizes("carom-match"), pockets=None, has_d=False)
    (doubt,) = guess.warnings
    assert doubt.startswith("The table size is a guess: it could also be ")
    assert "its pockets could not be measured" in guess.note
    assert {"pool-9ft", "carom-match"} <= {name for name, share in guess.probabilities.items() if share > 0.05}


def test_a_d_on_the_cloth_decides_between_a_small_snooker_and_a_pool_table() -> None:
    sizes = _make_sizes("snooker-6ft", sigma=0.05)
    assert classify_table(sizes, pockets=True, has_d=True).table.name == "snooker-6ft"
    assert classify_table(sizes, pockets=True, has_d=True).warnings == ()
    assert classify_table(sizes, pockets=True, has_d=False).table.name == "pool-7ft"


@pytest.mark.parametrize("share", [BAULK_SHARE, 1 - BAULK_SHARE, 0.22])
@pytest.mark.parametrize("level", [90, 130], ids=["dark", "bright"])
def test_a_baulk_line_is_found_at_either_end_and_whatever_its_colour(share: float, level: int) -> None:
    assert find_baulk_line(_draw_line(share, level), CLOTH_CORNERS) == pytest.approx(share, abs=0.004)


@pytest.mark.parametrize("share", [0.5, 0.25])
def test_another_line_and_a_cloth_without_one_are_no_baulk_line(share: float) -> None:
    assert find_baulk_line(_draw_line(share, 130), CLOTH_CORNERS) is None
    assert find_baulk_line(_draw_line(share, 110), CLOTH_CORNERS) is None
    both = np.maximum(_draw_line(BAULK_SHARE, 130), _draw_line(1 - BAULK_SHARE, 130))
    assert find_baulk_line(both, CLOTH_CORNERS) is None


def _draw_line(share: float, level: int) -> ImageArray:
    """Draw a grey cloth of level 110 with a line across it, and a ball on that."""
    image = np.full((660, 1280, 3), 110, np.uint8)
    x = round(100 + share * 1080)
    image[60:600, x : x + 2] = level
    image[300:320, x - 10 : x + 10] = 240
    return image
