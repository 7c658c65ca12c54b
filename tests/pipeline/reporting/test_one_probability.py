"""The same event has the same probability in table, story, calls, editor, video and recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.array_columns import concatenate_rows
from models.core.events import Events
from models.core.fit_result import CauseHypothesis, Fit, Moment, ShotExplanation
from models.core.naming import build_naming
from models.estimation.contact_test.call_answers import answer_contact
from models.estimation.contact_test.shot_record import make_shot_record
from pipeline.editing.run_view import ClipRun, describe_run
from pipeline.reporting.pages.run_report import ReportFiles, answer_standard_questions, build_event_rows
from pipeline.reporting.recording.stage_layers import format_mark
from pipeline.reporting.text.call_sentences import format_call
from pipeline.reporting.text.check_list import select_check_places
from pipeline.reporting.text.check_sentences import format_check_place
from pipeline.reporting.text.shot_summary import summarize_shots
from video.overlay.motion_paths import select_contact_marks

T = 0.7
"""s of the contact of white and red."""


def make_fit(t: np.ndarray, probability: float) -> Fit:
    """The fit of `make_unsure_fit`, and a contact of white and red."""
    unsure = shot.make_unsure_fit(t)
    nan = np.array([np.nan])
    touch = Events(
        ("ball",), np.array([T]), np.array([0.001]), np.array([21.0]), ("white",), ("red",), np.array([[0.9, 0.5]]),
        np.array([probability]), nan, nan, np.array([0.8]),
    )  # fmt: skip
    causes = CauseHypothesis("ball", "red", probability), CauseHypothesis("none", "", 1 - probability)
    moment = Moment("white", T, 0.001, np.array([0.9, 0.5]), causes)
    moments = (*unsure.explanation.moments[:-1], moment)
    events = concatenate_rows([unsure.events, touch], np.arange(3))
    return replace(unsure, events=events, explanation=ShotExplanation(moments))


@pytest.mark.parametrize(("probability", "text"), [(0.9973, "99.7 %"), (0.898, "90 %"), (0.99949, "above 99.9 %")])
def test_all_outputs_state_one_probability_of_an_event(tmp_path: Path, probability: float, text: str) -> None:
    clip, scene = shot.write_clip(tmp_path / "shot.mp4"), shot.make_scene()
    tracks = shot.make_tracks(clip, scene)
    naming = build_naming(scene.table, scene.camera, tracks.ids, tracks.looks)
    fit = replace(make_fit(tracks.t, probability), naming=naming)
    record = make_shot_record(tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)
    calls = answer_standard_questions(record)
    (summary,) = summarize_shots(tracks, fit, scene.table, calls=calls)
    first = next(format_call(call, naming) for call in calls if call.kind == "first")
    touched = format_call(answer_contact(record, "white", "red"), naming)
    view = describe_run(ClipRun(float(clip.fps), scene, tracks, fit), None)
    rows = build_event_rows(fit, ReportFiles("slow.mp4", tmp_path, 8.0))

    assert [rows[2]["probability"], view["events"][2]["share"]] == [text, text]
    assert touched.probability.endswith(text)
    assert f"The red first: {first.probability.removeprefix('red: ')}." in summary.confidence

    places = [format_check_place(one, naming) for one in select_check_places(tracks, fit, scene.table)]
    timeline = SimpleNamespace(scene=scene, state_at=fit.trajectory.at)
    labels = [mark.label.value for mark in select_contact_marks(timeline, fit)]  # type: ignore[arg-type]
    cushion = [
        rows[1]["probability"], view["events"][1]["share"], format_mark(fit, 1), places[0],
        labels[1],
    ]  # fmt: skip
    assert [("61 %" in str(one)) for one in cushion] == [True] * len(cushion), cushion
