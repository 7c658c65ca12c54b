"""Corrections of a rally by hand are taken as given, and what fits no flight is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simple_rallies import TrueRally, frames_of, observe_rally, play_rally, usual_view
from support.staged_rally import FPS, stage_rally

from models.core.corrections import BallMark, BallMarkKind, BallPlace, Corrections, RallyCorrection
from models.core.court_camera import CourtScene
from models.core.progress import ignore_progress
from models.core.rally import BallCandidates, Rally
from models.estimation.rally.explain_rally import explain_rally
from models.estimation.rally.flight_observations import MARK_EVIDENCE, EventMark, weigh_marks
from models.estimation.rally.rally_marks import (
    choose_placed,
    correct_candidates,
    resolve_marks,
    resolve_places,
    settle_marks,
)
from models.sports.sport_catalogue import find_sports


def play_tennis(hidden_s: float = 0.0) -> tuple[CourtScene, TrueRally, BallCandidates]:
    """Play three strokes; the ball is hidden from some time before the bounce after the last one."""
    sport, rng = find_sports()["tennis"], np.random.default_rng(105)
    scene, rally = usual_view(sport), play_rally(sport, 3, rng)
    if hidden_s:
        rally.xyz[rally.frame_t > rally.t[5] - hidden_s] = np.nan
    return scene, rally, observe_rally(scene, rally, rng)


def explain(scene: CourtScene, rally: TrueRally, seen: BallCandidates, corrections: Corrections) -> Rally:
    return explain_rally(scene, seen, frames_of(rally), rally.frame_t, ignore_progress, corrections)


def times_of(rally: Rally, kind: str) -> list[float]:
    """Return the times of events in frames."""
    return [FPS * one.t for one in rally.events if one.kind == kind]


def test_a_bounce_becomes_a_hit_where_a_person_says_so_and_the_other_events_stay() -> None:
    scene, rally, seen = play_tennis()
    bounce = FPS * rally.t[3]
    both = RallyCorrection("delete", "bounce", bounce), RallyCorrection("mark", "hit", bounce)
    explained = explain(scene, rally, seen, Corrections(events=both))
    volley = min((one for one in explained.events if one.kind == "hit"), key=lambda one: abs(FPS * one.t - bounce))
    assert FPS * volley.t == pytest.approx(bounce, abs=0.5)
    assert volley.probability > 0.99
    assert min(abs(t - bounce) for t in times_of(explained, "bounce")) > 20
    assert times_of(explained, "hit")[-1] == pytest.approx(FPS * rally.t[4], abs=0.5)
    assert explained.notes == ()


def test_a_landing_that_was_hidden_is_where_a_person_saw_its_time() -> None:
    scene, rally, seen = play_tennis(hidden_s=0.2)
    alone = explain(scene, rally, seen, Corrections())
    mark = RallyCorrection("mark", "bounce", round(FPS * rally.t[5]))
    told = explain(scene, rally, seen, Corrections(events=(mark,)))
    assert not alone.landings[0].is_seen
    assert told.landings[0].is_seen
    assert told.landings[0].t_sigma < 0.7 * alone.landings[0].t_sigma
    assert told.no_landing < 0.01 < alone.no_landing
    off = told.landings[0].place[:2] - rally.place[5][:2]
    assert off @ np.linalg.solve(told.landings[0].covariance[:2, :2], off) < 9


def test_a_time_that_the_flights_contradict_stays_and_is_said() -> None:
    scene, rally, seen = play_tennis()
    hit = FPS * rally.t[4]
    moved = explain(scene, rally, seen, Corrections(events=(RallyCorrection("move", "hit", hit, hit + 2),)))
    assert times_of(moved, "hit")[-1] == pytest.approx(hit, abs=0.5)
    (note,) = moved.notes
    assert note.startswith("hit-set-by-hand-at-3.32-s-flies-as-if-at-3.2")


def test_a_mark_that_no_flight_allows_is_said_and_costs_nothing_else() -> None:
    scene, rally, seen = play_tennis()
    mark = RallyCorrection("mark", "landing", FPS * rally.t[4] + 8)  # a ball bounces, and flies on
    marked = explain(scene, rally, seen, Corrections(events=(mark,)))
    assert marked.notes == ("landing-set-by-hand-at-3.56-s-fits-no-flight",)
    plain = explain(scene, rally, seen, Corrections())
    assert [one.kind for one in marked.events] == [one.kind for one in plain.events]


@pytest.mark.parametrize(("off_px", "fits"), [(0.0, True), (60.0, False)])
def test_a_placed_object_is_the_only_candidate_of_its_frame(off_px: float, fits: bool) -> None:
    scene, rally, seen = play_tennis()
    row = int(FPS * rally.t[4]) + 9
    stays = np.abs(seen.frame - row) > 1
    names = ("frame", "centre", "streak", "score", "sigma", "sigma_along")
    seen = replace(seen, **{name: getattr(seen, name)[stays] for name in names})
    px = scene.camera.to_pixels(rally.xyz)[row] + off_px
    explained = explain(scene, rally, seen, Corrections(balls=(BallMark("placed", BallPlace(row, *px.tolist())),)))
    assert explained.px[row] == pytest.approx(px)
    assert explained.is_used[row] == fits
    assert explained.notes == (() if fits else (f"place-set-by-hand-in-frame-{row}-fits-no-flight",))


def test_what_is_no_object_is_left_out_for_its_span_alone() -> None:
    candidates = BallCandidates(
        np.array([3, 4, 4, 5, 9]), np.array([[50, 60], [52, 61], [90, 60], [51, 59], [50, 60.0]]), np.zeros((5, 2)),
        np.full(5, 0.5), np.full(5, 0.7), np.full(5, 0.7),
    )  # fmt: skip
    left = correct_candidates(candidates, (BallMark("false", BallPlace(4, 50, 60), 4, 6),))
    assert left.frame.tolist() == [3, 4, 9]
    assert left.centre[1].tolist() == [90, 60]
    assert len(correct_candidates(candidates, (BallMark("false", BallPlace(4, 50, 60)),))) == 1


def test_deleted_events_and_landings_go_and_marked_ones_are_as_good_as_sure() -> None:
    rally = stage_rally(find_sports()["badminton"], (13.0, 3.0), no_landing=0.3)
    landing = FPS * rally.events[1].t
    marks = resolve_marks((RallyCorrection("mark", "landing", landing),), rally.frame, rally.t)
    sure = settle_marks(rally, (), marks)
    assert sure.events[1].probability == pytest.approx(700 / 700.3)
    assert sure.no_landing == pytest.approx(0.3 / 700.3)
    marks = resolve_marks((RallyCorrection("delete", "landing", landing),), rally.frame, rally.t)
    gone = settle_marks(rally, (), marks)
    assert [one.kind for one in gone.events] == ["hit"]
    assert gone.landings[0].weight == pytest.approx(0.7 / 1000 / (0.3 + 0.7 / 1000))


def test_a_marked_hit_begins_the_flight_that_is_seen_later() -> None:
    rally = stage_rally(find_sports()["badminton"], (13.0, 3.0))
    hit = rally.events[0]
    unseen = replace(rally, events=rally.events[1:])
    marks = resolve_marks((RallyCorrection("mark", "hit", FPS * hit.t),), rally.frame, rally.t)
    begun = settle_marks(unseen, (), marks).events[0]
    assert (begun.kind, begun.player) == ("hit", "near")
    assert begun.t == pytest.approx(hit.t)
    assert begun.place == pytest.approx(hit.place)
    assert begun.speed == pytest.approx(hit.speed)


def test_events_are_weighed_once_per_mark_and_a_moved_one_is_not_denied() -> None:
    there, gone = EventMark("hit", 1.04, 0.02, 0.1, True), EventMark("hit", 1.0, 0.02, 0.1, False)
    assert weigh_marks((there,), ("hit", "hit"), np.array([1.0, 1.1])) == MARK_EVIDENCE
    assert weigh_marks((gone,), ("hit", "bounce"), np.array([1.0, 1.0])) == -MARK_EVIDENCE
    assert weigh_marks((there, gone), ("hit",), np.array([1.05])) == MARK_EVIDENCE
    assert weigh_marks((there, gone), ("bounce",), np.array([1.05])) == 0


def test_what_is_marked_outside_of_the_clip_is_no_event_of_its_last_frame() -> None:
    frame, t = np.array([0, 1, 2, 4]), np.array([0.0, 0.1, 0.2, 0.4])
    marks = [RallyCorrection("move", "hit", 3, 9), RallyCorrection("delete", "bounce", 2.5)]
    assert [round(one.t, 6) for one in resolve_marks(marks, frame, t)] == [0.3, 0.9, 0.25]
    (early,) = resolve_marks([RallyCorrection("mark", "hit", 5)], frame + 10, t)
    assert early.t == pytest.approx(-0.5)
    scene, rally, seen = play_tennis()
    plain = explain(scene, rally, seen, Corrections())
    far = explain(scene, rally, seen, Corrections(events=(RallyCorrection("mark", "bounce", 9000),)))
    assert far.notes == ("bounce-set-by-hand-at-360.00-s-fits-no-flight",)
    assert [(one.kind, one.t) for one in far.events] == [(one.kind, one.t) for one in plain.events]


@pytest.mark.filterwarnings("error")
def test_a_clip_of_one_frame_has_no_marked_moment() -> None:
    assert resolve_marks([RallyCorrection("mark", "hit", 0)], np.zeros(1, np.int64), np.zeros(1)) == ()


def test_a_place_in_a_duplicate_frame_is_one_in_the_frame_that_it_shows_again() -> None:
    marks = [BallMark("placed", BallPlace(frame, 3.0, 4.0)) for frame in (2, 5, 9)]
    frames = [one.ball.frame for one in resolve_places(marks, np.array([1, 3, 4, 6]))]
    assert frames == [1, 4, 9]  # after the last one, no frame is known


@pytest.mark.parametrize(
    ("kinds", "left"),
    [
        (("placed", "placed"), [2]),
        (("placed", "false"), []),
        (("false", "placed"), [2]),
        (("placed", "false", "placed"), [3]),
    ],
    ids=("again", "none", "after all", "and again"),
)
def test_the_last_correction_of_a_place_counts(kinds: tuple[BallMarkKind, ...], left: list[int]) -> None:
    """Each mark lies one pixel beside the one before; the tracked candidate is within reach of all."""
    frame = np.arange(9)
    marks = [BallMark(kind, BallPlace(4, 50.0 + k + 1, 60.0)) for k, kind in enumerate(kinds)]
    candidates = BallCandidates(
        np.array([4, 6]), np.array([[50, 60], [90, 60.0]]), np.zeros((2, 2)), *np.full((3, 2), 0.5)
    )
    places = resolve_places(marks, frame)
    corrected = correct_candidates(candidates, places)
    assert (corrected.centre[corrected.frame == 4, 0] - 50).tolist() == left
    chosen = choose_placed(np.array([-1] * 6 + [len(corrected) - 1, -1, -1]), corrected, frame, places)
    assert chosen[4] == (0 if left else -1)
    assert chosen[6] == len(corrected) - 1


def test_a_place_beside_or_outside_of_the_span_of_what_is_none_stays() -> None:
    placed = BallMark("placed", BallPlace(4, 50, 60))
    for none in (BallMark("false", BallPlace(4, 59, 60)), BallMark("false", BallPlace(7, 50, 60), 5, 8)):
        assert resolve_places([placed, none], np.arange(9)) == (placed, none)
