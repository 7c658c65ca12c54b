"""What a changed shot would do, in sentences: what was played, how probably it scores, when balls meet."""

from __future__ import annotations

from typing import Any

import pytest

from models.core.ball_look import BallLook
from models.core.naming import Naming
from models.core.table_view import TableView
from pipeline.reporting.text.what_if_sentences import format_what_if, format_what_if_question

NAMING = Naming({"white": BallLook("white"), "yellow": BallLook("yellow")}, TableView(1), "carom")
"""A view from the side: the left cushion is the far one of the picture."""


def make_document(
    probability: float,
    sigma: float,
    change: dict[str, Any],
    changed: dict[str, float],
    spin_sigma: float = 0.05,
) -> dict[str, Any]:
    same = {"speed_factor": 1.0, "speed": None, "angle": 0.0}
    play = {"probability": probability, "probability_sigma": sigma, "events": []}
    event = {"kind": "ball", "a": "white", "b": "yellow", "probability": 1.0, "t": 0.97}
    unsure = {"kind": "cushion", "a": "yellow", "b": "left", "probability": 0.4, "t": 1.5}
    return {
        "cue": "white", "draws": 400, "model": "whole_shot", "clip_end": 4.94, "play_end": 6.45,
        "change": {**same, **change},
        "stroke": {"real": {"speed": 2.88, "side": -0.5, "top": 0.2, "side_sigma": spin_sigma}, "changed": changed},
        "spread": {"speed": 0.0, "angle_deg": 0.0, "source": "none"}, "goal": {"game": "carom"},
        "real": {**play, "scored": False}, "changed": {**play, "events": [event, unsure]},
    }  # fmt: skip


def test_what_was_played_stands_beside_the_real_stroke() -> None:
    slower = make_document(0.5, 0.02, {"speed_factor": 0.95}, {"speed": 2.736, "side": -0.5, "top": 0.2})
    assert (
        format_what_if(slower, NAMING)[0]
        == "Played with 5 % less speed: 2.74 m/s (9.8 km/h) instead of 2.88 m/s (10.4 km/h)."
    )
    fast = make_document(0.5, 0.02, {"speed": 5.0, "angle": -0.5}, {"speed": 5.0, "side": 0.1, "top": 0.2})
    assert format_what_if(fast, NAMING)[0] == (
        "Played with 74 % more speed: 5.00 m/s (18.0 km/h) instead of 2.88 m/s (10.4 km/h);"
        " the direction turned by 0.5 degrees to the left;"
        " 0.10 right side spin instead of 0.50 left side spin."
    )
    same = make_document(0.5, 0.02, {}, {"speed": 2.88, "side": -0.5, "top": 0.2})
    assert format_what_if(same, NAMING)[0] == "Played as it was struck: nothing is changed."


def test_a_spin_that_the_film_does_not_show_has_no_number() -> None:
    added = {"side": None, "side_added": 0.1}
    more = make_document(0.5, 0.02, added, {"speed": 2.88, "side": 0.1, "top": 0.2}, spin_sigma=0.4)
    sentence = "Played with 0.10 right side spin more than in the real stroke, where it is not measurable."
    assert format_what_if(more, NAMING)[0] == sentence
    assert format_what_if_question(more, NAMING) == f"What if the white is played{sentence[6:-1]}?"


@pytest.mark.parametrize(
    ("probability", "sigma", "words"),
    [
        (0.0012, 0.0018, "below 1 %"),
        (0.0082, 0.0114, "below 4 %"),
        (0.9988, 0.0018, "above 99 %"),
        (0.34, 0.024, "of 34 ± 2 %"),
    ],
)
def test_a_probability_that_is_not_told_from_zero_is_a_limit(probability: float, sigma: float, words: str) -> None:
    real = {"speed": 2.88, "side": -0.5, "top": 0.2}
    lines = format_what_if(make_document(probability, sigma, {}, real), NAMING)
    assert lines[1] == f"Played so, the carom is made with a probability {words}."
    assert lines[2].endswith("the real shot did not score.")


def test_events_have_times_and_the_ends_of_the_paths_are_stated() -> None:
    lines = format_what_if(make_document(0.5, 0.02, {}, {"speed": 2.88, "side": -0.5, "top": 0.2}), NAMING)
    assert (
        "Played so: 0.97 s the white touches the yellow, 1.50 s the yellow hits the far short cushion (40 %)." in lines
    )
    assert (
        "In the image the real paths end with the clip, at 4.94 s; the others go on until the balls rest, at most to"
        " 6.45 s." in lines
    )


def test_a_spin_whose_side_is_not_known_is_none_that_is_measurable() -> None:
    more = make_document(0.5, 0.02, {}, {"speed": 2.88, "side": 0.1, "top": 0.2}, spin_sigma=0.2)
    assert "0.10 right side spin instead of 0.50 left side spin" in format_what_if(more, NAMING)[0]
    more["stroke"]["real"]["side"] = -0.3
    assert "0.10 right side spin instead of no measurable side spin" in format_what_if(more, NAMING)[0]
