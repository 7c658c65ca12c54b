"""`trueroll reproduce`: scenes, cached trials, sentences on the results, and output files."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.neural.common.method_interface import (
    CUBIC,
    CURVES,
    HOLDOUT_PATIENCE,
    LINEAR,
    EarlyStopping,
    FittedMotion,
    MotionMethod,
    TrainingBudget,
)
from pipeline.cli.execute import execute_command_line
from pipeline.engine.result_cache import ResultCache
from pipeline.experiments.thesis.compared_methods import (
    PHYSICS_NAME,
    PRETRAINED_NET,
    REPRESENTATIVES,
    SLOW_NETS,
    SPLINES,
    THESIS_NET,
    THESIS_NETS,
    build_methods,
    describe_extra_inputs,
    is_network,
)
from pipeline.experiments.thesis.experiment_plan import (
    BASE_SETTING,
    FIRST_VARIANT,
    Depth,
    ExperimentPlan,
    describe_training,
    explain_omissions,
    find_method,
    list_cases,
    list_tasks,
)
from pipeline.experiments.thesis.pool_scene import build_pool_series, list_shots
from pipeline.experiments.thesis.thesis_results import (
    build_learning_table,
    build_tables,
    describe_scene_results,
    summarize_settings,
)
from pipeline.experiments.thesis.thesis_scenes import (
    GRAVITY,
    LENGTH,
    RECORDING,
    ExperimentCase,
    WithheldSeries,
    body_indices,
    build_series,
    convert_to_angles,
    convert_to_points,
    find_recording,
    simulate_double_pendulum,
    simulate_training_swings,
)
from pipeline.experiments.thesis.trials import MAX_ERROR_PX, Trial, run_trial

CASE = ExperimentCase("double-pendulum", "soft", 30.0, 0.1, 0)


def make_series(frames: int = 21) -> WithheldSeries:
    """Build a series of a particle on a parabola."""
    t = np.arange(frames) / 30
    return build_series(CASE, t, np.stack([t, 300 * t**2], axis=1)[:, None] * 100)


@dataclass(frozen=True)
class CountingMethod:
    """A method that records the seed of every fit."""

    motion: Callable[[FloatArray], FloatArray]
    name: str = "counted"
    seeds: list[int] = field(default_factory=list)

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> FittedMotion:
        self.seeds.append(seed)
        return FittedMotion(self.motion, np.arange(3.0), 7, 0.5)


def test_half_of_the_frames_are_withheld_and_noise_is_as_told() -> None:
    t = np.arange(1000) / 30
    series = build_series(ExperimentCase("pool", "shot 0", 30.0, 0.5, 4), t, np.zeros((1000, 5, 2)))
    assert len(series.t) == 999
    assert not set(series.visible_samples[0]) & set(series.withheld_samples[0])
    assert series.visible_samples[1].std() == pytest.approx(0.5, rel=0.05)
    assert not series.withheld_samples[1].any()


def test_stiff_springs_are_a_double_pendulum_that_loses_no_height_in_a_short_swing() -> None:
    t = np.linspace(0, 0.5, 201)
    path = simulate_double_pendulum("stiff", tuple(t))
    arms = np.linalg.norm(np.diff(path, axis=1), axis=2)
    assert np.abs(arms - LENGTH).max() < 0.5
    speed = np.gradient(path, t, axis=0)[1:-1, 1:]
    gained = 0.5 * (speed**2).sum(axis=(1, 2)) - GRAVITY * (path[1:-1, 1:, 1] - path[0, 1:, 1]).sum(axis=1)
    assert np.abs(gained).max() < 0.01 * GRAVITY * LENGTH


def test_points_and_angles_of_a_pendulum_are_the_same_thing() -> None:
    angles = np.array([[0.1, -2.0], [3.0, 1.0], [3.5, 1.5]])
    assert convert_to_angles(convert_to_points(angles)) == pytest.approx(angles)


def test_a_trial_is_worked_out_once(tmp_path: Path) -> None:
    series, cache = make_series(), ResultCache(tmp_path)
    method = CountingMethod(lambda t: np.stack([t, 300 * t**2], axis=1)[:, None] * 100 + 1.0)
    first, second = (run_trial(method, series, TrainingBudget(), cache) for _ in range(2))
    assert method.seeds == [0]
    assert first.mse == second.mse == pytest.approx(1.0)
    assert first.row == second.row
    assert np.array_equal(first.error, second.error)


def test_a_motion_that_is_lost_has_an_error_and_says_so(tmp_path: Path) -> None:
    trial = run_trial(
        CountingMethod(lambda t: np.full((len(t), 1, 2), np.nan)),
        make_series(),
        TrainingBudget(),
        ResultCache(tmp_path),
    )
    assert trial.mse == pytest.approx(MAX_ERROR_PX**2)
    assert "lost" in trial.note
    json.dumps(trial.row, allow_nan=False)


def test_a_method_that_refuses_is_a_row_with_its_reason(tmp_path: Path) -> None:
    @dataclass(frozen=True)
    class Refusing:
        name: str = "refusing"

        def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> FittedMotion:
            raise ValueError("these samples are not enough")

    trial = run_trial(Refusing(), make_series(), TrainingBudget(), ResultCache(tmp_path))
    assert trial.note == "these samples are not enough"
    assert trial.row["seconds"] is None


def test_gains_are_against_linear_and_cubic_through_the_same_samples(tmp_path: Path) -> None:
    series, cache = make_series(), ResultCache(tmp_path)
    linear, cubic = (run_trial(method, series, TrainingBudget(), cache) for method in (LINEAR, CUBIC))
    assert (linear.x_linear, cubic.x_cubic) == (1.0, 1.0)
    assert cubic.x_linear == pytest.approx(linear.mse / cubic.mse)


def trial(method: str, mse: float, noise: float = 0.0, seed: int = 0, scene: str = "double-pendulum") -> Trial:
    case = ExperimentCase(scene, "stiff", 30.0, noise, seed)
    return Trial(case, method, mse, 1.0, 1.0, 1.0, 0, "", np.zeros(1), np.zeros(1), np.zeros(0))


def test_a_sentence_counts_where_the_claim_holds_and_a_table_compares_methods_with_their_rivals() -> None:
    trials = [
        trial("linear", 1.0), trial("cubic", 0.001), trial("RK net", 0.002), trial(PHYSICS_NAME, 1e-5),
        trial("linear", 1.0, 0.1), trial("cubic", 0.5, 0.1), trial("RK net", 0.1, 0.1), trial(PHYSICS_NAME, 0.01, 0.1),
    ]  # fmt: skip
    summary = summarize_settings(trials)
    assert describe_scene_results("double-pendulum", summary) == [
        "The thesis claims an error 100 times lower than that of linear interpolation."
        " In its own setting (stiff, 30 Hz, noise 0 px) the factor is 500: the claim holds."
        " Settings in which it holds: 1 of 2 (stiff, 30 Hz, noise 0 px)."
    ]
    table = build_tables("double-pendulum", summary)[0]
    rows = {method: [text for text, _ in cells] for method, cells in table.rows}
    assert rows == {
        "network of the thesis (RK net), than linear": ["255", "10", "500", "2 of 2"],
        "best spline, than linear": ["501", "2", "1,000", "2 of 2"],
        "fit of the physics, than cubic": ["75", "50", "100", "2 of 2"],
    }


def test_the_claim_about_boxes_is_an_error_like_that_of_linear_interpolation() -> None:
    trials = [trial(name, mse, noise, scene="boxes") for name, mse, noise in (
        ("linear", 1.0, 0.0), ("RK net", 0.6, 0.0), ("linear", 1.0, 0.1), ("RK net", 0.1, 0.1)
    )]  # fmt: skip
    (sentence,) = describe_scene_results("boxes", summarize_settings(trials))
    assert "comparable to that of linear" in sentence
    assert sentence.endswith("Settings in which it holds: 1 of 2 (stiff, 30 Hz, noise 0 px).")


def test_a_network_that_was_hardly_trained_can_hold_a_claim_but_not_break_it() -> None:
    def text(mse: float) -> str:
        trials = [trial("linear", 1.0), trial("RK net", mse)]
        return " ".join(describe_scene_results("double-pendulum", summarize_settings(trials), 0.25))

    assert "the factor is 200: the claim holds." in text(0.005)
    assert "the factor is 50: the claim fails." in text(0.02)
    assert "had 25% of its training at most: where the claim fails, that decides nothing" in text(0.02)


def test_a_method_with_fewer_seeds_is_compared_with_linear_on_those() -> None:
    trials = [trial("linear", mse, seed=seed) for seed, mse in enumerate((1.0, 100.0, 10_000.0))]
    trials += [trial("cubic", mse / 4, seed=seed) for seed, mse in enumerate((1.0, 100.0, 10_000.0))]
    (cell,) = summarize_settings([*trials, trial("RK net", 0.5)])
    assert cell.mse == pytest.approx({"linear": 100.0, "cubic": 25.0, "RK net": 50.0})


def test_a_network_that_was_not_trained_to_the_end_is_named_and_compared_with_nothing() -> None:
    brief = replace(trial("RK net", 1e-9), is_trained=False, seconds=120.0)
    trials = [trial("linear", 1.0), trial("cubic", 0.1), brief]
    (cell,) = summarize_settings(trials)
    assert set(cell.mse) == {"linear", "cubic"}
    text = " ".join(describe_scene_results("double-pendulum", [cell]))
    assert "claim" not in text
    assert "Not trained to the end, and compared with nothing: RK net (stiff, 30 Hz, noise 0 px; 120 CPU s)." in text
    _, sheet = build_tables("double-pendulum", [cell])
    looks = {method: cells[0] for method, cells in sheet.rows}
    assert looks["RK net"] == ("not trained to the end (120 s)", "worse")
    assert looks["cubic"][1] == "best"
    assert (brief.row["trained"], brief.row["x_linear"], brief.row["x_cubic"]) == (False, None, None)


def test_one_seed_without_its_whole_training_leaves_the_network_out() -> None:
    trials = [trial("linear", 1.0, seed=seed) for seed in range(2)]
    (cell,) = summarize_settings(
        [*trials, trial("RK net", 0.1), replace(trial("RK net", 0.1, seed=1), is_trained=False)]
    )
    assert "RK net" not in cell.mse
    assert "RK net" in cell.untrained


def test_what_a_method_was_given_is_said_where_it_stands() -> None:
    assert "other throws" in describe_extra_inputs("boxes", {PRETRAINED_NET, PHYSICS_NAME})
    assert describe_extra_inputs("boxes", {"linear"}) == ""


def test_tables_show_medians_over_seeds_and_mark_the_best() -> None:
    trials = [trial("linear", 1.0, seed=s) for s in range(3)]
    trials += [trial("cubic", mse, seed=s) for s, mse in enumerate((0.1, 0.5, 0.25))]
    _, sheet = build_tables("double-pendulum", summarize_settings(trials))
    assert [method for method, _ in sheet.rows] == ["linear: mse, px²", "cubic"]
    assert sheet.rows[1][1][0] == ("4", "best")


def test_what_a_network_took_to_learn_stands_in_a_table() -> None:
    def learnt(seed: int, seconds: float) -> Trial:
        loss = np.geomspace(1.0, 1e-4, 750)
        return replace(trial("RK net", 0.1, seed=seed), parameters=532_486, seconds=seconds, loss=loss)

    trials = [trial("linear", 1.0), *(learnt(seed, seconds) for seed, seconds in enumerate((18.0, 20.0, 40.0)))]
    sheet = build_learning_table("double-pendulum", trials)
    assert sheet is not None
    ((method, cells),) = sheet.rows
    assert (method, [text for text, _ in cells]) == ("RK net", ["532,486", "750", "20.0"])
    assert build_learning_table("boxes", trials) is None


def test_the_methods_that_sentences_and_tables_speak_of_exist() -> None:
    for scene in ("double-pendulum", "real", "boxes"):
        names = [method.name for method in build_methods(scene)]
        assert len(names) == len(set(names))
        assert {*THESIS_NETS, *REPRESENTATIVES} <= set(names)
        assert (PRETRAINED_NET in names) == (scene != "real")


def test_the_plan_has_what_was_asked_for_and_says_what_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = list_cases(ExperimentPlan(depth=Depth.WHOLE))
    assert {case.scene for case in whole} == {"double-pendulum", "boxes"}
    assert len(whole) == 3 * 2 * 27
    assert {case.seed for case in whole[: len(whole) // 3]} == {0}
    assert [sentence.split()[1] for sentence in explain_omissions(ExperimentPlan())] == ["real", "pool"]
    monkeypatch.setattr("pipeline.experiments.thesis.experiment_plan.find_spec", lambda _: None)
    assert {case.scene for case in list_cases(ExperimentPlan())} == {"double-pendulum"}
    assert explain_omissions(ExperimentPlan())[0].startswith("The boxes are left out")
    assert not list_cases(ExperimentPlan(scenes=("boxes",)))
    assert find_recording(tmp_path) is None
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / RECORDING).touch()
    assert find_recording(tmp_path) == tmp_path / "below"


def test_the_usual_plan_has_every_variant_rate_noise_and_method_though_not_all_crossed() -> None:
    plan = ExperimentPlan()
    there = [case for case in list_cases(plan) if case.seed == 0]
    for scene, variants in (("double-pendulum", {"soft", "medium", "stiff"}), ("boxes", {"400", "800", "1600"})):
        here = [case for case in there if case.scene == scene]
        assert here[0].fps == 30
        assert here[0].noise == 0
        assert {case.variant for case in here} == variants
        assert {case.fps for case in here} == {15, 30, 60}
        assert {case.noise for case in here} == {0, 0.1, 0.5}
        assert len(here) < 27
        assert {task.method for task in list_tasks(plan) if task.case == here[0]} == {
            method.name for method in build_methods(scene)
        }
    quick, usual, whole = (len(list_tasks(ExperimentPlan(depth=depth, seeds=(0,)))) for depth in Depth)
    assert 5 * quick < usual < whole / 4


def test_slow_networks_have_every_seed_in_the_thesis_own_setting_and_one_in_the_others() -> None:
    there = list_tasks(ExperimentPlan(seeds=(5, 6, 7)))
    for scene in ("double-pendulum", "boxes"):
        for method in build_methods(scene):
            seeds: dict[tuple[str, float, float], list[int]] = {}
            for task in there:
                if task.case.scene == scene and task.method == method.name:
                    seeds.setdefault((task.case.variant, task.case.fps, task.case.noise), []).append(task.case.seed)
            own = seeds.pop((FIRST_VARIANT[scene], *BASE_SETTING))
            assert own == [5, 6, 7]
            every = method.name in REPRESENTATIVES and method.name not in SLOW_NETS[scene]
            assert all(some == ([5, 6, 7] if every else [5]) for some in seeds.values())


def test_a_quick_plan_has_noise_and_few_networks_which_all_stop_early() -> None:
    plan = ExperimentPlan(seeds=(5,), depth=Depth.QUICK)
    there = list_tasks(plan)
    for scene in ("double-pendulum", "boxes"):
        methods = {
            noise: {task.method for task in there if (task.case.scene, task.case.noise) == (scene, noise)}
            for noise in {task.case.noise for task in there}
        }
        assert set(methods) == {0.0, 0.1}
        assert all({*SPLINES, "linear", PHYSICS_NAME} <= names for names in methods.values())
        assert THESIS_NET in methods[0.0]
    networks = [find_method(task, plan) for task in there if is_network(task.method)]
    assert networks
    assert all(isinstance(network, EarlyStopping) for network in networks)
    assert not any(isinstance(find_method(task, plan), EarlyStopping) for task in there if not is_network(task.method))
    assert not any(isinstance(find_method(task, ExperimentPlan()), EarlyStopping) for task in there)
    assert f"{HOLDOUT_PATIENCE} steps" in describe_training(plan)


def test_networks_on_boxes_have_less_time_in_a_usual_run_and_the_page_says_so() -> None:
    assert ExperimentPlan().budget("boxes").seconds < ExperimentPlan().budget("double-pendulum").seconds
    assert ExperimentPlan(depth=Depth.WHOLE).budget("boxes") == ExperimentPlan(depth=Depth.WHOLE).budget("real")
    assert "25% of their training, at most 20 CPU s; 5 s on boxes" in describe_training(ExperimentPlan())
    assert "first seed alone" in describe_training(ExperimentPlan())
    assert "first seed" not in describe_training(ExperimentPlan(seeds=(0,)))
    assert "trained to the end" in describe_training(ExperimentPlan(depth=Depth.WHOLE))


def test_lessons_are_other_swings_of_the_same_pendulum_with_the_true_middle() -> None:
    lessons = simulate_training_swings("stiff", 1 / 15, 0)
    assert lessons.shape[1:] == (3, 3, 2)
    assert len(lessons) > 2000
    arms = np.linalg.norm(np.diff(lessons, axis=2), axis=3)
    assert np.abs(arms - LENGTH).max() < 0.5
    lines = (lessons[:, 0] + lessons[:, 2]) / 2
    assert np.sqrt(np.mean((lines - lessons[:, 1]) ** 2)) > 0.2
    own = simulate_double_pendulum("stiff", tuple(np.arange(0, 2.5, 1 / 30)))
    assert np.abs(lessons[:, 1, None] - own).max(axis=(2, 3)).min() > 0.1
    assert not np.array_equal(lessons, simulate_training_swings("stiff", 1 / 15, 1))


def test_opposite_depths_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute_command_line(["reproduce", "--quick", "--whole", "-o", str(tmp_path / "out")]) == 2
    assert "opposite" in capsys.readouterr().err


def test_every_corner_belongs_to_a_box_and_the_ball_to_none() -> None:
    counts = np.bincount(body_indices())
    assert counts.tolist() == [1] + [4] * 50


def test_the_pool_scene_is_the_longest_stretch_with_every_ball(tmp_path: Path) -> None:
    lines = ["shot,frame,t,id,x_px,y_px,observed"]
    for k in range(40):
        for name, x in (("cue", 10.0 * k), ("red", 500.0)):
            lines.append(f"0,{k},{k / 30:.6f},{name},{x},{3 * k},{int((k, name) != (8, 'red'))}")
    (tmp_path / "tracks.csv").write_text("\n".join(lines), encoding="utf-8")
    assert list_shots(tmp_path) == [("shot 0", 30.0)]
    series = build_pool_series(ExperimentCase("pool", "shot 0", 30.0, 0.0, 0), tmp_path)
    assert series.truth.shape == (31, 2, 2)
    assert series.truth[0, 0, 0] == pytest.approx(90.0)


@pytest.fixture
def only_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks take minutes."""

    def curves(scene: str, variant: str, run: Path | None) -> list[MotionMethod]:
        return list(CURVES)

    monkeypatch.setattr("pipeline.experiments.thesis.experiment_plan.build_methods", curves)


@pytest.mark.usefixtures("only_curves")
def test_the_command_leaves_a_table_figures_and_a_page_and_resumes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["reproduce", "double-pendulum", "--quick", "--jobs", "1", "-o", str(tmp_path / "out"),
               "--cache", str(tmp_path / "cache"), "--json"]  # fmt: skip
    assert execute_command_line(command) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["method"] for row in rows} == {method.name for method in CURVES}
    assert {(row["scene"], row["variant"], row["fps"], row["noise_px"], row["seed"]) for row in rows} == {
        ("double-pendulum", "stiff", 30.0, noise, 0) for noise in (0.0, 0.1)
    }
    wanted = {"scene", "variant", "method", "fps", "noise_px", "seed", "mse", "x_linear", "x_cubic", "seconds"}
    assert all(wanted <= set(row) for row in rows)
    page = (tmp_path / "out" / "reproduce.html").read_text(encoding="utf-8")
    assert not re.search(r'<(?:script|img|link|iframe)[^>]*="https?:', page), "the page loads nothing from elsewhere"
    assert re.findall(r'<div id="([\w-]+)" style="height', page) == [
        "figure-5-double-pendulum", "figure-6-double-pendulum-errors", "double-pendulum-error-over-time"
    ]  # fmt: skip
    assert (tmp_path / "out" / "trials.csv").read_text(encoding="utf-8").count("\n") == len(rows) + 1
    assert execute_command_line(command) == 0
    assert json.loads(capsys.readouterr().out) == rows


@dataclass(frozen=True)
class SlowNetwork:
    """A network that the time limit stops at an error of 0 px."""

    name: str = THESIS_NET

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> FittedMotion:
        return FittedMotion(CUBIC.fit(times, states).motion, np.ones(3), 7, 99.0, is_trained=False)


def test_table_page_and_rows_of_a_quick_run_mark_a_network_that_time_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "pipeline.experiments.thesis.experiment_plan.build_methods", lambda *_: [*CURVES, SlowNetwork()]
    )
    out = tmp_path / "out"
    command = ["reproduce", "double-pendulum", "--quick", "--jobs", "1", "-o", str(out), "--cache", str(tmp_path)]
    assert execute_command_line(command) == 0
    assert capsys.readouterr().out.count("not trained to the end (99 s)") == 2
    page = (out / "reproduce.html").read_text(encoding="utf-8")
    assert page.count(">not trained to the end (99 s)</td>") == 2
    lines = (out / "trials.csv").read_text(encoding="utf-8").splitlines()
    rows = [row for row in csv.DictReader(lines) if row["method"] == THESIS_NET]
    assert [(row["x_linear"], row["x_cubic"], row["trained"]) for row in rows] == [("", "", "False")] * 2
    assert execute_command_line([*command, "--json"]) == 0
    rows = [row for row in json.loads(capsys.readouterr().out) if row["method"] == THESIS_NET]
    assert [(row["x_linear"], row["trained"]) for row in rows] == [(None, False)] * 2


def test_a_scene_without_its_material_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["reproduce", "real", "-o", str(tmp_path / "out"), "--cache", str(tmp_path / "cache")]
    assert execute_command_line([*command, "--data", str(tmp_path)]) == 2
    assert "double_freeswing_200Hz.npz" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
