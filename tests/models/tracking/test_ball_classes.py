"""Ball classes from their colours."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.detections import Detections
from models.tracking.ball_classes import (
    SNOOKER_COLOURS,
    Appearance,
    assign_ids,
    assign_to_set,
    classify_balls,
    find_missing_colours,
    recognise_set,
    summarize_appearance,
)


def _uniform_appearance(colours: list[tuple[float, float, float]], white: list[float]) -> Appearance:
    """Balls of one colour, as white at the rim as elsewhere."""
    lab, share = np.array(colours, float), np.array(white, float)
    value = (lab[:, 0] + 0.3 * np.hypot(lab[:, 1], lab[:, 2])) / 100
    return Appearance(lab, share, share, share, value)


def test_snooker_balls_are_classified_in_warm_and_dim_light() -> None:
    kinds = [*SNOOKER_COLOURS, "red", "red"]
    colours = np.array([SNOOKER_COLOURS[kind] for kind in kinds])
    white = [0.95 if kind == "cue" else 0.05 for kind in kinds]
    for light in ([1.0, 1.0, 1.0], [0.8, 0.9, 0.9], [1.05, 1.1, 1.0]):
        tinted = colours * light + [0.0, 2.0, 6.0]
        assert classify_balls(_uniform_appearance(list(map(tuple, tinted)), white), "snooker") == tuple(kinds)


def test_brown_is_distinguished_from_reds_where_the_camera_makes_both_red() -> None:
    rng = np.random.default_rng(0)
    reds = np.array([51.0, 78, 62]) + rng.normal(0, 1.5, (8, 3))
    appearance = _uniform_appearance([(97, -1, 10), *map(tuple, reds), (47, 65, 53)], [0.95] + [0.0] * 9)
    assert classify_balls(appearance, "snooker") == ("cue", *["red"] * 8, "brown")
    alone = _uniform_appearance([(97, -1, 10), *map(tuple, reds)], [0.95] + [0.0] * 8)
    assert classify_balls(alone, "snooker") == ("cue", *["red"] * 8)


def test_brown_is_distinguished_from_reds_in_uneven_light() -> None:
    light = np.array([[1.1], [0.9], [1.0], [1.05], [0.95], [1.0]])
    reds = light * np.array([46.0, 72, 57])
    appearance = _uniform_appearance([*map(tuple, reds), (51, 63, 56)], [0.0] * 7)
    assert classify_balls(appearance, "snooker") == (*["red"] * 6, "brown")


def test_a_snooker_set_on_another_table_gets_its_own_names() -> None:
    kinds = [*SNOOKER_COLOURS, "red", "red"]
    white = [0.95 if kind == "cue" else 0.4 if kind == "pink" else 0.02 for kind in kinds]
    appearance = _uniform_appearance([SNOOKER_COLOURS[kind] for kind in kinds], white)
    assert classify_balls(appearance, "pool") == tuple(kinds)


def test_an_english_and_an_american_set_are_no_snooker_set() -> None:
    red, yellow, black, cue = (45.0, 60.0, 35.0), (75.0, 5.0, 65.0), (12.0, 0.0, 0.0), (95.0, 0.0, 5.0)
    english = _uniform_appearance([red] * 4 + [yellow] * 3 + [black, cue], [0.0] * 8 + [0.95])
    assert recognise_set(english, "pool") == "pool"
    late = _uniform_appearance([red] * 4 + [yellow, black, cue], [0.0] * 6 + [0.95])
    assert recognise_set(late, "pool") == "pool"
    stripes = [(60.0, 30.0, 20.0), (50.0, 5.0, -30.0), (70.0, 0.0, 45.0)]
    american = _uniform_appearance(
        [red, (35.0, 10.0, -45.0), black, cue, *stripes], [0.0, 0.0, 0.0, 0.95, 0.4, 0.4, 0.4]
    )
    assert recognise_set(american, "pool") == "pool"
    assert recognise_set(american, "snooker") == "pool"


@pytest.mark.parametrize(
    ("kinds", "missing"),
    [
        (("cue", "red", "red", "yellow", "brown", "blue", "pink", "black"), ("green",)),
        (("cue", "red", "yellow", "green", "brown", "blue", "pink", "black"), ()),
        (("cue", "blue", "pink", "black"), ()),  # the others were potted
        (("cue", "brown", "pink", "black"), ("blue",)),
        (("cue", "red", "pink"), ()),  # an exercise
    ],
)
def test_a_colour_that_the_rules_leave_on_the_table_is_missed(kinds: tuple[str, ...], missing: tuple[str, ...]) -> None:
    assert find_missing_colours(kinds) == missing


def test_carom_balls_are_distinguished_from_each_other() -> None:
    appearance = _uniform_appearance([(70, 5, 55), (42, 50, 30), (80, -2, 15)], [0.1, 0.0, 0.8])
    assert classify_balls(appearance, "carom") == ("yellow", "red", "white")


def test_two_carom_balls_get_their_own_names() -> None:
    assert classify_balls(_uniform_appearance([(42, 50, 30), (80, -2, 15)], [0.0, 0.8]), "carom") == ("red", "white")


def test_pool_has_one_cue_ball_one_eight_solids_and_stripes() -> None:
    appearance = _uniform_appearance(
        [(88, 0, 8), (15, 1, 2), (40, 55, 35), (60, 10, 45), (45, 10, -40)], [0.97, 0.08, 0.03, 0.45, 0.02]
    )
    assert classify_balls(appearance, "pool") == ("cue", "eight", "solid", "stripe", "solid")


def test_a_struck_ball_that_is_pale_is_the_cue_ball_in_tinted_light() -> None:
    colours = [(75, -16, 28), (63, -15, 23), (58, 16, 53), (11, -4, -10)]
    appearance = _uniform_appearance(colours, [0.36, 0.36, 0.0, 0.0])
    assert classify_balls(appearance, "pool") == ("stripe", "stripe", "solid", "eight")
    assert classify_balls(appearance, "pool", struck_ball=0) == ("cue", "stripe", "solid", "eight")


def test_a_coloured_ball_that_is_struck_is_no_cue_ball() -> None:
    appearance = _uniform_appearance([(88, 0, 8), (40, 55, 35), (60, 10, 45)], [0.97, 0.03, 0.1])
    assert classify_balls(appearance, "pool", struck_ball=1) == ("cue", "solid", "solid")


def test_english_pool_has_reds_and_yellows() -> None:
    appearance = _uniform_appearance(
        [(88, 0, 8), (15, 1, 2), *[(40, 55, 35)] * 6, *[(75, 5, 65)] * 5], [0.97, 0.05, *[0.03] * 11]
    )
    assert classify_balls(appearance, "pool") == ("cue", "eight", *["red"] * 6, *["yellow"] * 5)


def test_a_table_without_balls_has_no_names() -> None:
    for game in ("pool", "snooker", "carom"):
        assert classify_balls(Appearance(np.empty((0, 3)), *[np.empty(0)] * 4), game) == ()


def test_the_spot_of_a_number_makes_no_stripe() -> None:
    appearance = Appearance(
        np.array([[88.0, 0, 8], [40, 55, 35], [40, 55, 35]]), np.array([0.95, 0.24, 0.24]), np.array([0.95, 0.3, 0.3]),
        np.array([0.95, 0.05, 0.28]), np.array([0.9, 0.6, 0.6]),
    )  # fmt: skip
    assert classify_balls(appearance, "pool") == ("cue", "solid", "stripe")


def test_the_eight_is_dark_in_every_channel_not_the_ball_of_least_lightness() -> None:
    appearance = Appearance(
        np.array([[82.0, -17, 14], [27, -14, 4], [24, -4, -14], [28, 2, 2]]), np.array([0.7, 0.19, 0.02, 0.09]),
        np.array([0.7, 0.2, 0.2, 0.2]), np.array([0.57, 0.07, 0.02, 0.0]), np.array([0.8, 0.22, 0.34, 0.38]),
    )  # fmt: skip
    assert classify_balls(appearance, "pool") == ("cue", "eight", "solid", "solid")


def test_an_occluded_ball_is_classified_where_it_is_unoccluded() -> None:
    frame = np.repeat(np.arange(40), 2)
    x = np.where(frame < 10, 200.0, 115.0)
    x[::2] = 100.0
    one, other = np.ones(80), (np.arange(80) % 2).astype(bool)
    white = np.where(other, 0.95, np.where(frame < 10, 0.02, 0.5))
    detections = Detections(
        frame, np.column_stack([x, 50 * one]), 10 * one, np.zeros((80, 2)), np.tile([40.0, 50, 30], (80, 1)),
        white, white, 0.5 * one, one, 0.3 * one, 0.3 * one,
    )  # fmt: skip
    appearance = summarize_appearance(
        [np.array([40.0, 50, 30])] * 2, [np.flatnonzero(~other), np.flatnonzero(other)], detections
    )
    np.testing.assert_allclose(appearance.white, [0.02, 0.95])
    np.testing.assert_allclose(appearance.white_high, [0.02, 0.95])


def test_only_a_ball_that_rolls_can_show_the_white_of_a_stripe_now_and_then() -> None:
    one, frame = np.ones(60), np.arange(60)
    white = np.where(frame > 50, 0.6, 0.05)  # something pale before it, or its stripe
    for way, high in ((0.0, 0.05), (2.0, 0.6)):
        centre = np.column_stack([100 + way * frame, 50 * one])
        detections = Detections(
            frame, centre, 10 * one, np.zeros((60, 2)), np.tile([40.0, 50, 30], (60, 1)), white, white, 0.5 * one, one,
            0.3 * one, 0.3 * one,
        )  # fmt: skip
        assert summarize_appearance([np.array([40.0, 50, 30])], [frame], detections).white_high == [high]


def test_ids_count_from_the_left() -> None:
    xy = np.array([[2.0, 0.5], [0.3, 0.9], [0.3, 0.2], [1.0, 1.0]])
    assert assign_ids(("red", "red", "red", "cue"), xy) == ("red-3", "red-2", "red", "cue")
    assert assign_ids(("solid", "stripe", "solid", "ball"), xy) == ("solid-2", "stripe-1", "solid-1", "ball-1")


def test_a_corrected_class_renames_no_other_ball() -> None:
    kinds = ("cue", "stripe", "stripe", "solid", "stripe", "eight")
    xy = np.array([[0.1, 0.5], [0.3, 0.5], [0.5, 0.5], [0.7, 0.5], [0.9, 0.5], [1.1, 0.5]])
    before = assign_ids(kinds, xy)
    for ball, kind, expected in ((1, "solid", "solid-2"), (3, "stripe", "stripe-4"), (4, "ball", "ball-1")):
        corrected = [kind if k == ball else one for k, one in enumerate(kinds)]
        after = assign_ids(corrected, xy, before, before)
        assert after[ball] == expected
        assert [name for k, name in enumerate(after) if k != ball] == [n for k, n in enumerate(before) if k != ball]
    assert assign_ids(("solid", "cue", *kinds[2:]), xy, before, before) == ("solid-2", "cue", *before[2:])


def test_a_white_ring_is_no_colour_of_snooker_and_no_second_cue_ball() -> None:
    """The white of the ring is nearest to pink; the cue ball is whiter, and the pink is pale with its highlight."""
    colours = [(99.0, 0, 1), (90, -10, 2), (80, 27, 14), (53, 80, 60)]
    assert classify_balls(_uniform_appearance(colours, [1.0, 0.94, 0.56, 0.0]), "snooker") == (
        "cue", "ball", "pink", "red",
    )  # fmt: skip


def test_a_look_that_fits_no_class_of_snooker_gets_none() -> None:
    """Violet is nearest to blue, which another ball is, and 52 from pink."""
    appearance = _uniform_appearance([(53, 80, 60), (38, 0, -42), (50, 45, -45)], [0.0, 0.0, 0.0])
    assert classify_balls(appearance, "snooker") == ("red", "blue", "ball")


def test_no_set_has_more_balls_of_a_class_than_are_made() -> None:
    stripes = _uniform_appearance([(60, 10, 45)] * 9, [0.6, 0.6, 0.2, *[0.6] * 6])
    assert classify_balls(stripes, "pool") == ("stripe", "stripe", "ball", *["stripe"] * 5, "ball")
    reds = _uniform_appearance([(53, 80, 60)] * 17, [0.0] * 17)
    assert classify_balls(reds, "snooker").count("red") == 15


def test_a_set_is_assigned_jointly() -> None:
    cost = np.array([[0.1, 5.0], [0.2, 5.0], [5.0, 0.3], [5.0, 5.0]])
    assert assign_to_set(cost, {"cue": 1, "solid": 7}, 0.5) == ("cue", "ball", "solid", "ball")
