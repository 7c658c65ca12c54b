"""The stress test matches balls and events, judges calls, damages detections and frames, and finds uncaused motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.stress_cases.ball_matching import BallMatch, match_balls, match_events, trace_balls, widen_bounds
from benchmarks.stress_cases.case_scores import Case, Scores, Statement, judge_call, score_case
from benchmarks.stress_cases.detection_damage import DETECTION_DAMAGES, NothingToDamage
from benchmarks.stress_cases.shot_truth import ShotTruth, TrueEvent, TruePaths, make_engine_truth
from benchmarks.stress_cases.stress_chain import Call, FittedShot, Recording, find_marks
from benchmarks.stress_cases.stress_run import run_case
from benchmarks.stress_cases.stress_table import compute_bins, find_confident_errors, format_report
from benchmarks.stress_cases.synthetic_shots import draw_synthetic_shot
from benchmarks.stress_cases.uncaused_motion import find_speed_changes
from benchmarks.stress_cases.video_damage import blur_streak, paste_ball
from benchmarks.tracking.break_shots import overhead_scene
from models.core.detections import Detections
from models.core.events import Events
from models.core.fit_result import CauseHypothesis, Fit, Moment, ShotExplanation, Trust
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory

FPS, FRAMES, R = 50.0, 40, 0.028575
CASE = Case("real", "clip", "none", 0)
Row = tuple[str, float, str, str, float]
"""Kind, frame, a, b and probability of a reported event."""


def make_events(*rows: Row, t_sigma: float = 1e-3) -> Events:
    kind, frame, a, b, p = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    count, frames = len(rows), np.array(frame, dtype=float)
    nan = np.full(count, np.nan)
    return Events(
        kind, frames / FPS, np.full(count, t_sigma), frames, a, b, np.full((count, 2), 0.5), np.array(p, dtype=float),
        nan, nan, nan,
    )  # fmt: skip


def make_shot(
    paths: Mapping[str, np.ndarray],
    events: Events | None = None,
    marks: Mapping[str, tuple[float, float]] | None = None,
) -> FittedShot:
    """Make a shot whose balls move along `paths` (T, 2) m, seen in every frame and fitted by straight pieces.

    `marks` holds the time (s) and the probability of an unexplained velocity change by ball.
    """
    scene, ids, frame = overhead_scene(pockets=True), tuple(paths), np.arange(FRAMES)
    t, xy = frame / FPS, np.stack(list(paths.values()), axis=1)
    px = scene.camera.to_pixels(xy, R)
    shape = (FRAMES, len(ids))
    noise, zeros = np.full(shape, 1e-3), np.zeros((*shape, 2))
    kinds = tuple("ball" if name == "ghost" else name.split("-")[0] for name in ids)
    tracks = Tracks(frame, t, ids, kinds, xy, px, noise, noise, zeros, np.full(shape, 14.0), np.zeros((len(ids), 3)))
    v = np.diff(xy, axis=0) * FPS
    pieces = (FRAMES - 1) * len(ids)
    position = np.zeros((pieces, 4, 2))
    position[:, 0], position[:, 1] = (part.swapaxes(0, 1).reshape(-1, 2) for part in (xy[:-1], v))
    trajectory = Trajectory(
        ids, np.repeat(np.arange(len(ids)), FRAMES - 1), np.tile(t[:-1], len(ids)), np.tile(t[1:], len(ids)), position,
        np.zeros((pieces, 2, 3)), ("roll",) * pieces, np.zeros((pieces, 4, 4)),
    )  # fmt: skip
    moments = tuple(
        Moment(ball, at, 1e-3, np.zeros(2), (CauseHypothesis("none", "", 1 - p), CauseHypothesis("unexplained", "", p)))
        for ball, (at, p) in (marks or {}).items()
    )
    moving = np.linalg.norm(np.concatenate([v, v[-1:]]), axis=2) > 0.02
    fit = Fit(
        make_events() if events is None else events, trajectory, (), 1e-3, 1.0, np.zeros((*shape, 2)), moving, moving,
        Trust("green", ()), ShotExplanation(moments),
    )  # fmt: skip
    count = FRAMES * len(ids)
    one = np.ones(count)
    detections = Detections(
        np.repeat(frame, len(ids)), px.reshape(-1, 2), 14.0 * one, np.zeros((count, 2)), np.zeros((count, 3)), one, one,
        one, one, one, one,
    )  # fmt: skip
    return FittedShot(Recording(detections, frame, t, scene), tracks, fit)


def hit_paths() -> dict[str, np.ndarray]:
    """The cue ball starts at frame 5, and touches the red ball, which then moves, at frame 20."""
    frame = np.arange(FRAMES, dtype=float)
    x = 0.4 + 0.02 * np.clip(frame - 5, 0, 15)
    red = 0.7 + 2 * R + 0.02 * np.clip(frame - 20, 0, None)
    y = np.full(FRAMES, 0.6)
    return {"cue": np.stack([x, y], axis=1), "red": np.stack([red, y], axis=1), "ghost": np.full((FRAMES, 2), 0.2)}


def hit_truth(certainty: str = "sure") -> ShotTruth:
    events = (
        TrueEvent("strike", "white", "", 5.0, 6.0, "sure", np.array([0.4, 0.6])),
        TrueEvent("ball", "white", "red", 20.0, 21.0, certainty, np.array([0.7, 0.6])),
    )
    return ShotTruth(events, first="red")


def test_bounds_are_half_a_frame_wider_or_reach_the_neighbouring_kept_frames() -> None:
    event = hit_truth().events[1]
    assert widen_bounds(event, None) == (19.5, 21.5)
    assert widen_bounds(event, np.array([15, 18, 24, 30])) == (17.5, 24.5)


def test_labelled_balls_are_matched_by_place() -> None:
    match = match_balls(hit_truth(), make_shot(hit_paths()))
    assert match.a == (frozenset({"cue"}), frozenset({"cue"}))
    assert match.b == (frozenset(), frozenset({"red"}))
    assert match.names == {"cue": "white", "red": "red"}


def test_a_ball_class_decides_between_two_near_tracks() -> None:
    paths = hit_paths()
    close = {"red": paths["cue"], "cue": paths["cue"] + [0.3 * R, 0.0]}
    assert match_balls(hit_truth(), make_shot(close)).a[0] == {"cue"}


def test_a_track_keeps_the_name_that_it_has_without_damage() -> None:
    shot, truth = make_shot(hit_paths()), hit_truth()
    tracked = trace_balls(shot, match_balls(truth, shot))
    only_red = make_shot({"red": hit_paths()["red"]})
    assert match_balls(truth, only_red).names == {"red": "white"}  # the place alone is not enough
    assert match_balls(replace(truth, tracked=tracked), only_red).names == {"red": "red"}


def test_true_paths_name_tracks_and_leave_ghosts_out() -> None:
    shot = make_shot(hit_paths())
    paths = TruePaths(np.arange(FRAMES, dtype=float), ("0", "1"), shot.tracks.xy[:, :2] + 0.5 * R)
    assert match_balls(replace(hit_truth(), paths=paths), shot).names == {"cue": "0", "red": "1"}


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (("ball", 21.4, "cue", "red", 0.99), 1),
        (("ball", 21.6, "red", "cue", 0.99), None),  # too late
        (("ball", 20.5, "cue", "ghost", 0.99), None),
        (("strike", 20.5, "cue", "", 0.99), None),
        (("ball", 21.6, "red", "cue", 0.5), 1),  # undecided, and the error of its time covers the bound
    ],
)
def test_an_event_matches_by_kind_balls_and_time(row: Row, expected: int | None) -> None:
    shot = make_shot(hit_paths())
    truth = hit_truth()
    assert match_events(make_events(row, t_sigma=0.1 / FPS), truth, match_balls(truth, shot), None, 1 / FPS, R) == [
        expected
    ]


def test_a_true_event_is_matched_once_by_the_nearest() -> None:
    shot, truth = make_shot(hit_paths()), hit_truth()
    events = make_events(("ball", 20.0, "cue", "red", 0.99), ("ball", 20.4, "cue", "red", 0.99))
    assert match_events(events, truth, match_balls(truth, shot), None, 1 / FPS, R) == [None, 1]


def judge(question: str, balls: tuple[str, ...], answer: str, truth: ShotTruth, start: float = -np.inf) -> bool | None:
    match = match_balls(truth, make_shot(hit_paths()))
    return judge_call(Call(question, balls, answer, 0.99, False), truth, match, start)[0]


def test_calls_are_judged_by_the_truth() -> None:
    truth = hit_truth()
    assert judge("first", ("cue",), "red", truth) is True
    assert judge("first", ("cue",), "none", truth) is False
    assert judge("contact", ("cue", "red"), "yes", truth) is True
    assert judge("contact", ("cue", "ghost"), "yes", truth) is False
    assert judge("cushion-first", ("cue",), "yes", truth) is False
    assert judge("pocket", ("red",), "top", truth) is False


def test_calls_that_the_labels_do_not_decide_are_skipped() -> None:
    assert judge("contact", ("cue", "red"), "yes", hit_truth("likely")) is None
    assert judge("contact", ("cue", "ghost"), "yes", replace(hit_truth(), complete=False)) is None
    assert judge("contact", ("cue", "red"), "yes", hit_truth(), start=30.0) is None
    cushion = TrueEvent("cushion", "white", "top", 20.5, 22.0, "sure", np.array([0.7, 0.6]))
    both = replace(hit_truth(), events=(*hit_truth().events, cushion))
    assert judge("cushion-first", ("cue",), "yes", both) is None


def test_scores_hold_found_events_and_statements() -> None:
    shot = make_shot(hit_paths(), make_events(("strike", 5.2, "cue", "", 0.99), ("ball", 30.0, "cue", "red", 0.99)))
    scores = score_case(CASE, shot, hit_truth())
    assert [one.found for one in scores.sought] == [True, False]
    assert [one.is_true for one in scores.statements if one.topic == "event"] == [True, False]
    span = replace(hit_truth(), spans=((28.0, 39.0),))
    assert [one.is_true for one in score_case(CASE, shot, span).statements if one.topic == "event"] == [True, None]


def test_a_start_needs_an_event_or_a_mark() -> None:
    open_start = make_shot(hit_paths())
    assert [(one.ball, one.kind, one.caused, one.marked) for one in find_speed_changes(open_start)] == [
        ("cue", "starts", False, False),
        ("red", "starts", False, False),
    ]
    events = make_events(("strike", 5.2, "cue", "", 0.99), ("ball", 20.3, "cue", "red", 0.05))
    changes = find_speed_changes(make_shot(hit_paths(), events, {"red": (0.41, 0.6)}))
    assert [(one.ball, one.caused, one.marked) for one in changes] == [("cue", True, False), ("red", False, True)]


def test_marks_are_unexplained_changes_of_a_listed_probability() -> None:
    shot = make_shot(hit_paths(), marks={"red": (0.41, 0.6), "cue": (0.2, 0.05)})
    assert find_marks(shot.fit) == [("red", 0.41)]


def damage(name: str, seed: int = 0) -> tuple[FittedShot, Recording, np.ndarray | None]:
    shot, truth = make_shot(hit_paths()), hit_truth()
    part = DETECTION_DAMAGES[name](shot, truth, match_balls(truth, shot), np.random.default_rng(seed))
    return shot, part.recording, part.kept


def test_every_second_frame_is_removed_and_keeps_its_number() -> None:
    _, recording, kept = damage("second-frames")
    assert kept is not None
    assert np.all(np.diff(kept) == 2)
    assert np.array_equal(recording.frame, kept)
    assert set(recording.detections.frame.tolist()) == set(kept.tolist())
    assert np.allclose(recording.t, kept / FPS)


def test_detections_about_a_contact_are_removed_from_its_balls_only() -> None:
    shot, recording, kept = damage("contacts")
    assert kept is None
    gone = set(shot.recording.detections.frame.tolist()) - set(recording.detections.frame.tolist())
    assert not gone  # the ghost is still seen in every frame
    counts = np.bincount(recording.detections.frame)
    assert np.flatnonzero(counts == 1).tolist() == [20, 21]
    assert set(counts.tolist()) == {1, 3}


def test_one_moving_ball_loses_runs_of_three_frames() -> None:
    shot, recording, _ = damage("ball-gaps")
    lost = np.flatnonzero(np.bincount(recording.detections.frame, minlength=FRAMES) == 2)
    assert 3 <= len(lost) <= 9
    assert len(shot.recording.detections) - len(recording.detections) == len(lost)


def test_false_detections_are_a_twentieth_and_sorted() -> None:
    shot, recording, _ = damage("false-balls")
    assert len(recording.detections) == len(shot.recording.detections) + 6
    xy = recording.scene.camera.to_table(recording.detections.centre, R)
    assert xy.min() >= R - 1e-9
    assert np.all(xy.max(axis=0) <= [2.54 - R, 1.27 - R])


def test_a_late_start_comes_after_the_strike_and_starts_at_time_zero() -> None:
    firsts = {int(damage("late-start", seed)[1].frame[0]) for seed in range(30)}
    assert min(firsts) == 6
    assert max(firsts) in (21, 22)
    assert damage("late-start")[1].t[0] == 0.0


def test_without_balls_near_pockets_there_is_nothing_to_damage() -> None:
    with pytest.raises(NothingToDamage):
        damage("pockets")


def test_soft_simulated_contacts_are_not_sure_and_rests_come_from_the_paths() -> None:
    frame = np.arange(60, dtype=float)
    x = 0.5 + 0.01 * np.minimum(frame, 20)
    paths = TruePaths(frame, ("0",), np.stack([x, np.full(60, 0.6)], axis=1)[:, None])
    rows = [
        {"kind": kind, "t": t, "a": "0", "b": b, "x": 0.5, "y": 0.6, "speed": speed}
        for kind, t, b, speed in (
            ("strike", 0.0, "", 0.5),
            ("cushion", 0.1, "top", 0.01),
            ("cushion", 0.2, "top", 0.03),
            ("cushion", 0.3, "top", 0.5),
            ("cushion", 1.17, "top", 0.5),
        )
    ]
    truth = make_engine_truth(rows, frame / FPS, paths, R)
    assert [e.certainty for e in truth.events if e.kind == "cushion"] == ["unsure", "likely", "sure", "likely"]
    (rest,) = (event for event in truth.events if event.kind == "rest")
    assert rest.lo <= 20 <= rest.hi
    assert truth.first == "none"


def test_a_ball_that_is_hit_again_has_rested_before() -> None:
    frame = np.arange(60, dtype=float)
    x = 0.5 + 0.01 * (np.minimum(frame, 20) + np.clip(frame - 40, 0, 10))
    paths = TruePaths(frame, ("0",), np.stack([x, np.full(60, 0.6)], axis=1)[:, None])
    rows = [{"kind": "strike", "t": 0.0, "a": "0", "b": "", "x": 0.5, "y": 0.6, "speed": 0.5}]
    rests = [event for event in make_engine_truth(rows, frame / FPS, paths, R).events if event.kind == "rest"]
    assert [(one.lo <= t <= one.hi) for one, t in zip(rests, (20, 50), strict=True)] == [True, True]


def statement(probability: float, is_true: bool | None) -> Statement:
    return Statement(CASE, "event", "x", probability, False, is_true, "")


def test_confident_errors_are_false_at_99_percent_or_true_at_1_percent() -> None:
    rows = [statement(p, truth) for p in (0.995, 0.9, 0.005) for truth in (True, False, None)]
    assert find_confident_errors(rows) == [rows[1], rows[6]]


def test_bins_compare_stated_with_observed() -> None:
    rows = [*[statement(0.75, True)] * 3, statement(0.75, False), statement(0.72, None), statement(1.0, True)]
    (stated, observed, n, sd), last = compute_bins(rows)
    assert (stated, observed, n) == (0.75, 0.75, 4)
    assert sd == pytest.approx(np.sqrt(0.75 * 0.25 / 4))
    assert last[2] == 1
    report = format_report(Scores([CASE], rows))
    assert "| statements at >= 0.99 (or <= 0.01) that are false | 0/1 = 0.0 % | - | - |" in report


def test_a_streak_is_blurred_along_itself() -> None:
    image = np.zeros((60, 100, 3), np.float32)
    image[28:33, 45:56] = 200.0
    blurred = blur_streak(image, np.array([50.0, 30.0]), np.array([12.0, 0.0]), 6.0)
    assert blurred[30, 41, 0] > 20.0  # longer along the streak
    assert blurred[24, 50, 0] < 5.0  # not across it
    assert blurred.sum() == pytest.approx(image.sum(), rel=0.02)


def test_a_ball_is_copied_to_its_new_place_and_size() -> None:
    y, x = np.mgrid[:80, :120]
    source = np.zeros((80, 120, 3), np.uint8)
    source[np.hypot(x - 30, y - 40) <= 8] = 250
    copy = paste_ball(np.full_like(source, 90), source, np.array([30.0, 40.0]), np.array([90.0, 30.0]), 1.5, 8.0)
    assert copy[30, 90, 0] == 250
    assert copy[30, 100, 0] == 250
    assert copy[30, 106, 0] == 90
    assert copy[40, 30, 0] == 90


def test_simulated_shots_depend_on_seed_and_number_only() -> None:
    assert draw_synthetic_shot(3, 2) == draw_synthetic_shot(3, 2)
    assert draw_synthetic_shot(3, 2).content["balls"] != draw_synthetic_shot(4, 2).content["balls"]
    assert {draw_synthetic_shot(0, number).kind for number in range(4)} == {"carom", "open", "pool", "power"}


def test_an_unmatched_track_has_no_ids() -> None:
    assert BallMatch((), (), {"red": "red R1", "red-2": "red R1"}).ids_of("red R1") == {"red", "red-2"}
    assert not BallMatch((), (), {}).ids_of("red R1")


def test_a_bend_that_friction_explains_needs_no_cause() -> None:
    frame = np.arange(FRAMES, dtype=float)
    for turn_frames, expected in ((15.0, []), (1.0, ["turns"])):  # 60 degrees at 0.5 m/s
        angle = np.radians(60) * np.clip((frame - 15) / turn_frames, 0, 1)
        steps = 0.5 / FPS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        changes = find_speed_changes(make_shot({"cue": 0.3 + np.cumsum(steps, axis=0)}))
        assert [one.kind for one in changes] == expected


def test_a_case_that_raises_becomes_a_row() -> None:
    def fail() -> Scores:
        raise ZeroDivisionError("by zero")

    def skip() -> Scores:
        raise NothingToDamage("no pockets")

    crashed, skipped = run_case(CASE, fail), run_case(CASE, skip)
    assert [one.text.split(" (")[0] for one in crashed.crashes] == ["ZeroDivisionError: by zero"]
    assert crashed.cases == [CASE]
    assert (skipped.skipped, skipped.cases, skipped.crashes) == (["clip, none: no pockets"], [], [])
