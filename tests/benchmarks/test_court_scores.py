"""Scores of rendered rallies: a true answer is perfect, a false one is caught, and the bound of a view behaves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.court_cases import landing_bound
from benchmarks.court_cases.court_answers import (
    Impairment,
    answer_truth,
    compare_lines,
    draw_losses,
    make_candidates,
)
from benchmarks.court_cases.court_clips import CourtCase, CourtTruth, film_case, read_truth, write_rally_clip
from benchmarks.court_cases.court_scores import find_visible, join_scores, score_answer, upper_bound
from video.rendering.court_scene import read_rally
from video.rendering.rally_clips import simulate_rallies

SIZE = (640, 360)


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> CourtTruth:
    """The end of a tennis rally, filmed in few pixels."""
    folder = tmp_path_factory.mktemp("case")
    (path,) = simulate_rallies("tennis", 5, 1, folder / "rally", strokes=(2, 2), ending="in")
    rally = read_rally(path)
    write_rally_clip(folder, rally, "broadcast", 25, 3, SIZE, span=(rally.strokes[-1][0] - 0.2, rally.t[-1]))
    return read_truth(folder)


def make_answer(truth: CourtTruth) -> dict[str, Any]:
    """Make the answer of a program that knows the truth."""
    speeds = {round(s["t"] - truth.stated["start"], 6): s["speed"] for s in truth.stated["strokes"]}
    events = [
        {**e, "t_sigma": 1e-3, "probability": 0.999, "speed": speeds.get(round(e["t"], 6), 10.0), "speed_sigma": 0.5}
        for e in truth.stated["events"]
        if not e.get("after")
    ]
    landing = next(e for e in events if e["kind"] == "landing")
    px = np.where(truth.columns["is_visible"][:, None], truth.columns["px"], np.nan)
    found = make_candidates(truth)
    return {
        "error": "", "seconds": {"court": 0.1, "wall": 1.0}, "line_error": compare_lines(truth, truth.scene.camera),
        "candidates": {"frame": found.frame.tolist(), "px": found.centre.tolist(), "score": found.score.tolist()},
        "call": {"in": 0.995, "out": 0.005, "distance": 0.05, "sigma": 0.01},
        "frame": list(range(len(px))), "px": px.tolist(), "events": events,
        "landings": [{**landing, "weight": 1.0, "covariance": (1e-4 * np.eye(3)).tolist(), "is_seen": True}],
    }  # fmt: skip


def test_touches_of_the_net_are_counted(truth: CourtTruth) -> None:
    answer = make_answer(truth)
    touch = {**answer["events"][0], "kind": "net", "t": answer["events"][0]["t"] + 0.2}
    answer["events"].append(touch)
    score = score_answer(truth, answer)
    assert (score.nets, score.nets_found, score.nets_false, score.certain_false) == (0, 0, 1, 1)
    happened = replace(truth, stated={**truth.stated, "events": [*truth.stated["events"], touch]})
    score = score_answer(happened, answer)
    assert (score.nets, score.nets_found, score.nets_false, score.certain_false) == (1, 1, 0, 0)


def test_the_truth_scores_perfectly(truth: CourtTruth) -> None:
    score = score_answer(truth, make_answer(truth))
    assert score.found == score.visible == score.candidate > 10
    assert score.events_found == score.events > 0
    assert (score.false, score.events_extra, score.certain_false, score.landings_missed) == (0, 0, 0, 0)
    assert score.landing == [0.0]
    assert score.line == [0.0]
    assert max(score.speed) == 0.0


def test_false_answers_are_caught(truth: CourtTruth) -> None:
    answer = make_answer(truth)
    answer["px"] = (np.array(answer["px"]) + 30.0).tolist()
    answer["call"] = {**answer["call"], "in": 0.0, "out": 1.0}
    answer["events"] = [{**e, "t": e["t"] - 0.2} for e in answer["events"]]
    answer["landings"] = []
    score = join_scores([score_answer(truth, answer)] * 2)
    assert score.found == 0
    assert score.false == 2 * int(truth.columns["is_visible"].sum()) >= 2 * int(find_visible(truth).sum())
    assert score.events_found == 0
    assert score.events_extra == score.events
    assert score.certain_false >= 2
    assert score.landings_missed == 2


def test_a_refused_clip_finds_nothing(truth: CourtTruth) -> None:
    score = score_answer(truth, {"error": "no court"})
    assert (score.refused, score.found, score.events_found) == (1, 0, 0)


@pytest.mark.slow  # it fits and derives three flights by differences
def test_a_longer_lens_and_less_noise_bound_the_landing_more_closely(
    truth: CourtTruth, monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = landing_bound.bound_landing(truth)
    assert wide is not None
    # in 640 px, a pixel is some centimetres of court
    assert 0.005 < np.sqrt(np.trace(wide)) < 0.5
    parameters = truth.scene.camera.parameters + np.log(2.0) * (np.arange(8) == 6)
    camera = truth.scene.camera.replace_parameters(parameters)
    closer = landing_bound.bound_landing(replace(truth, scene=replace(truth.scene, camera=camera)))
    assert closer is not None
    assert np.trace(closer) < 0.5 * np.trace(wide)
    monkeypatch.setattr(landing_bound, "NOISE_PX", 0.35)
    sharper = landing_bound.bound_landing(truth)
    assert sharper is not None
    # less than a quarter is impossible: what is known before does not change
    assert 0.24 < np.trace(sharper) / np.trace(wide) < 0.6


@pytest.mark.slow  # it simulates, films and explains a rally
def test_a_rally_is_scored_from_the_truth_without_a_clip(tmp_path: Path) -> None:
    truth = read_truth(film_case(CourtCase("tennis", 0, 5, (2, 2)), tmp_path))
    assert not (truth.folder / "clip.mp4").exists()
    score = score_answer(truth, answer_truth(truth, Impairment()))
    assert score.found == score.visible > 10
    assert score.events_found == score.events > 0
    assert score.landing[0] < 0.3
    plain, impaired = make_candidates(truth), make_candidates(truth, Impairment(missing=0.5, clutter=2.0))
    frames = len(truth.columns["t"])
    assert abs(len(impaired) - 0.5 * len(plain) - 2.0 * frames) < 6 * np.sqrt(2.0 * frames)


def test_the_upper_bound_of_none_in_400_is_below_a_percent() -> None:
    assert upper_bound(0, 400) == pytest.approx(1 - 0.05 ** (1 / 400))
    assert upper_bound(0, 0) == 1.0


def test_losses_come_in_runs_and_keep_their_share() -> None:
    rng = np.random.default_rng(0)
    for run in (0.0, 4.0):
        lost = draw_losses(40_000, Impairment(missing=0.3, run=run), rng)
        assert lost.mean() == pytest.approx(0.3, abs=0.02)
        begins = int((lost[1:] & ~lost[:-1]).sum())
        assert lost.sum() / begins == pytest.approx(run or 1 / 0.7, rel=0.05)
    for missing, run in ((0.8, 2.0), (0.3, 0.5)):
        with pytest.raises(ValueError, match="runs of"):
            Impairment(missing, run=run)
