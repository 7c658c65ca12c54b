"""Tests of the names of balls, rails and pockets, as a viewer of the clip says them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.core.ball_look import BallLook, describe_unseen_balls
from models.core.naming import Naming, TableView, find_table_view, join_names
from models.core.scene import CUSHIONS, POCKETS, Camera, Table

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, True)


def look_from(degrees: float, tilt: float) -> Camera:
    """Build a camera above the middle of the table, turned by `degrees` about the vertical and tilted by `tilt`."""
    yaw, pitch = np.radians([degrees, tilt])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    lean = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    # image x right, y down; the camera looks down, so that height above the cloth is towards it
    rotation = lean @ np.diag([1, 1, -1]) @ turn
    middle = np.array([TABLE.length / 2, TABLE.width / 2, 0])
    translation = np.array([0, 0, 4.0]) - rotation @ middle
    intrinsic = np.array([[1000, 0, 640], [0, 1000, 360], [0, 0, 1]])
    matrix = intrinsic @ np.column_stack([rotation, translation])
    return Camera(matrix, 1280, 720, np.zeros((4, 2)), np.eye(8), "cloth", 4.0, 0.1)


@pytest.mark.parametrize("tilt", [0.0, 50.0])
@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("askew", [-30.0, 0.0, 30.0])
def test_a_rail_is_far_where_it_is_high_in_the_picture(turns: int, askew: float, tilt: float) -> None:
    camera = look_from(90.0 * turns + askew, tilt)
    view = find_table_view(camera, TABLE)
    assert view.turns == turns
    corners = TABLE.corners
    middles = dict(zip(CUSHIONS, (corners[[0, 1, 0, 3]] + corners[[3, 2, 1, 2]]) / 2, strict=True))
    px = {view.name_rail(name): camera.to_pixels(xy, 0.0) for name, xy in middles.items()}
    assert px["far"][1] < px["near"][1]
    assert px["left"][0] < px["right"][0]


@pytest.mark.parametrize("turns", range(4))
def test_a_turned_plan_puts_each_rail_and_pocket_where_its_name_says(turns: int) -> None:
    view = TableView(turns)
    corners = TABLE.corners
    middles = (corners[[0, 1, 0, 3]] + corners[[3, 2, 1, 2]]) / 2
    turned = dict(zip(map(view.name_rail, CUSHIONS), view.turn_points(middles, TABLE), strict=True))
    assert turned["left"][0] == turned["far"][1] == 0
    assert turned["right"][0] > 0
    assert turned["near"][1] > 0
    pockets = dict(zip(map(view.name_pocket, POCKETS), view.turn_points(TABLE.pocket_centres, TABLE), strict=True))
    assert pockets["far-left"].tolist() == [0, 0]
    assert pockets["near-right"].tolist() == turned["right"][:1].tolist() + turned["near"][1:].tolist()
    assert len(set(pockets)) == 6


def test_canonical_and_seen_names_name_the_same_pocket_and_rail() -> None:
    naming = Naming(view=TableView(1))
    assert naming.find_pocket("top-left") == "top-left"
    assert naming.find_pocket("far-right") == naming.find_pocket("far right pocket") == "top-left"
    assert naming.find_pocket("right side") == "top"
    assert naming.find_pocket("top left") == naming.find_pocket("top-left pocket") == "top-left"
    assert naming.name_pocket("top") == "right-side pocket"
    assert naming.name_rail("top") == "right long rail"
    assert replace(naming, game="snooker").name_rail("left") == "far short cushion"
    assert naming.find_pocket("upstairs") is None


def test_a_ball_is_found_by_id_name_number_or_a_word_that_only_it_has() -> None:
    looks = {
        "cue": BallLook("cue ball"), "solid-1": BallLook("red 3", number=3), "solid-3": BallLook("yellow 1", number=1),
        "stripe-1": BallLook("green stripe", is_striped=True), "stripe-2": BallLook("red stripe", is_striped=True),
    }  # fmt: skip
    naming = Naming(looks)
    for text, ball in (
        ("solid-1", "solid-1"), ("Red 3", "solid-1"), ("red-3", "solid-1"), ("3", "solid-1"), ("1", "solid-3"),
        ("white", "cue"), ("cue", "cue"), ("CUE BALL", "cue"), ("green", "stripe-1"), ("red", None), ("stripe", None),
        ("solid-9", None), ("", None), ("the cue ball", "cue"), ("3 ball", "solid-1"), ("solid 3", "solid-1"),
        ("the 1", "solid-3"), ("stripe 2", "stripe-2"),
    ):  # fmt: skip
        assert naming.find_ball(text) == ball, text
    assert naming.name_ball("solid-1") == "red 3"
    assert naming.name_ball("right") == "right"
    assert naming.explain_no_ball("red") == "'red' is red 3 or red stripe"
    assert naming.explain_no_ball("near") == "'near' is a rail, not a ball"
    assert naming.explain_no_ball("9").startswith("no ball of this clip is '9'; it has cue ball (cue), red 3 (solid-1)")
    assert naming.explain_no_ball("3") == ""
    assert naming.list_balls().startswith("cue ball (cue), red 3 (solid-1)")


def test_balls_that_no_clip_shows_are_named_by_class_and_never_alike() -> None:
    looks = describe_unseen_balls(
        ("cue", "eight", "red-1", "red-2", "solid-1"), ("cue", "eight", "red", "red", "solid")
    )
    assert [look.name for look in looks] == ["cue ball", "black 8", "red 1", "red 2", "solid 1"]


def test_names_are_joined_as_in_a_sentence() -> None:
    assert [join_names(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == [
        "",
        "a",
        "a and b",
        "a, b and c",
    ]
