"""Strengths that differ between bodies: found, fitted under a common prior, and used for predictions."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.reference_frames import LINE, PLANE

from diagnosis.diagnose import diagnose
from diagnosis.fitting.body_strengths import estimate_common_prior, split_bodies
from diagnosis.fitting.diagnosis_windows import fit_initial_windows
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.recording import Recording
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.gap_scene import neutral_values
from pipeline.io.gap_files import build_gap_document
from pipeline.reporting.text.gap_sentences import format_body_differences

NOISE = 0.003
"""m"""
FLIGHT = build_flight_scene(2)
DRAG = [f"{e.name}.{p.name}" for e in FLIGHT.effects for p in e.parameters].index("air_drag.k")
ROWS = 24
"""rows, at 30 frames per second"""
DRAGS = {"a": 0.10, "b": 0.20, "c": 0.32}
"""1/m, of each body."""
MEASURED = Path(__file__).resolve().parents[4] / "shared" / "data" / "physics" / "falling_balls" / "ball_drops.csv"


def throw(shot: int, drags: dict[str, float], rng: np.random.Generator) -> Recording:
    """Simulate one throw of bodies that fly at the same time, each with a drag of its own."""
    t, paths = np.arange(ROWS) / 30, []
    for drag in drags.values():
        shared = neutral_values(FLIGHT)
        shared[DRAG] = drag
        speed, angle = rng.uniform(6, 12), np.radians(rng.uniform(35, 80))
        blank = Recording(shot, np.arange(ROWS), t, ("x",), np.zeros((ROWS, 1, 2)), np.full((ROWS, 1), NOISE), PLANE)
        start = np.array([0, 1, speed * np.cos(angle), speed * np.sin(angle)])
        paths.append(FLIGHT.predict_positions(blank, start, shared, ()))
    path = np.concatenate(paths, axis=1)
    path += NOISE * rng.standard_normal(path.shape)
    return Recording(shot, np.arange(ROWS), t, tuple(drags), path, np.full(path.shape[:2], NOISE), PLANE)


@pytest.fixture(scope="module")
def report() -> DiagnosisReport:
    """Diagnose ten throws of three bodies, one at a time, or two in every fourth throw."""
    rng, names = np.random.default_rng(3), list(DRAGS)
    throws = []
    for shot in range(10):
        flying = {names[shot % 3], names[(shot + 1) % 3]} if shot % 4 == 0 else {names[shot % 3]}
        throws.append(throw(shot, {name: DRAGS[name] for name in sorted(flying)}, rng))
    return diagnose(FLIGHT, tuple(throws))


def test_each_body_has_its_own_drag(report: DiagnosisReport) -> None:
    assert report.effects == ("air_drag",)
    first = report.candidates[0]
    assert [one.body for one in first.per_body] == list(DRAGS)
    for one in first.per_body:
        assert one.strengths[0].name == "k"
        assert abs(one.strengths[0].value - DRAGS[one.body]) < 4 * one.strengths[0].sigma < 0.03
    assert first.strengths[0].body_spread == pytest.approx(np.std(list(DRAGS.values()), ddof=1), rel=0.3)
    assert first.strengths[0].shot_spread == 0.0, "the shots of one body have the same drag"


def test_predictions_use_the_drag_of_each_body(report: DiagnosisReport) -> None:
    closure = report.gap.closure
    assert closure.resolved
    assert closure.after < 1.15 * closure.floor
    assert all(len(one.segment.bodies) == 1 for one in report.gap.windows)


def test_files_and_page_state_the_drag_of_each_body(report: DiagnosisReport) -> None:
    candidate = build_gap_document(report)["candidates"][0]
    assert [one["body"] for one in candidate["per_body"]] == list(DRAGS)
    assert candidate["per_body"][0]["parameters"]["k"]["unit"] == "1/m"
    assert sum(one["shots"] for one in candidate["per_body"]) >= 7
    (sentence,) = format_body_differences(report)
    assert "differs between bodies, k in 1/m: a 0." in sentence


def test_bodies_of_one_drag_share_it() -> None:
    rng = np.random.default_rng(5)
    same = diagnose(FLIGHT, tuple(throw(shot, {"abc"[shot % 3]: 0.2}, rng) for shot in range(12)))
    assert same.effects == ("air_drag",)
    assert same.candidates[0].per_body == ()
    assert same.candidates[0].strengths[0].body_spread == 0.0
    assert format_body_differences(same) == ()


def test_shots_that_differ_do_not_make_bodies_differ() -> None:
    rng = np.random.default_rng(6)
    drags = rng.uniform(0.16, 0.24, 16)
    mixed = diagnose(FLIGHT, tuple(throw(shot, {"ab"[shot % 2]: k}, rng) for shot, k in enumerate(drags)))
    assert mixed.candidates[0].effect == "air_drag"
    assert mixed.candidates[0].per_body == ()
    assert mixed.candidates[0].strengths[0].shot_spread > 0.01


def test_a_smooth_path_is_fitted_as_well_without_measures_against_jumps() -> None:
    """Throws of unlike drag, which a step of the common drag makes better or worse: all that contacts would need."""
    rng = np.random.default_rng(7)
    throws = tuple(throw(shot, {body: drag}, rng) for shot, (body, drag) in enumerate(DRAGS.items()))
    jumpy = replace(FLIGHT, is_smooth=False)
    smooth, careful = (
        fit_initial_windows(build_diagnosis_problem(scene, WHITE_NOISE), throws, ("air_drag",))
        for scene in (FLIGHT, jumpy)
    )
    assert smooth.cost == pytest.approx(careful.cost, rel=1e-4)
    np.testing.assert_allclose(smooth.shared, careful.shared, rtol=1e-3)


def test_each_body_keeps_the_inputs_that_act_on_it() -> None:
    still, inputs = np.zeros((5, 2, 2)), np.arange(5 * 2 * 2 * 2, dtype=float).reshape(5, 2, 2, 2)
    both = Recording(0, np.arange(5), np.arange(5) / 60, ("a", "b"), still, np.ones((5, 2)), PLANE, inputs=inputs)
    parts = split_bodies((both,))
    assert [one.bodies for one in parts] == [("a",), ("b",)]
    for body, one in enumerate(parts):
        assert one.inputs is not None
        np.testing.assert_array_equal(one.inputs[:, 0], inputs[:, body])


def test_the_common_prior_has_the_mean_and_width_of_the_bodies() -> None:
    rng = np.random.default_rng(2)
    values = 0.3 + 0.05 * rng.standard_normal(400) + 0.01 * rng.standard_normal(400)
    mean, width = estimate_common_prior(values, np.full(400, 0.01))
    assert mean == pytest.approx(0.3, abs=0.01)
    assert width == pytest.approx(0.05, rel=0.1)
    assert estimate_common_prior(0.3 + 0.01 * rng.standard_normal(400), np.full(400, 0.01))[1] == 0.0


@pytest.mark.slow
@pytest.mark.skipif(not MEASURED.is_file(), reason="the measured drops of balls are not on this machine")
def test_measured_balls_have_drags_of_their_own() -> None:
    """Drops of whiffle balls, tennis balls and bowling balls: the light ones are braked more."""
    with MEASURED.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if re.search("whiffle|tennis|bowling", row["ball"].lower())]
    shots = sorted({(row["drop"], row["ball"]) for row in rows}, key=lambda one: (one[1], one[0]))
    recordings = []
    for shot, (drop, ball) in enumerate(shots):
        own = [(float(row["t"]), float(row["h"])) for row in rows if (row["drop"], row["ball"]) == (drop, ball)]
        t, height = np.array(sorted(dict(own).items())).T
        error = np.full((len(t), 1), 0.03)
        recordings.append(
            Recording(shot, np.arange(len(t)), t, (ball,), height[:, None, None], error, LINE, is_sigma_stated=False)
        )
    # order the shots so that each ball has fitting and hold-out shots: first all first drops, then all second ones
    ordered = tuple(replace(one, shot=k) for k, one in enumerate((*recordings[::2], *recordings[1::2])))
    measured = diagnose(build_flight_scene(1), ordered)
    drag = next(one for one in measured.candidates if one.effect in ("air_drag", "viscous_drag") and one.per_body)
    strengths = {one.body.lower(): one.strengths[0].value for one in drag.per_body}
    heavy = [value for name, value in strengths.items() if "bowling" in name]
    light = [value for name, value in strengths.items() if "whiffle" in name]
    assert max(heavy) < min(light)
