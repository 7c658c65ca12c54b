"""What a changed shot would do, in sentences: what was played, how probably it scores, when balls meet."""

from __future__ import annotations

from typing import Any

import pytest

from models.core.ball_look import BallLook
from models.core.naming import Naming, TableView
from pipeline.reporting.text.number_sentences import format_what_if, format_what_if_question

NAMING = Naming({"white": BallLook("white"), "yellow": BallLook("yellow")}, TableView(1), "carom")
"""A view from the side: the left cushion is the far one of the picture."""
REAL = {"speed": 2.88, "side": -0.5, "top": 0.2}


def make_document(
    probability: float,
    sigma: float,
    change: dict[str, Any],
    changed: dict[str, float],
    observable: tuple[str, ...] = ("speed", "side", "top"),
) -> dict[str, Any]:
    same = {"speed_factor": 1.0, "speed": None, "angle": 0.0}
    play = {"probability": probability, "probability_sigma": sigma, "events": []}
    event = {"kind": "ball", "a": "white", "b": "yellow", "probability": 1.0, "t": 0.97, "t_sigma": 0.002}
    unsure = {"kind": "cushion", "a": "yellow", "b": "left", "probability": 0.4, "t": 1.5, "t_sigma": 0.2}
    filmed = {"kind": "ball", "a": "white", "b": "yellow", "probability": 0.99, "t": 0.9714, "t_sigma": 3e-4}
    return {
        "cue": "white", "draws": 400, "model": "whole_shot", "clip_end": 4.94, "play_end": 6.45,
        "change": {**same, **change},
        "stroke": {
            "real": {"speed": 2.88, "side": -0.5, "top": 0.2, "observable": observable,
                     "speed_sigma": 0.01, "side_sigma": 0.02, "top_sigma": 0.02},
            "changed": {"speed_sigma": 0.0, "side_sigma": 0.0, "top_sigma": 0.0, **changed},
        },
        "spread": {"speed": 0.0, "angle_deg": 0.0, "source": "none"}, "goal": {"game": "carom"},
        "real": {**play, "scored": False, "events": [filmed]}, "changed": {**play, "events": [event, unsure]},
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
        " 0.1 right side spin instead of 0.50 left side spin."
    )


def test_without_a_change_the_events_of_the_film_are_stated_and_no_others() -> None:
    lines = format_what_if(make_document(0.34, 0.024, {}, REAL), NAMING)
    assert lines[:2] == (
        "Nothing is changed. In the film: the white touches the yellow at 0.9714 s ± 0.3 ms (99 %).",
        "The real shot did not score. Played again as it was struck, the carom is made with a probability of 34 ± 2 %.",
    )
    assert not any("Played so" in line for line in lines)


def test_a_spin_that_the_film_does_not_show_has_no_number() -> None:
    added = {"side": None, "side_added": 0.1}
    more = make_document(0.5, 0.02, added, {"speed": 2.88, "side": 0.1, "top": 0.2}, ("speed", "top"))
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
    lines = format_what_if(make_document(probability, sigma, {"angle": 1.0}, REAL), NAMING)
    assert lines[1] == (
        f"Played so, the carom is made with a probability {words}; as it was struck, with a probability {words}."
        " The real shot did not score."
    )


def test_events_have_times_and_the_ends_of_the_paths_are_stated() -> None:
    lines = format_what_if(make_document(0.5, 0.02, {"angle": 1.0}, REAL), NAMING)
    assert lines[3:] == (
        "Played so: the white touches the yellow at 0.9700 s ± 2.0 ms, the yellow hits the far short cushion at"
        " 1.50 s ± 0.20 s (40 %). These are the plays; the film is in the report.",
        "In the image the real paths end with the clip, at 4.940 s; those of the plays go on until the balls rest, at"
        " most to 6.450 s.",
    )


def test_a_spin_whose_side_is_not_known_may_be_zero() -> None:
    more = make_document(0.5, 0.02, {}, {"speed": 2.88, "side": 0.1, "top": 0.2})
    assert "0.1 right side spin instead of 0.50 left side spin" in format_what_if(more, NAMING)[0]
    more["stroke"]["real"] |= {"side": -0.3, "side_sigma": 0.2}
    assert "0.1 right side spin instead of one that may be zero" in format_what_if(more, NAMING)[0]


def test_numbers_of_the_stroke_are_as_exact_as_other_outputs_state_them() -> None:
    """The page rounds 0.94 ± 0.36 to 0.9."""
    more = make_document(0.5, 0.02, {"side": 1.0}, {"speed": 2.88, "side": 1.0, "top": 0.2})
    more["stroke"]["real"] |= {"side": 0.94, "side_sigma": 0.36}
    assert "1 right side spin instead of 0.9 right side spin" in format_what_if(more, NAMING)[0]


def test_a_shot_in_which_the_cue_ball_falls_does_not_score() -> None:
    """The events list that pot, so that the goal says which ball it is about."""
    pot = make_document(0.0, 0.004, {}, REAL) | {"goal": {"game": "pot", "ball": "", "pocket": ""}}
    assert (
        "an object ball is potted and the cue ball is not with a probability below 1 %"
        in format_what_if(pot, NAMING)[1]
    )
