"""Edits of tracks by hand: each does what it says, and an edit that names no ball changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from support.tracking_shots import observe, overhead, owners, play

from models.core.corrections import NO_CORRECTIONS, BallMark, BallPlace, Corrections, TrackEdit
from models.core.detections import MarkedDetections
from models.core.tracks import Tracks
from models.tracking.build_tracks import build_tracks

CUE = np.array([0.5, 0.6])
OTHERS = np.array([[1.2, 0.6], [0.4, 1.0], [2.0, 0.3]])
COLOURS = np.array([[95.0, 0.0, 5.0], [45.0, 55.0, 35.0], [40.0, 0.0, -45.0], [70.0, 5.0, 65.0]])
OBSERVED = observe(
    play(CUE, np.array([1.0, 0.1]), OTHERS, seconds=2.0), overhead(), 30, np.random.default_rng(5), clutter=0,
    colours=COLOURS,
)  # fmt: skip
EDGE = 40


def build(corrections: Corrections = NO_CORRECTIONS) -> Tracks:
    return build_tracks(OBSERVED.detections, OBSERVED.frame, OBSERVED.t, overhead(), corrections=corrections)


def place(ball: int, frame: int) -> BallPlace:
    """The place of a true ball."""
    x, y = OBSERVED.px[frame, ball]
    return BallPlace(frame, float(x), float(y))


def column(tracks: Tracks, ball: int, frame: int) -> int:
    """The track that has a true ball in a frame."""
    return int(np.argmax((owners(tracks, OBSERVED.px)[frame - 2 : frame + 3] == ball).sum(axis=0)))


def test_without_edits_every_ball_has_one_track() -> None:
    assert sorted(set(owners(build(), OBSERVED.px).ravel()) - {-1}) == [0, 1, 2, 3]


def test_an_exchange_over_a_span_concerns_this_span_only() -> None:
    edit = TrackEdit("swap", place(2, 20), place(3, 20), first=20, last=EDGE)
    found = owners(build(Corrections(tracks=(edit,))), OBSERVED.px)
    for frame, expected in ((10, [2, 3]), (30, [3, 2]), (50, [2, 3])):
        columns = [k for k in range(4) if set(found[:15, k]) - {-1} in ({2}, {3})]
        firsts = [int(max(set(found[:15, k]) - {-1})) for k in columns]
        near = [int(max(found[frame - 3 : frame + 4, columns[firsts.index(ball)]])) for ball in (2, 3)]
        assert near == expected


def test_a_second_exchange_undoes_the_first() -> None:
    edit = TrackEdit("swap", place(2, 20), place(3, 20), first=20)
    back = TrackEdit("swap", place(2, 30), place(3, 30), first=20)
    assert np.array_equal(build(Corrections(tracks=(edit, back))).xy, build().xy, equal_nan=True)


def test_a_split_makes_two_balls_and_a_merge_one_again() -> None:
    split = TrackEdit("split", place(3, EDGE), first=EDGE)
    tracks = build(Corrections(tracks=(split,)))
    assert len(tracks.ids) == 5
    late, early = column(tracks, 3, EDGE + 4), column(tracks, 3, EDGE - 4)
    assert not tracks.is_observed[:EDGE, late].any()
    assert not tracks.is_observed[EDGE:, early].any()
    merge = TrackEdit("merge", place(3, EDGE - 2), place(3, EDGE + 2))
    assert np.array_equal(build(Corrections(tracks=(split, merge))).xy, build().xy, equal_nan=True)


def test_a_ball_gets_the_name_and_the_class_that_were_set() -> None:
    edits = (TrackEdit("class", place(3, 5), name="eight"), TrackEdit("rename", place(2, 5), name="blue-one"))
    tracks = build(Corrections(tracks=edits))
    assert tracks.ids[column(tracks, 2, 5)] == "blue-one"
    assert tracks.kinds[column(tracks, 3, 5)] == "eight"


def test_a_class_that_was_set_renames_that_ball_alone() -> None:
    before = build()
    tracks = build(Corrections(tracks=(TrackEdit("class", place(2, 5), name="stripe"),)))
    for ball in (0, 1, 3):
        assert tracks.ids[column(tracks, ball, 5)] == before.ids[column(before, ball, 5)]
    assert tracks.ids[column(tracks, 2, 5)] not in before.ids


def test_a_class_of_which_there_is_one_ball_moves_to_the_chosen_ball() -> None:
    before = build()
    tracks = build(Corrections(tracks=(TrackEdit("class", place(3, 5), name="cue"),)))
    assert before.kinds[column(before, 0, 5)] == "cue"
    assert tracks.kinds[column(tracks, 3, 5)] == "cue"
    assert tracks.kinds[column(tracks, 0, 5)] == before.kinds[column(before, 3, 5)]


def test_a_name_that_another_ball_has_is_exchanged() -> None:
    before = build()
    wanted, old = before.ids[column(before, 0, 5)], before.ids[column(before, 3, 5)]
    tracks = build(Corrections(tracks=(TrackEdit("rename", place(3, 5), name=wanted),)))
    assert tracks.ids[column(tracks, 3, 5)] == wanted
    assert tracks.ids[column(tracks, 0, 5)] == old


def test_a_false_ball_is_gone_wholly_or_in_its_span() -> None:
    assert len(build(Corrections(balls=(BallMark("false", place(3, 5)),))).ids) == 3
    tracks = build(Corrections(balls=(BallMark("false", place(3, 5), last=EDGE - 1),)))
    assert len(tracks.ids) == 4
    assert not tracks.is_observed[:EDGE, column(tracks, 3, EDGE + 4)].any()


@pytest.mark.parametrize("ball", [1, 2, 3])
def test_a_false_split_or_merged_ball_renames_no_other(ball: int) -> None:
    before = build()
    ids = {one: before.ids[column(before, one, EDGE - 4)] for one in range(4)}
    assert {"solid-1", "solid-2", "solid-3"} < set(ids.values())  # whose numbers count from the left
    false, split = BallMark("false", place(ball, 5)), TrackEdit("split", place(ball, EDGE), first=EDGE)
    other = 1 + ball % 3
    merge = TrackEdit("merge", place(ball, 5), place(other, 5))
    for corrections, gone in (
        (Corrections(balls=(false,)), {ball}),
        (Corrections(tracks=(split,)), set()),
        (Corrections(tracks=(merge,)), {other}),
        (Corrections(balls=(false,), tracks=(TrackEdit("class", place(other, 5), name="stripe"),)), {ball, other}),
    ):
        tracks = build(corrections)
        for one in set(range(4)) - gone:
            assert tracks.ids[column(tracks, one, EDGE - 4)] == ids[one], (corrections, one)
    late = build(Corrections(tracks=(split,)))
    assert late.ids[column(late, ball, EDGE + 4)] == "solid-4"


def test_a_ball_that_was_placed_renames_no_other() -> None:
    centre = OBSERVED.detections.centre
    is_third = np.linalg.norm(centre - OBSERVED.px[OBSERVED.detections.frame, 2], axis=1) < 5
    without = OBSERVED.detections.select_rows(~is_third)
    before = build_tracks(without, OBSERVED.frame, OBSERVED.t, overhead())
    marked = MarkedDetections(OBSERVED.detections, np.where(is_third, 0, -1))
    after = build_tracks(marked, OBSERVED.frame, OBSERVED.t, overhead())
    for ball in (0, 1, 3):
        assert after.ids[column(after, ball, 5)] == before.ids[column(before, ball, 5)]
    assert after.ids[column(after, 2, 5)] == "solid-3"


@pytest.mark.parametrize("kind", ["rename", "class", "merge", "split", "swap"])
def test_an_edit_of_an_empty_place_changes_nothing(kind: str) -> None:
    empty = BallPlace(10, 5.0, 5.0)
    name = {"rename": "nine", "class": "eight"}.get(kind, "")
    other = place(2, 10) if kind in ("merge", "swap") else None
    edit = TrackEdit(kind, empty, other, name, 10 if kind == "split" else None)  # type: ignore[arg-type]
    edited, plain = build(Corrections(tracks=(edit,))), build()
    assert (edited.ids, edited.kinds) == (plain.ids, plain.kinds)
    assert np.array_equal(edited.xy, plain.xy, equal_nan=True)
