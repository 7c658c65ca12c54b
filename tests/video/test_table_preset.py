"""Tables are named by what is seen of them, and the name is doubted where something else is nearly as probable."""

from __future__ import annotations

import numpy as np
import pytest

from models.physics.billiards.tables import PRESETS
from video.calibration.ball_size import BallSizes
from video.calibration.table_classifier import COMMON, COULD_BE, SURE, guess_table


def _sizes(name: str, sigma: float = 0.03, factor: float = 1.0) -> BallSizes:
    share = factor * PRESETS[name].ball_radius / PRESETS[name].length
    return BallSizes(share, sigma * share, 20)


@pytest.mark.parametrize("name", ["pool-9ft", "pool-8ft", "pool-7ft", "snooker-12ft", "carom-match", "carom-210"])
def test_balls_that_are_well_measured_name_the_table(name: str) -> None:
    assert guess_table(_sizes(name), PRESETS[name].pockets, has_d=False).table.name == name


def test_a_nine_foot_table_with_clear_balls_is_not_doubted() -> None:
    guess = guess_table(_sizes("pool-9ft"), pockets=True, has_d=False)
    assert guess.probabilities["pool-9ft"] > SURE
    assert guess.doubts == ()


def test_probabilities_of_all_presets_add_up_to_one() -> None:
    guess = guess_table(_sizes("pool-8ft", sigma=0.08), pockets=True, has_d=False)
    assert set(guess.probabilities) == set(COMMON)
    assert sum(guess.probabilities.values()) == pytest.approx(1)
    assert guess.probabilities[guess.table.name] == max(guess.probabilities.values())
    assert guess.probabilities["carom-match"] == 0


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.03])
def test_eight_feet_that_could_be_nine_are_doubted_with_what_that_would_do_to_lengths(factor: float) -> None:
    guess = guess_table(_sizes("pool-8ft", sigma=0.07, factor=factor), pockets=True, has_d=False)
    (doubt,) = guess.doubts
    assert doubt.startswith(COULD_BE)
    assert "give --table" in doubt
    if guess.table.name == "pool-8ft":
        assert "pool-9ft (every length and speed 14 % larger)" in doubt
    else:
        assert "pool-8ft (every length and speed 12 % smaller)" in doubt


def test_without_balls_the_commonest_table_is_taken_and_doubted() -> None:
    guess = guess_table(BallSizes(np.nan, np.nan, 0), pockets=True, has_d=False)
    assert guess.table.name == "pool-9ft"
    assert "no ball could be measured" in guess.note
    assert guess.doubts


def test_a_d_on_the_cloth_decides_between_a_small_snooker_and_a_pool_table() -> None:
    sizes = _sizes("snooker-6ft", sigma=0.05)
    assert guess_table(sizes, pockets=True, has_d=True).table.name == "snooker-6ft"
    assert guess_table(sizes, pockets=True, has_d=True).doubts == ()
    assert guess_table(sizes, pockets=True, has_d=False).table.name == "pool-7ft"
