"""What a call states fits its verdict: it names what happened where it is probable, not what came last."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import synthetic_run as shot

from models.core.shot_explanation import RackBreak, ShotExplanation
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.candidate_contacts import CandidateContact
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record


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
