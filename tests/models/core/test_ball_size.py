"""One estimate of the ball size: agreement, contradiction, and precedence of its sources."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import pytest
from support import synthetic_run

from models.core.scene import BallSize, combine_ball_sizes, find_contradictions
from models.physics.billiards.tables import estimate_typed_ball_size, format_contradiction

PRESET = BallSize(0.028575, 3.7e-5, "preset")


def from_images(factor: float, relative_sigma: float = 0.02) -> BallSize:
    return BallSize(factor * PRESET.radius, relative_sigma * factor * PRESET.radius, "image")


@pytest.mark.parametrize("factor", [0.95, 0.99, 1.0, 1.01, 1.05])
def test_a_nominal_size_that_the_images_confirm_is_kept_to_the_last_digit(factor: float) -> None:
    size = combine_ball_sizes([PRESET, from_images(factor)])
    assert (size.radius, size.sigma, size.source) == (PRESET.radius, PRESET.sigma, "combined")
    assert find_contradictions([PRESET, from_images(factor)]) == []


def test_images_replace_a_preset_that_they_contradict() -> None:
    seen = from_images(1.1)
    for estimates in permutations([PRESET, seen]):
        assert combine_ball_sizes(estimates) == seen
        assert len(find_contradictions(estimates)) == 1


def test_a_contradiction_needs_three_sigmas_and_three_percent() -> None:
    assert not find_contradictions([PRESET, from_images(1.025, 0.002)])  # 12 sigmas, but a small difference
    assert not find_contradictions([PRESET, from_images(1.1, 0.04)])  # 2.4 sigmas
    assert find_contradictions([PRESET, from_images(1.1, 0.03)])  # 3.2 sigmas
    guess = replace(PRESET, sigma=0.08 * PRESET.radius)  # one of several candidate tables
    assert not find_contradictions([guess, from_images(1.1, 0.02)])


def test_a_guess_among_tables_does_not_replace_a_size_that_was_measured_better() -> None:
    guess = replace(PRESET, sigma=0.5 * PRESET.radius)
    seen = from_images(1.5, 0.02)
    assert combine_ball_sizes([guess, seen]) == seen
    assert combine_ball_sizes([guess, from_images(1.01)]).radius == PRESET.radius


def test_every_pair_of_independent_estimates_is_compared() -> None:
    contacts = BallSize(0.0320, 1e-4, "contacts")
    pairs = find_contradictions([PRESET, from_images(1.0), contacts])
    assert [(one.source, two.source) for one, two in pairs] == [("preset", "contacts"), ("image", "contacts")]


def test_the_size_of_the_user_wins_but_is_contradicted() -> None:
    user = estimate_typed_ball_size(0.026)
    assert combine_ball_sizes([user, from_images(1.0)]) == user
    ((one, two),) = find_contradictions([user, from_images(1.0)])
    assert format_contradiction(one, two, "pool-9ft") == (
        "The balls look 10 % larger than stated, 52 mm in diameter: that or the size of the table may be wrong."
    )


def test_a_typed_size_is_as_exact_as_its_last_digit() -> None:
    assert estimate_typed_ball_size(0.028575).sigma == pytest.approx(5e-7)
    assert estimate_typed_ball_size(0.0286).sigma == pytest.approx(5e-5)
    assert estimate_typed_ball_size(0.03).sigma == pytest.approx(0.005 * 0.03)
    assert estimate_typed_ball_size(3e-2) == estimate_typed_ball_size(0.03)


def test_a_contradiction_is_one_sentence_with_a_remedy() -> None:
    assert format_contradiction(PRESET, from_images(1.08), "pool-9ft") == (
        "The balls look 8 % larger than those of a pool-9ft table: its size may be wrong;"
        " state the table, or the size of its balls."
    )
    assert "13 % smaller" in format_contradiction(PRESET, from_images(0.87), "pool-9ft")


def test_estimates_without_a_nominal_or_apparent_size_are_refused() -> None:
    with pytest.raises(ValueError, match="user, a preset or the images"):
        combine_ball_sizes([BallSize(0.03, 1e-4, "contacts")])
    with pytest.raises(ValueError, match="above 0 m"):
        BallSize(0.0, 1e-4, "user")


def test_a_scene_has_one_ball_size() -> None:
    scene = synthetic_run.make_scene()
    assert scene.ball_size == BallSize(0.03, 0.0, "preset")
    typed = replace(scene, ball_size_estimates=(BallSize(0.03, 5e-5, "user"), BallSize(0.033, 5e-4, "image")))
    assert typed.ball_size == BallSize(0.03, 5e-5, "user")
    with pytest.raises(ValueError, match="equally large"):
        replace(scene, ball_size_estimates=(PRESET,))
