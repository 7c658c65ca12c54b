"""An answer is indexed by the name of a quantity, and by its ball where every ball has one."""

from __future__ import annotations

import pytest

from models.core.answer import Answer, Quantity

ANSWER = Answer(
    "Where did the balls lie?", ("Here:",),
    quantities=(
        Quantity("x", 0.5, 1e-3, "m", "cue", "cue ball"), Quantity("x", 1.5, 2e-3, "m", "solid-1", "red 3"),
        Quantity("time", 0.2, 1e-4, "s"), Quantity("y", 0.3, 1e-3, "m", "cue", "cue ball"),
    ),
)  # fmt: skip


@pytest.mark.parametrize("ball", ["solid-1", "red 3"])
def test_a_ball_is_named_by_id_or_by_what_a_person_says(ball: str) -> None:
    assert ANSWER["x", ball].value == 1.5
    assert ANSWER["x", "cue"].value == 0.5


def test_what_only_one_has_needs_no_ball() -> None:
    assert ANSWER["time"].value == 0.2
    assert ANSWER["y"].value == 0.3


@pytest.mark.parametrize(
    ("key", "wanted"),
    [
        ("x", "of a ball, such as 'x', 'cue ball'"), (("y", "red 3"), "has x, time, y; got"),
        (("x", "blue"), "got ('x', 'blue')"), ("z", "got 'z'"),
    ],
)  # fmt: skip
def test_what_is_missing_or_of_several_balls_is_named(key: str | tuple[str, str], wanted: str) -> None:
    with pytest.raises(KeyError) as error:
        ANSWER[key]
    assert wanted in error.value.args[0]


def test_an_answer_without_quantities_says_so() -> None:
    with pytest.raises(KeyError, match="no quantity"):
        Answer("Why?", ("So.",))["x"]
