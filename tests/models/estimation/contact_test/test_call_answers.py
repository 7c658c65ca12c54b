"""What a call states fits its verdict: it names what happened where it is probable, not what came last."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.fit_result import BallPremise, CauseHypothesis, Moment, RackBreak, ShotExplanation
from models.core.number_format import format_probability
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.shot_record import NOSE_SIGMA, CandidateContact, ShotRecord, make_shot_record
from pipeline.reporting.text.call_sentences import format_call, format_sequence


def make_record(folder: Path, explanation: ShotExplanation) -> ShotRecord:
    """A white ball that moves and a red one at rest."""
    scene, clip = shot.make_scene(), shot.write_clip(folder / "clip.mp4")
    tracks, fit = shot.make_tracks(clip, scene), shot.make_fit(clip.t)
    return make_shot_record(tracks, fit.events, fit.trajectory, scene.table, scene.camera, explanation)


@pytest.mark.parametrize(
    ("ball", "cushions", "is_yes", "met"), [(0.5, (0.95,), False, "red"), (0.9, (0.4, 0.4), True, "top")]
)
def test_what_came_first_is_of_the_kind_that_the_verdict_names(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ball: float, cushions: tuple[float, ...], is_yes: bool, met: str
) -> None:
    """A ball at 0.3 s before cushions from 0.4 s on, or after cushions from 0.1 s on."""
    ball_time = 0.3
    begin = 0.1 if is_yes else 0.4
    near = (CandidateContact(0, "red", ball_time, 1e-3, ball, -0.01, 1e-3),)
    rails = [CandidateContact(0, "top", begin + 0.1 * k, 1e-3, p, -0.01, 1e-3) for k, p in enumerate(cushions)]
    monkeypatch.setattr(call_answers, "_find_all_ball_candidates", lambda record, one: near)
    monkeypatch.setattr(call_answers, "find_cushion_candidates", lambda record, one: rails)
    monkeypatch.setattr(call_answers, "find_unexplained_changes", lambda record, one: [])
    answer = call_answers.answer_cushion_first(make_record(tmp_path, ShotExplanation()), "white")
    assert ((answer.probability >= 0.5), answer.met) == (is_yes, met)


def test_a_ball_of_a_rack_that_bursts_was_pushed_by_balls_that_no_frame_tells_apart(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rails = [CandidateContact(1, "top", 0.5, 1e-3, 0.99, -0.01, 1e-3)]
    monkeypatch.setattr(call_answers, "find_cushion_candidates", lambda record, one: rails)
    monkeypatch.setattr(call_answers, "_find_all_ball_candidates", lambda record, one: ())
    burst = ShotExplanation(breaks=(RackBreak(0.0, 0.0, 0.2, 0.3, "white", ("red",)),))
    record = make_record(tmp_path, burst)
    assert call_answers.answer_cushion_first(record, "red").verdict == "no"
    assert call_answers.answer_first_contact(record, "red").verdict == "inconclusive"


@pytest.mark.parametrize("is_own", [True, False], ids=["moment of the ball", "moment of the other ball"])
def test_a_first_contact_is_as_probable_as_the_touch_though_the_balls_meet_again(tmp_path: Path, is_own: bool) -> None:
    """The causes of one moment exclude each other: what was not that touch came first, and was unknown."""
    p = 0.998
    moments = tuple(
        Moment(
            "white" if is_own else "red", t, 1e-3, np.array([0.9, 0.5]),
            (CauseHypothesis("ball", "red" if is_own else "white", p), CauseHypothesis("unexplained", "", 1 - p)),
        )
        for t in (0.3, 0.6)
    )  # fmt: skip
    record = make_record(tmp_path, ShotExplanation(moments))
    first, touch = call_answers.answer_first_contact(record, "white"), record.explanation.moments[0].best
    assert format_probability(first.probability) == format_probability(touch.probability) == "99.8 %"
    assert dict(first.alternatives)["unknown"] == pytest.approx(1 - p, rel=0.01), "a small part was no ball"
    assert call_answers.answer_cushion_first(record, "white").probability < 0.01


def test_a_contact_of_balls_that_meet_again_names_both_times_and_the_first_contact_is_the_earlier_one(
    tmp_path: Path,
) -> None:
    """Two contacts are together surer than each, which nobody understands who reads of one."""
    moments = tuple(
        Moment("white", t, 1e-3, np.array([0.9, 0.5]), (CauseHypothesis("ball", "red", p),))
        for t, p in ((0.3, 0.99), (0.6, 0.995))
    )
    record = make_record(tmp_path, ShotExplanation(moments))
    contact = call_answers.answer_contact(record, "white", "red")
    sentence = format_call(contact, record.naming).sentence
    assert sentence.startswith("Yes (above 99.9 %): the white touched the red at 0.3000 s ± 1.0 ms, frame ")
    assert sentence.endswith("again at 0.6000 s ± 1.0 ms.")
    assert call_answers.answer_first_contact(record, "white").t == pytest.approx(0.3), "not the surer one"
    assert format_sequence(contact, record.naming) == "", "a contact is no sequence"


def test_the_distance_from_a_line_has_the_error_of_the_calibration(tmp_path: Path) -> None:
    """The line is one of the table, which the camera finds to a few mm, however exact the path is."""
    record = make_record(tmp_path, ShotExplanation())
    beyond = float(np.nanmax(record.path[:, 0, 0])) + 1e-3
    answer = call_answers.answer_line(record, "white", "x", beyond, edge=False)
    assert answer.margin_sigma > record.path_sigma[0, 0]
    assert answer.margin_sigma >= NOSE_SIGMA
    assert answer.verdict == "inconclusive"


def test_no_line_in_metres_is_decided_on_a_table_of_unknown_size(tmp_path: Path) -> None:
    record = make_record(tmp_path, ShotExplanation())
    at = float(np.nanmax(record.path[:, 0, 0])) + 0.05
    assert call_answers.answer_line(record, "white", "x", at, edge=False).verdict == "no"
    assert record.camera is not None
    guessed = replace(record, camera=replace(record.camera, scale_sigma=0.1))
    answer = call_answers.answer_line(guessed, "white", "x", at, edge=False)
    assert answer.verdict == "inconclusive"
    assert answer.margin_sigma > 0.09 * at


def test_an_unknown_cause_beside_a_probable_cushion_was_no_ball(tmp_path: Path) -> None:
    causes = CauseHypothesis("cushion", "top", 0.9), CauseHypothesis("unexplained", "", 0.1)
    record = make_record(tmp_path, ShotExplanation((Moment("white", 0.3, 1e-3, np.array([0.9, 0.5]), causes),)))
    assert call_answers.answer_first_contact(record, "white").alternatives[0][0] == "none"
    assert call_answers.answer_cushion_first(record, "white").probability > 0.99


@pytest.mark.parametrize(("speed", "verdict"), [(0.0, "no"), (0.3, "inconclusive")])
def test_a_ball_that_lies_still_was_not_touched_by_one_that_turns_for_no_known_cause(
    tmp_path: Path, speed: float, verdict: str
) -> None:
    causes = CauseHypothesis("cushion", "top", 0.88), CauseHypothesis("unexplained", "", 0.12)
    record = make_record(tmp_path, ShotExplanation((Moment("white", 0.5, 1e-3, np.array([1.3, 0.5]), causes),)))
    velocity = record.velocity.copy()
    velocity[:, 1] = [speed, 0.0]
    path = record.path.copy()
    path[:, 1] = path[:, 0] + 4 * record.table.ball_radius  # near, all the time
    record = replace(record, velocity=velocity, path=path)
    assert call_answers.answer_contact(record, "white", "red").verdict == verdict


@pytest.mark.parametrize(("premise", "verdict"), [(1.0, "no"), (0.2, "inconclusive")])
def test_no_call_is_decided_about_a_ball_whose_premises_may_fail(tmp_path: Path, premise: float, verdict: str) -> None:
    """What no frame shows to be one ball may have touched anything, crossed any line and fallen into any pocket."""
    record = make_record(tmp_path, ShotExplanation(premises={"white": BallPremise(premise)}))
    assert call_answers.answer_contact(record, "white", "red").verdict == verdict
    assert call_answers.answer_cushion_first(record, "white").verdict == verdict
    beyond = record.table.length - 1e-3
    assert call_answers.answer_line(record, "white", "x", beyond, edge=False).verdict == verdict
