"""Names of balls from their colours."""

from __future__ import annotations

import numpy as np

from models.association.kinds import SNOOKER_COLOURS, Look, name_ids, name_kinds


def _look(colours: list[tuple[float, float, float]], white: list[float]) -> Look:
    return Look(np.array(colours, float), np.array(white, float), np.array(white, float))


def test_snooker_colours_are_told_in_warm_and_dim_light() -> None:
    kinds = [*SNOOKER_COLOURS, "red", "red"]
    colours = np.array([SNOOKER_COLOURS[kind] for kind in kinds])
    white = [0.95 if kind == "cue" else 0.05 for kind in kinds]
    for light in ([1.0, 1.0, 1.0], [0.8, 0.9, 0.9], [1.05, 1.1, 1.0]):
        tinted = colours * light + [0.0, 2.0, 6.0]
        assert name_kinds(_look(list(map(tuple, tinted)), white), "snooker") == tuple(kinds)


def test_carom_balls_are_told_from_each_other() -> None:
    look = _look([(70, 5, 55), (42, 50, 30), (80, -2, 15)], [0.1, 0.0, 0.8])
    assert name_kinds(look, "carom") == ("yellow", "red", "white")


def test_two_carom_balls_get_their_own_names() -> None:
    assert name_kinds(_look([(42, 50, 30), (80, -2, 15)], [0.0, 0.8]), "carom") == ("red", "white")


def test_pool_has_one_cue_ball_one_eight_solids_and_stripes() -> None:
    look = _look([(88, 0, 8), (15, 1, 2), (40, 55, 35), (60, 10, 45), (45, 10, -40)], [0.97, 0.08, 0.03, 0.45, 0.02])
    assert name_kinds(look, "pool") == ("cue", "eight", "solid", "stripe", "solid")


def test_a_struck_ball_that_is_pale_is_the_cue_ball_in_tinted_light() -> None:
    colours = [(75, -16, 28), (63, -15, 23), (58, 16, 53), (11, -4, -10)]
    look = _look(colours, [0.36, 0.36, 0.0, 0.0])
    assert name_kinds(look, "pool") == ("stripe", "stripe", "solid", "eight")
    assert name_kinds(look, "pool", struck=0) == ("cue", "stripe", "solid", "eight")


def test_a_coloured_ball_that_is_struck_is_no_cue_ball() -> None:
    look = _look([(88, 0, 8), (40, 55, 35), (60, 10, 45)], [0.97, 0.03, 0.1])
    assert name_kinds(look, "pool", struck=1) == ("cue", "solid", "solid")


def test_english_pool_has_reds_and_yellows() -> None:
    look = _look([(88, 0, 8), (15, 1, 2), *[(40, 55, 35)] * 6, *[(75, 5, 65)] * 5], [0.97, 0.05, *[0.03] * 11])
    assert name_kinds(look, "pool") == ("cue", "eight", *["red"] * 6, *["yellow"] * 5)


def test_a_table_without_balls_has_no_names() -> None:
    for game in ("pool", "snooker", "carom"):
        assert name_kinds(Look(np.empty((0, 3)), np.empty(0), np.empty(0)), game) == ()


def test_ids_count_from_the_left() -> None:
    xy = np.array([[2.0, 0.5], [0.3, 0.9], [0.3, 0.2], [1.0, 1.0]])
    assert name_ids(("red", "red", "red", "cue"), xy) == ("red-3", "red-2", "red", "cue")
    assert name_ids(("solid", "stripe", "solid", "ball"), xy) == ("solid-2", "stripe-1", "solid-1", "ball-1")
